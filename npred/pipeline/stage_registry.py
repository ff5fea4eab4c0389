"""The stages as the graph of a pipeline: its nodes, and the question that each one asks."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from npred import registry
from npred.config import Pipeline
from npred.json_files import escaped
from npred.stages.declaration import Stage
from npred.store.manifest import LONGEST, SourceText

STAGES: dict[str, Stage] = {name: registry.declared_stage(name) for name in registry.STAGES}


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
    needed = set(targets)
    for name in reversed(STAGES):
        above = STAGES[name].upstream if name in needed else ()
        needed.update(stage for stage in above if getattr(config, stage) is not None)
    networks = [only] if only else config.train.models
    return [node for name in STAGES if name in needed for node in _nodes(config, name, networks)]


def usual(config: Pipeline) -> list[str]:
    """The stages that `npred run` brings: an optional one where the pipeline has its table."""
    return [name for name, entry in STAGES.items() if not entry.optional or getattr(config, name) is not None]


def question(node: Node, config: Pipeline, device: str) -> dict[str, Any]:
    """The slice of the configuration that the node's key holds, with the plant and the seed."""
    from npred import plants  # brings NumPy, which `npred --help` has no use for

    shared = {"plant": plants.resolve(config.plant, config.parameters).identity, "seed": config.seed}
    return shared | STAGES[node.stage].configuration(config, node.model, device)


def sources(node: Node, config: Pipeline) -> dict[str, SourceText]:
    """The files of code behind a node's question: the plant's, those of parts that it names; long ones not."""
    from npred import plants

    files_by_role = {"plant": plants.resolve(config.plant, config.parameters).source}
    for role, spec in STAGES[node.stage].parts(config, node.model).items():
        if registry.in_file(spec):
            files_by_role[role] = registry.read(role, registry.split(spec)[0])
    return {
        role: SourceText(file=escaped(source.file), text=source.text)
        for role, source in files_by_role.items()
        if source and len(source.text) <= LONGEST
    }


def check(config: Pipeline, stages: Collection[str]) -> None:
    """Raise ConfigError where the stages ask for what the pipeline's plant does not have."""
    from npred import diagnosis, plants

    diagnosis.require(plants.resolve(config.plant, config.parameters), config, stages)


def _nodes(config: Pipeline, stage: str, networks: Sequence[str]) -> list[Node]:
    upstream = [above for above in STAGES[stage].upstream if getattr(config, above) is not None]
    models = networks if STAGES[stage].per_network else (None,)
    return [Node(stage, model, _inputs(upstream, [model] if model else networks)) for model in models]


def _inputs(upstream: Iterable[str], networks: Iterable[str]) -> tuple[str, ...]:
    """The names of results of these stages, those of these networks where there is one for each."""
    return tuple(name for above in upstream for name in (networks if STAGES[above].per_network else (above,)))
