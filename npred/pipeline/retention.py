"""Retention: the results that pipelines need of a store, also where parts of it are missing or corrupt."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from npred.errors import StoreError
from npred.pipeline.plan import Resolver, anywhere
from npred.pipeline.stage_registry import Node
from npred.store import Artifact


@dataclass
class Kept:
    """Keys that are needed and, where an input is not there to tell the key, the settings of what is needed."""

    keys: set[str] = field(default_factory=set)
    timed: set[str] = field(default_factory=set)  # keys of what was asked of a machine, leaving the machine out
    loose: list[tuple[Node, dict[str, Any]]] = field(default_factory=list)

    def add(self, planner: Resolver, nodes: Iterable[Node]) -> None:
        """Keep what these nodes need, each after its inputs."""
        artifacts: dict[str, Artifact | None] = {}
        for node in nodes:
            inputs = {name: artifact for name in node.inputs if (artifact := artifacts[name])}
            complete = len(inputs) == len(node.inputs)
            artifacts[node.name] = self._keep(planner, node, inputs) if complete else self._keep_alike(planner, node)

    def holds(self, artifact: Artifact) -> bool:
        """True if an artifact is needed, or may be."""
        asked = artifact.manifest.question
        alike = ((asked.stage, asked.model, asked.config) == (n.stage, n.model, config) for n, config in self.loose)
        return artifact.manifest.key in self.keys or anywhere(asked) in self.timed or any(alike)

    def holds_checkpoint(self, name: str) -> bool:
        """True if the checkpoint `stage-key` is one that a run would go on from, or may be."""
        stage, _, key = name.rpartition("-")
        return key in self.keys or any(node.stage == stage for node, _ in self.loose)

    def _keep(self, planner: Resolver, node: Node, inputs: dict[str, Artifact]) -> Artifact | None:
        question = planner.question(node, inputs)
        self.keys.add(question.key)
        if key := anywhere(question):
            self.timed.add(key)
        try:
            return planner.store.get(node.stage, question.key)
        except StoreError:  # that one is corrupt; what was made from it need not be
            return None

    def _keep_alike(self, planner: Resolver, node: Node) -> None:
        self.loose.append((node, planner.settings(node)))


def closure(kept: Iterable[Artifact], everything: Iterable[Artifact]) -> set[str]:
    """The keys of the kept artifacts and of all that they were made from."""
    by_key = {artifact.manifest.key: artifact for artifact in everything}
    keys, todo = set(), [artifact.manifest.key for artifact in kept]
    while todo:
        key = todo.pop()
        if key not in keys:
            keys.add(key)
            todo += [source.key for source in by_key[key].manifest.question.inputs.values() if source.key in by_key]
    return keys
