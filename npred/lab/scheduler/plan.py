"""The plan of a graph: which results the store has and what would run, by the keys of the nodes."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from npred.lab.config.results import Result
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler.executors import Workers
from npred.lab.scheduler.reasons import NEVER, alike, changes, differences, distance, leaves, reason, sentence
from npred.lab.store import Artifact, Question, ResultInput, Store

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


@dataclass(frozen=True)
class Step:
    """A node, its question where its inputs are there, and its artifact where the store has it."""

    node: Node
    question: Question | None
    artifact: Artifact | None
    reason: str
    seconds: float = 0.0  # nothing has run

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
    """Resolves nodes, of a pipeline or of what a package brings, against one store.

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
        """The name of what its results are made for."""

    @abstractmethod
    def with_absolute_paths(self) -> Self:
        """The same for a process elsewhere: a relative path is another file there, and what is cached stays here."""

    @abstractmethod
    def check(self, nodes: Iterable[Node]) -> None:
        """Raise ConfigError where these nodes ask for what there is not."""

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
        """One step per node, in order, without running anything. Raises StoreError for a corrupt manifest, and what
        `check` raises.
        """
        nodes = list(nodes)
        self.check(nodes)
        steps: dict[str, Step] = {}
        for node in nodes:
            blocked = [name for name in node.inputs if not steps[name].artifact]
            inputs = {name: artifact for name in node.inputs if (artifact := steps[name].artifact)}
            steps[node.name] = (
                self._waiting(node, [steps[name] for name in blocked])
                if blocked
                else self.step(node, self.question(node, inputs))
            )
        return list(steps.values())

    def step(self, node: Node, question: Question) -> Step:
        """The step of a node whose inputs are all there."""
        if node.stage in self.forced:
            return Step(node, question, None, "--force")
        artifact = self.store.get(node.stage, question.key)
        if artifact is None and self.borrows and (borrowed := self._borrowed(question)):
            why = sentence(differences(borrowed.manifest.question, question))
            return Step(node, question, borrowed, f"of another machine: {why}; npred {node.stage} runs it here")
        why = UP_TO_DATE if artifact else reason(question, self.name, self._artifacts)
        return Step(node, question, artifact, why)

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

    def _waiting(self, node: Node, blocked: list[Step]) -> Step:
        causes = [f"upstream {step.node.name} will run ({step.reason})" for step in blocked if step.question]
        older = [a for a in self._artifacts if alike(a, node.stage, node.model, self.name)]
        asked = self.settings(node)
        flat = leaves(asked)
        closest = min(reversed(older), key=lambda a: distance(a.manifest.question.config, flat), default=None)
        changed = changes(closest.manifest.question.config, asked) if closest else []
        return Step(node, None, None, f"{'stale' if older else NEVER}: {sentence([*changed, *causes])}")

    def _borrowed(self, question: Question) -> Artifact | None:
        """The latest result of the same question to another machine; None where no machine is part of it."""
        asked = anywhere(question)
        same = (a for a in reversed(self._artifacts) if asked and anywhere(a.manifest.question) == asked)
        return next(same, None)

    @cached_property
    def _artifacts(self) -> list[Artifact]:
        return self.store.artifacts()


def anywhere(asked: Question) -> str | None:
    """The key of a question without the machine, where that is part of it: what another machine timed has the same."""
    if "hardware" not in asked.config:
        return None
    config = {key: value for key, value in asked.config.items() if key != "hardware"}
    return asked.model_copy(update={"config": config}).key
