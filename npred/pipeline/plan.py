"""The plan of a pipeline: which results the store has and what would run, by the keys of the nodes."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from npred.config import Pipeline
from npred.pipeline import stage_registry
from npred.pipeline.reasons import NEVER, alike, differences, distance, leaves, reason, sentence, settings
from npred.pipeline.stage_registry import STAGES, Node
from npred.store import Artifact, Question, ResultInput, SourceText, Store

if TYPE_CHECKING:
    from npred.plants import Plant

UP_TO_DATE = "up to date"


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


@dataclass(frozen=True)
class Planner:
    """Resolves the nodes of one pipeline against one store; `forced` stages count as not there.

    With `borrows`, times that another machine took are taken where this one has none: to draw them.
    """

    config: Pipeline
    store: Store
    device: str
    forced: frozenset[str] = frozenset()
    borrows: bool = False

    def check(self, nodes: Iterable[Node]) -> None:
        """Raise ConfigError where these nodes ask for what the plant does not have."""
        stage_registry.check(self.config, {node.stage for node in nodes})

    def plan(self, nodes: Iterable[Node]) -> list[Step]:
        """One step per node, in order, without running anything. Raises StoreError for a corrupt
        manifest, ConfigError for a pipeline that does not fit its plant.
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
        why = UP_TO_DATE if artifact else reason(question, self.config.name, self._artifacts, self.sources(node))
        return Step(node, question, artifact, why)

    def question(self, node: Node, inputs: Mapping[str, Artifact]) -> Question:
        """The question of a node to the store, its inputs being there."""
        sources = {
            name: ResultInput(key=artifact.manifest.key, digest=artifact.manifest.digest)
            for name, artifact in inputs.items()
        }
        return Question(
            stage=node.stage,
            version=STAGES[node.stage].version,
            model=node.model,
            config=stage_registry.question(node, self.config, self.device),
            inputs=sources,
        )

    def sources(self, node: Node) -> dict[str, SourceText]:
        """The files of code that a node's result depends on, as they are now."""
        return stage_registry.sources(node, self.config)

    def _waiting(self, node: Node, blocked: list[Step]) -> Step:
        causes = [f"upstream {step.node.name} will run ({step.reason})" for step in blocked if step.question]
        older = [a for a in self._artifacts if alike(a, node.stage, node.model, self.config.name)]
        asked, sources = stage_registry.question(node, self.config, self.device), self.sources(node)
        flat = leaves(asked)
        closest = min(reversed(older), key=lambda a: distance(a.manifest.question.config, flat), default=None)
        before = closest.manifest if closest else None
        changes = settings(before.question.config, asked, before.sources, sources) if before else []
        return Step(node, None, None, f"{'stale' if older else NEVER}: {sentence([*changes, *causes])}")

    def _borrowed(self, question: Question) -> Artifact | None:
        """The latest result of the same question to another machine; None where no machine is part of it."""
        asked = anywhere(question)
        same = (a for a in reversed(self._artifacts) if asked and anywhere(a.manifest.question) == asked)
        return next(same, None)

    @cached_property
    def plant(self) -> "Plant":
        """The plant of the pipeline, one object for all its stages: they share what it has compiled."""
        from npred import plants

        return plants.resolve(self.config.plant, self.config.parameters)

    @cached_property
    def _artifacts(self) -> list[Artifact]:
        return self.store.artifacts()


def anywhere(asked: Question) -> str | None:
    """The key of a question without the machine, where that is part of it: what another machine timed has the same."""
    if "hardware" not in asked.config:
        return None
    config = {key: value for key, value in asked.config.items() if key != "hardware"}
    return asked.model_copy(update={"config": config}).key
