"""The stages of a pipeline as a graph: the question that each node asks, and which results a store has of them."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from npred.base import registry
from npred.base.errors import ConfigError, first_line
from npred.lab.config import Pipeline
from npred.lab.config.results import Result
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler.declaration import Stage
from npred.lab.scheduler.executors import Workers
from npred.lab.scheduler.reasons import NEVER, alike, changes, differences, distance, leaves, reason, sentence
from npred.lab.store import Artifact, Question, ResultInput, Store

if TYPE_CHECKING:
    from npred.plants import Plant

STAGES: dict[str, Stage] = {name: registry.declared_stage(name) for name in registry.STAGES}
UP_TO_DATE = "up to date"


@dataclass(frozen=True)
class Node:
    """A stage, and the network where the stage has one artifact per network, by which its inputs call it."""

    stage: str
    model: str | None
    inputs: tuple[str, ...]

    @property
    def name(self) -> str:
        """The name of the result as an input of others: `generate`, `deeponet`, …"""
        return self.model or self.stage

    @property
    def title(self) -> str:
        """For people: `train deeponet`."""
        return f"{self.stage} {self.model}" if self.model else self.stage


def nodes(config: Pipeline, targets: Iterable[str], only: str | None = None) -> list[Node]:
    """The targets with all that they need, each after its inputs; `only` keeps one network of stages with one for each.

    No other stage needs an optional one where the pipeline has no table of it.
    """
    needed, graph, networks = set(targets), [], [only] if only else config.train.models
    for name in reversed(STAGES):
        above = STAGES[name].upstream if name in needed else ()
        needed.update(stage for stage in above if getattr(config, stage) is not None)
    for name in (name for name in STAGES if name in needed):
        above = [stage for stage in STAGES[name].upstream if getattr(config, stage) is not None]
        for model in networks if STAGES[name].per_network else (None,):
            one = [model] if model else networks
            inputs = (source for stage in above for source in (one if STAGES[stage].per_network else [stage]))
            graph.append(Node(name, model, tuple(inputs)))
    return graph


def usual(config: Pipeline) -> list[str]:
    """The stages that `npred run` brings: an optional one where the pipeline has its table."""
    return [name for name, entry in STAGES.items() if not entry.optional or getattr(config, name) is not None]


@dataclass(frozen=True)
class Step:
    """A node, its question where its inputs are there, and its artifact where the store has it."""

    node: Node
    question: Question | None
    artifact: Artifact | None
    reason: str
    seconds: float | None = None  # that it took the last time, where that is known: now nothing has run

    @property
    def key(self) -> str | None:
        """The key, or None while an input still has to be made."""
        return self.question.key if self.question else None

    @property
    def action(self) -> str:
        """`hit` or `run`."""
        return "hit" if self.artifact else "run"

    @property
    def state(self) -> str:
        """`fresh`, `missing` (never made for this pipeline) or `stale`."""
        if self.artifact:
            return "fresh"
        return "missing" if self.reason.startswith(NEVER) else "stale"


class Resolver(ABC):
    """Resolves nodes, of a pipeline or of a package, against one store.

    `forced` stages count as not there. With `borrows`, times that another machine took are taken where this one has
    none: to draw them.
    """

    store: Store
    device: str
    forced: frozenset[str]
    borrows: bool

    @property
    @abstractmethod
    def name(self) -> str:
        """The name of the pipeline, or the like, that its results are for."""

    @abstractmethod
    def with_absolute_paths(self) -> Self:
        """The same for a process elsewhere: a relative path is another file there, and caches stay here."""

    @abstractmethod
    def check(self, nodes: Iterable[Node]) -> None:
        """Raise ConfigError where these nodes ask for a part that there is not."""

    @abstractmethod
    def version(self, node: Node) -> int:
        """The version of the node's stage."""

    @abstractmethod
    def settings(self, node: Node) -> dict[str, Any]:
        """All that the node's key holds besides its inputs."""

    @abstractmethod
    def run(
        self, node: Node, folder: Path, inputs: dict[str, Path], scratch: Path, console: Console, jobs: int,
        executor: Workers,
    ) -> Result:  # fmt: skip
        """The result of a node, made now: its files in `folder`, its checkpoints in `scratch`."""

    def plan(self, nodes: Iterable[Node]) -> list[Step]:
        """One step per node, in order; nothing runs. Raises StoreError for a corrupt manifest, and as `check` does."""
        nodes = list(nodes)
        self.check(nodes)
        steps: dict[str, Step] = {}
        for node in nodes:
            sources = [steps[name] for name in node.inputs]
            inputs = {source.node.name: source.artifact for source in sources if source.artifact}
            if len(inputs) == len(sources):
                steps[node.name] = self.step(node, self.question(node, inputs))
                continue
            # An input still has to be made: of the settings the reason tells what has changed.
            older = [a for a in self._artifacts if alike(a, node.stage, node.model, self.name)]
            asked = self.settings(node)
            flat = leaves(asked)
            closest = min(reversed(older), key=lambda a: distance(a.manifest.question.config, flat), default=None)
            causes = changes(closest.manifest.question.config, asked) if closest else []
            running = (source for source in sources if source.question and not source.artifact)
            causes += [f"{source.node.name} runs first ({source.reason})" for source in running]
            steps[node.name] = Step(node, None, None, f"stale: {sentence(causes)}" if older else NEVER)
        return [replace(step, seconds=self._last_time(step)) for step in steps.values()]

    def step(self, node: Node, question: Question) -> Step:
        """The step of a node whose inputs are all there."""
        if node.stage in self.forced:
            return Step(node, question, None, "--force")
        artifact = self.store.get(node.stage, question.key)
        if artifact is None and self.borrows and (asked := anywhere(question)):
            for borrowed in reversed(self._artifacts):
                if anywhere(borrowed.manifest.question) == asked:
                    why = sentence(differences(borrowed.manifest.question, question))
                    return Step(node, question, borrowed, f"of another machine: {why}; npred {node.stage} runs it here")
        why = UP_TO_DATE if artifact else reason(question, self.name, self._artifacts)
        return Step(node, question, artifact, why)

    def _last_time(self, step: Step) -> float | None:
        """How long the result of a step took, or where it has none the most recent one like it; None if unknown."""
        if step.artifact:
            return step.artifact.seconds
        of_such = (a for a in reversed(self._artifacts) if alike(a, step.node.stage, step.node.model, self.name))
        return next((artifact.seconds for artifact in of_such if artifact.seconds is not None), None)

    def misses(self, step: Step) -> bool:
        """True if the store cannot have a result for a step, whatever comes of inputs that still have to be made."""
        if step.question or step.artifact:
            return step.artifact is None
        node, asked = step.node, leaves(self.settings(step.node))
        answered = (artifact.manifest.question for artifact in self._artifacts)
        same = (question for question in answered if (question.stage, question.model) == (node.stage, node.model))
        return all(distance(question.config, asked) for question in same)

    def question(self, node: Node, inputs: Mapping[str, Artifact]) -> Question:
        """The question of a node to the store, its inputs being there."""
        sources = {
            name: ResultInput(key=artifact.manifest.key, digest=artifact.manifest.digest)
            for name, artifact in inputs.items()
        }
        return Question(
            stage=node.stage, version=self.version(node), model=node.model, config=self.settings(node), inputs=sources
        )

    @cached_property
    def _artifacts(self) -> list[Artifact]:
        return self.store.artifacts()


@dataclass(frozen=True)
class Planner(Resolver):
    """Resolves the nodes of one pipeline."""

    config: Pipeline
    store: Store
    device: str
    forced: frozenset[str] = frozenset()
    borrows: bool = False

    @property
    def name(self) -> str:
        return self.config.name

    @cached_property
    def plant(self) -> "Plant":
        """The plant of the pipeline, one object for all its stages: they share its compiled code."""
        from npred import plants  # brings NumPy, which `npred --help` has no use for

        return plants.resolve(*self.config.of_plant)

    def with_absolute_paths(self) -> Self:
        return replace(self, config=self.config.with_absolute_paths(), store=Store(self.store.root.absolute()))

    def check(self, nodes: Iterable[Node]) -> None:
        """Raise ConfigError where these nodes ask for parts that the plant does not have."""
        from npred.lab.scheduler import pipeline_fit

        pipeline_fit.require(self.plant, self.config, {node.stage for node in nodes})

    def version(self, node: Node) -> int:
        return STAGES[node.stage].version

    def settings(self, node: Node) -> dict[str, Any]:
        """The slice of the configuration that the node's key holds, with the plant and the seed."""
        from npred.lab.scheduler.configuration import Slices, identity

        slices = Slices(self.config, self.plant, node.model, self.device)
        return {"plant": identity(self.plant), "seed": self.config.seed} | STAGES[node.stage].key(slices)

    def run(
        self, node: Node, folder: Path, inputs: dict[str, Path], scratch: Path, console: Console, jobs: int,
        executor: Workers,
    ) -> Result:  # fmt: skip
        """The result of a stage. Raises the stage's errors, and ConfigError where memory does not hold it."""
        from npred.lab.scheduler.job import Job

        job = Job(self.config, self.plant, folder, inputs, scratch, self.device, jobs, console, node.model, executor)
        try:
            return STAGES[node.stage].run(job)
        except (MemoryError, RuntimeError) as error:  # torch has a RuntimeError
            if not isinstance(error, MemoryError) and "t allocate memory" not in str(error):
                raise
            todo = f"take fewer nodes, rows or weights in [{node.stage}]"
            message = " ".join(first_line(error).split())
            raise ConfigError(f"{node.title}: expected what fits into memory, got: {message}; {todo}") from error


def anywhere(asked: Question) -> str | None:
    """The key of a question without the machine, where that is part of it: another machine's times have the same."""
    if "hardware" not in asked.config:
        return None
    config = {key: value for key, value in asked.config.items() if key != "hardware"}
    return asked.model_copy(update={"config": config}).key
