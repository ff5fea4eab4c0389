"""The stages as the graph of a pipeline: its nodes, and the question that each one asks."""

from collections.abc import Iterable, Sequence
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
from npred.lab.scheduler.plan import Node, Resolver
from npred.lab.store import Store

if TYPE_CHECKING:
    from npred.plants import Plant

STAGES: dict[str, Stage] = {name: registry.declared_stage(name) for name in registry.STAGES}


def nodes(config: Pipeline, targets: Iterable[str], only: str | None = None) -> list[Node]:
    """The targets with all that they need, each after its inputs; `only` keeps one network of stages with one for each.

    No other stage needs an optional one where the pipeline has no table of it.
    """
    needed = set(targets)
    for name in reversed(STAGES):
        above = STAGES[name].upstream if name in needed else ()
        needed.update(stage for stage in above if getattr(config, stage) is not None)
    networks = [only] if only else config.train.models
    return [node for name in STAGES if name in needed for node in _nodes(config, name, networks)]


def usual(config: Pipeline) -> list[str]:
    """The stages that `npred run` brings: an optional one where the pipeline has its table."""
    return [name for name, entry in STAGES.items() if not entry.optional or getattr(config, name) is not None]


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
        """The plant of the pipeline, one object for all its stages: they share what it has compiled."""
        from npred import plants  # brings NumPy, which `npred --help` has no use for

        return plants.resolve(self.config.plant, self.config.parameters, self.config.kappa)

    def with_absolute_paths(self) -> Self:
        return replace(self, config=self.config.with_absolute_paths(), store=Store(self.store.root.absolute()))

    def check(self, nodes: Iterable[Node]) -> None:
        """Raise ConfigError where these nodes ask for what the plant does not have."""
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
        """The result of a stage. Raises what the stage raises, ConfigError where memory does not hold it."""
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


def _nodes(config: Pipeline, stage: str, networks: Sequence[str]) -> list[Node]:
    upstream = [above for above in STAGES[stage].upstream if getattr(config, above) is not None]
    models = networks if STAGES[stage].per_network else (None,)
    return [Node(stage, model, _inputs(upstream, [model] if model else networks)) for model in models]


def _inputs(upstream: Iterable[str], networks: Iterable[str]) -> tuple[str, ...]:
    """The names of results of these stages, those of these networks where there is one for each."""
    return tuple(name for above in upstream for name in (networks if STAGES[above].per_network else (above,)))
