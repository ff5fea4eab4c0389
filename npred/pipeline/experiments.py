"""Published experiments as nodes: one for each part, keyed by the code of the experiment's own package.

What comes from npred's engine enters by `VERSION`: raise it when that changes a row.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from npred import registry
from npred.errors import ConfigError, MissingError, similar
from npred.parallel.executors import Workers
from npred.pipeline.imported_code import imported_code
from npred.pipeline.plan import Resolver
from npred.pipeline.stage_registry import Node
from npred.registry import Source
from npred.results import Reproduced
from npred.stages.reproduce import NUMERICAL, TIMES, Place, load
from npred.store import SourceText, Store
from npred.store.manifest import LONGEST
from npred.terminal.console import Console

STAGE = "reproduce"
VERSION = 3
ABSENT = "expected the package npred_experiments, found none; install npred again, with pip: it brings that"


def names() -> list[str]:
    """The registered experiments, sorted. Raises MissingError where no package registers one."""
    if registered := registry.EXPERIMENTS.names():
        return registered
    raise MissingError(f"{STAGE}: {ABSENT}")


@dataclass(frozen=True)
class ExperimentPlanner(Resolver):
    """Resolves the parts of one experiment. Nothing of it is imported before it is asked for its `nodes`, or runs."""

    experiment: str
    store: Store
    forced: frozenset[str] = frozenset()
    device: str = "cpu"
    borrows: bool = False

    @property
    def name(self) -> str:
        """The same for all experiments: no pipeline."""
        return STAGE

    def located(self) -> Self:
        """The same for a process elsewhere."""
        return replace(self, store=Store(self.store.root.absolute()))

    def nodes(self, trained: bool = True) -> list[Node]:
        """A node for each part; the numerical rows only where nothing is to be `trained`."""
        return [self._node(part) for part in (load(self.experiment).parts if trained else [NUMERICAL])]

    def possible(self) -> list[Node]:
        """The nodes of all parts that an experiment may have: nothing of it is imported."""
        return [self._node(part) for part in (NUMERICAL, TIMES, *registry.NETWORKS.names())]

    def check(self, nodes: Iterable[Node]) -> None:
        """Raise ConfigError for a name that there is no experiment of."""
        if self.experiment not in (registered := names()):
            near = similar(self.experiment, registered) or "; choose one"
            raise ConfigError(f"{STAGE}: expected {', '.join(registered)}, got {self.experiment!r}{near}")

    def version(self, node: Node) -> int:
        """One for all experiments."""
        return VERSION

    def settings(self, node: Node) -> dict[str, Any]:
        """The experiment, the digests of its code, and the part, but for the numerical rows."""
        code = {name: {"source": source.sha256} for name, source in self._code.items()}
        part = {} if node.model == self.experiment else {"part": self._part(node)}
        return {"experiment": registry.EXPERIMENTS.identity(self.experiment), "code": code} | part

    def sources(self, node: Node) -> dict[str, SourceText]:
        """The files of its code."""
        return {
            f"code.{name}": SourceText(file=source.file, text=source.text)
            for name, source in self._code.items()
            if len(source.text) <= LONGEST
        }

    def run(
        self, node: Node, folder: Path, inputs: dict[str, Path], scratch: Path, console: Console, jobs: int,
        executor: Workers,
    ) -> Reproduced:  # fmt: skip
        """The part, measured now."""
        return load(self.experiment).measured(self.experiment, self._part(node), Place(folder, scratch, console))

    @cached_property
    def _code(self) -> dict[str, Source]:
        return imported_code(registry.EXPERIMENTS.module(self.experiment))

    def _node(self, part: str) -> Node:
        return Node(STAGE, self.experiment if part == NUMERICAL else f"{self.experiment}_{part}", ())

    def _part(self, node: Node) -> str:
        return (node.model or "").removeprefix(self.experiment).removeprefix("_") or NUMERICAL


def every(store: Store) -> list[ExperimentPlanner]:
    """Those of all registered experiments; none where there is none."""
    return [ExperimentPlanner(name, store) for name in registry.EXPERIMENTS.names()]
