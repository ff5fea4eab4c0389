"""The stages as the graph of a pipeline, and the slice of the configuration that each one's key holds."""

import importlib
import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from npred import registry
from npred.config import PAPER, Loop, Network, Pipeline, Section
from npred.errors import ConfigError
from npred.json_files import escaped, regular, sha256
from npred.parallel import devices
from npred.results import Result
from npred.store.manifest import LONGEST, SourceText

if TYPE_CHECKING:
    from npred.stages import Job

UNUSED = 1000.0  # gamma in the key of loops without an adaptation
Slice = Callable[[Pipeline, str | None, str], dict[str, Any]]


@dataclass(frozen=True)
class Stage:
    """A stage of npred.registry.STAGES with the slice of the configuration that its key holds."""

    version: int
    upstream: tuple[str, ...]
    slice: Slice
    module: str
    target: str

    @property
    def result(self) -> type[Result]:
        """The model of its result."""
        return registry.attribute(self.target)

    def run(self, job: "Job") -> Result:
        """The stage's run(job); its module is imported here, for it may bring torch."""
        return importlib.import_module(self.module).run(job)

    def summary(self, document: dict[str, Any], width: int | None = None, wide: bool = False) -> str:
        """A result's JSON in a few lines for people, its tables folded to `width` columns; `wide`: all that is in it.

        Raises StoreError where it is no result of this stage.
        """
        module, result = importlib.import_module(self.module), self.result.of(document, "result")
        return (getattr(module, "details", module.summary) if wide else module.summary)(result, width)


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
    return [name for name, entry in registry.STAGES.items() if not entry.optional or getattr(config, name) is not None]


def question(node: Node, config: Pipeline, device: str) -> dict[str, Any]:
    """The slice of the configuration that the node's key holds, with the plant and the seed."""
    from npred import plants  # brings NumPy, which `npred --help` has no use for

    shared = {"plant": plants.resolve(config.plant, config.parameters).identity, "seed": config.seed}
    return shared | STAGES[node.stage].slice(config, node.model, device)


def sources(node: Node, config: Pipeline) -> dict[str, SourceText]:
    """The files of code behind a node's question: the plant's, those of parts that it names; long ones not."""
    from npred import plants

    files_by_role = {"plant": plants.resolve(config.plant, config.parameters).source}
    loops = ("generate", "evaluate") if node.stage == "bench" else (node.stage,)
    keys = ("predictor",) if node.stage == "bench" else ("predictor", "adaptation")
    specs = {f"{stage}.{key}": getattr(getattr(config, stage, None), key, "") for stage, key in product(loops, keys)}
    if node.stage == "evaluate":
        specs |= {f"evaluate.scenarios[{k}]": s.adaptation or "" for k, s in enumerate(config.evaluate.scenarios)}
    compared = [*config.bench.runtimes, *config.bench.baselines] if node.stage == "bench" else []
    specs |= {f"bench.{registry.called(name)}": name for name in compared}
    specs |= {f"train.{node.model}.network": config.train.table(node.model).architecture} if node.model else {}
    for role, spec in specs.items():
        if registry.named(spec):
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
    models = networks if registry.STAGES[stage].per_network else (None,)
    return [Node(stage, model, _inputs(upstream, [model] if model else networks)) for model in models]


def _inputs(upstream: Iterable[str], networks: Iterable[str]) -> tuple[str, ...]:
    """The names of results of these stages, those of these networks where there is one for each."""
    return tuple(name for above in upstream for name in (networks if registry.STAGES[above].per_network else (above,)))


def _dump(section: Section) -> dict[str, Any]:
    return _words(section.model_dump(mode="json"))


def _words(value: Any) -> Any:
    """JSON has no infinity, and an input bounded on one side only has one: as text it can enter a key."""
    if isinstance(value, dict):
        return {key: _words(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_words(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _own(stage: str, config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    """The stage's table, and the networks where it takes them."""
    table = _loop(config, stage) if isinstance(getattr(config, stage), Loop) else _dump(getattr(config, stage))
    networks = {"train": {"models": config.train.models}} if "train" in registry.STAGES[stage].upstream else {}
    return {stage: table} | networks


def _generate(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    section = _loop(config, "generate")
    source = section.pop("data")
    return {"generate": section | ({"data": _digest(Path(source))} if source else {})}


def _loop(config: Pipeline, stage: str) -> dict[str, Any]:
    """A stage's table; methods and laws of files enter by what they hold, not by where they are.

    A delay law other than the paper's enters; so does an input before t = 0 other than zero, the default where the
    plant's inputs may be zero.
    """
    from npred import plants
    from npred.plants import inputs

    loop: Loop = getattr(config, stage)
    section, law = _dump(loop), registry.DELAY_LAWS.identity(loop.adaptation)
    u0 = inputs.configured(plants.resolve(config.plant, config.parameters), loop, stage)
    section["predictor"] = registry.METHODS.identity(loop.predictor)
    section["gamma"] = _gamma(config, loop)
    if loop.predictor == "semi_implicit" or stage == "evaluate":  # of which a guard may choose it
        section |= plants.resolve(config.plant, config.parameters).mechanics_program
    del section["adaptation"], section["u0"]
    section |= {} if law == PAPER else {"adaptation": law}
    for scenario in section.get("scenarios", []):
        scenario |= {k: registry.DELAY_LAWS.identity(v) for k, v in scenario.items() if k == "adaptation"}
    return section | ({"u0": u0 if isinstance(u0, str) else u0.tolist()} if isinstance(u0, str) or u0.any() else {})


def _gamma(config: Pipeline, loop: Loop) -> float:
    """The gain of the loops; where no law runs that takes one, what older keys have in its place."""
    if loop.gamma is not None:
        return loop.gamma
    from npred import plants
    from npred.loop import delay_law

    law = delay_law.resolve(loop, plants.resolve(config.plant, config.parameters))
    return UNUSED if law is None else law.gamma


def _digest(path: Path) -> str:
    """The digest of a file of data: of what it holds, not of its path."""
    try:
        return sha256(regular(path))
    except OSError as error:
        raise ConfigError(f"generate.data: expected a file at {path}, got: {error.strerror}; check the path") from None


def _train(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    assert model is not None
    table = config.train.table(model)
    identity = {"network": registry.NETWORKS.identity(table.architecture)} if isinstance(table, Network) else {}
    return {"train": {model: _dump(table) | identity}}


def _evaluate(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    return _own("evaluate", config, model, device) | _box(config) | _notation(config) | _held_out(config)


def _held_out(config: Pipeline) -> dict[str, Any]:
    """The settings that the evaluation draws its held-out rows by; the same data may be held out in other shares."""
    section = config.generate
    if section.data or not (section.explore or section.redraw):
        return {}
    keys = ("test_share", "explore", "redraw", "spread", "explore_D", "explore_D_hat0")
    return {"generate": {key: value for key, value in _dump(section).items() if key in keys}}


def _certify(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    """The data's distribution comes with the input; the loops are those of [evaluate]."""
    loops = {k: v for k, v in _loop(config, "evaluate").items() if k not in ("scenarios", "map_D", "map_D_hat0")}
    return {"certify": _dump(config.certify_table), "evaluate": loops, "train": {"models": config.train.models}} | (
        _box(config) | {"generate": _loop(config, "generate")}
    )


def _bench(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    from npred import plants

    table = _own("bench", config, model, device)
    table["bench"]["runtimes"] = [*map(registry.RUNTIMES.identity, config.bench.runtimes)]
    if config.bench.baselines:
        table["bench"]["baselines"] = [*map(registry.BASELINES.identity, config.bench.baselines)]
    table["methods"] = [*map(registry.METHODS.identity, config.methods)]
    table |= plants.resolve(config.plant, config.parameters).mechanics_program
    return table | {"hardware": devices.hardware(device)} | _box(config)


def _box(config: Pipeline) -> dict[str, Any]:
    """The ranges that the plant leaves to the pipeline; data that are simulated in them differ where they do."""
    from npred import plants

    if not config.generate.data:
        return {}
    declared = plants.resolve(config.plant, config.parameters).box
    ranges = {name: ends for name, ends in _dump(config.generate)["box"].items() if name not in declared}
    return {"box": ranges} if ranges else {}


def _report(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    pipeline = _dump(config.beside())
    for stage in ("generate", "evaluate"):
        if pipeline[stage]["u0"] is None:
            del pipeline[stage]["u0"]
        pipeline[stage]["gamma"] = _gamma(config, getattr(config, stage))
    return {"pipeline": pipeline} | _notation(config)


def _notation(config: Pipeline) -> dict[str, Any]:
    """The labels of figures: other labels draw them again, and train nothing."""
    from npred import plants

    declared = plants.resolve(config.plant, config.parameters).notation
    return {"notation": declared} if declared else {}


SLICES: dict[str, Slice] = {
    "generate": _generate, "train": _train, "evaluate": _evaluate, "certify": _certify, "bench": _bench,
    "report": _report,
}  # fmt: skip
STAGES = {
    name: Stage(entry.version, entry.upstream, SLICES.get(name, partial(_own, name)), entry.module, entry.result)
    for name, entry in registry.STAGES.items()
}
