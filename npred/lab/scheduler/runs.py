"""generate, train and evaluate from Python: the stages of the command line, its store and its keys.

What they bring is in the store afterwards, and a second call takes it from there, as `npred` does. On a terminal they
show the live view of the command line, in a notebook one output below the cell that is updated in place.
"""

import re
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from npred import plants
from npred.base import defaults, devices, registry
from npred.base.errors import ConfigError, unlisted
from npred.base.notebook import InNotebook
from npred.base.progress import listener
from npred.lab import config
from npred.lab.config import Pipeline
from npred.lab.config.results import Evaluated, Generated, Result, Trained
from npred.lab.report.terminal import live_view
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler import executors
from npred.lab.scheduler.plan import STAGES, Planner, nodes
from npred.lab.scheduler.retention import remember
from npred.lab.scheduler.runner import Runner
from npred.lab.store import Store
from npred.plants import Plant
from npred.prediction.methods import Predictor

if TYPE_CHECKING:
    from npred.lab.training.data.dataset import Dataset

Kind = TypeVar("Kind", bound=Result)
Found = TypeVar("Found", bound="StageResult[Any]")
Source = Plant | str | Path | Pipeline


@dataclass(frozen=True)
class StageResult(InNotebook, Generic[Kind]):
    """The result of a stage: `result`, its numbers by name; `folder` and `key` in the store; `action`, `hit` or `run`.

    `print` shows what the command line prints of it.
    """

    result: Kind
    folder: Path
    key: str
    action: str
    stage: str
    plant: Plant = field(repr=False)
    pipeline: Pipeline = field(repr=False)

    def __str__(self) -> str:
        return STAGES[self.stage].summary(self.result.json_object(), 120)


@dataclass(frozen=True)
class GenerateResult(StageResult[Generated]):
    """Rows of (X, u, D_hat) -> P from closed loops; `result` says how many there are, and which are held out."""

    @cached_property
    def data(self) -> "Dataset":
        """The rows: X (N, n), u (N, nx, m), D_hat (N,) in seconds, P (N, nx, n), and `test`, 1 where held out."""
        from npred.lab.training.data.dataset import Dataset

        return Dataset.read(self.folder / "data.h5")


@dataclass(frozen=True)
class TrainResult(StageResult[Trained]):
    """A trained network; `result` has its errors on held-out rollouts."""

    @cached_property
    def network(self) -> Predictor:
        """The network as a predictor, as `npred.load` gives it: P (..., nx, n) of X, u and D_hat."""
        return self.load()

    def load(self, nx: int = 101, device: str = "cpu", runtime: str | None = None) -> Predictor:
        """The same for loops on nx nodes, on a device, in a runtime: see `npred.load`."""
        from npred.lab.scheduler.models import Stored, loaded

        name = self.result.model
        return loaded(Stored(self.folder, name, None, self.plant, self.pipeline.train.table(name)), nx, device, runtime)


def resolved(source: Source, settings: Mapping[str, Any] = {}) -> Pipeline:
    """The pipeline of a source, with some of its keys changed; see `generate`.

    Raises ConfigError for what there is none of, for an unknown key and for a value out of range.
    """
    if not isinstance(settings, Mapping):
        raise ConfigError(f"settings: expected keys and values, got {settings!r}; write {{'generate.samples': 2000}}")
    chosen = table(source)
    for key, value in settings.items():
        plain = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        config.put(chosen, key, plain, "settings: ")
    return config.parse(chosen, str(source) if isinstance(source, str | Path) else str(chosen["name"]))


def generate(
    source: Source, *, settings: Mapping[str, Any] = {}, store: str | Path | None = None, jobs: int | None = None,
    progress: bool = True,
) -> GenerateResult:  # fmt: skip
    """Data to train on, from closed loops with a numerical predictor: `npred generate` from Python.

    Parameters
    ----------
    source : str, Path, Pipeline or Plant
        A pipeline, by its file or its name, or a plant, of npred.plant or as "my_plant.py:Tank", for which the
        defaults hold. A name of both is the pipeline's.
    settings : dict, optional
        Keys of the pipeline, as those of --set, with their values: {"train.deeponet.epochs": 20}.
    store : str or Path, optional
        Folder of results; by default NPRED_STORE, else artifacts/. What it has is not made again.
    jobs : int, optional
        Processes and threads; by default all cores.
    progress : bool, default True
        Whether it shows more than warnings.

    Returns
    -------
    GenerateResult
        Rows of (X, u, D_hat) -> P from closed loops; `result` says how many there are, and which are held out.

    Raises
    ------
    ConfigError
        For a source that is not there and for settings that do not fit.
    DivergedError
        For a loop that overflows.
    StoreError
        For corrupt results.
    """
    return run_stage(GenerateResult, "generate", source, settings, None, store, "auto", jobs, progress)


def train(
    source: Source, model: str | None = None, *, settings: Mapping[str, Any] = {}, store: str | Path | None = None,
    device: str = "auto", jobs: int | None = None, progress: bool = True,
) -> TrainResult:  # fmt: skip
    """A network trained to predict, on the data of `generate`: `npred train` from Python.

    An interrupted training goes on from its checkpoint. `network` of what it returns is a predictor.

    Parameters
    ----------
    source : str, Path, Pipeline or Plant
        A pipeline, by its file or its name, or a plant, of npred.plant or as "my_plant.py:Tank", for which the
        defaults hold. A name of both is the pipeline's.
    model : str, optional
        The network, as "fno"; by default the first of the pipeline.
    settings : dict, optional
        Keys of the pipeline, as those of --set, with their values: {"train.deeponet.epochs": 20}.
    store : str or Path, optional
        Folder of results; by default NPRED_STORE, else artifacts/. What it has is not made again.
    device : "auto", "cpu", "cuda" or "cuda:N", default "auto"
        Where networks run.
    jobs : int, optional
        Processes and threads; by default all cores.
    progress : bool, default True
        Whether it shows more than warnings.

    Returns
    -------
    TrainResult
        A trained network; `result` has its errors on held-out rollouts.

    Raises
    ------
    ConfigError
        For a source or a network that is not there and for settings that do not fit.
    MissingError
        For a device or a package that is not there.
    DivergedError
        For a loop or a loss that overflows.
    StoreError
        For corrupt results.
    """
    name = model or resolved(source, settings).train.models[0]
    return run_stage(TrainResult, "train", source, settings, name, store, device, jobs, progress)


def evaluate(
    source: Source, *, settings: Mapping[str, Any] = {}, store: str | Path | None = None, device: str = "auto",
    jobs: int | None = None, progress: bool = True,
) -> StageResult[Evaluated]:  # fmt: skip
    """The errors of a pipeline's networks, in predictions and in closed loops: `npred evaluate` from Python.

    What the store does not have is generated and trained first. `result.models` has the scores of each contender
    (npred.lab.config.results.Evaluated). {"train.models": ["deeponet"]} in `settings` evaluates one network.

    Parameters
    ----------
    source : str, Path, Pipeline or Plant
        A pipeline, by its file or its name, or a plant, of npred.plant or as "my_plant.py:Tank", for which the
        defaults hold. A name of both is the pipeline's.
    settings : dict, optional
        Keys of the pipeline, as those of --set, with their values: {"train.deeponet.epochs": 20}.
    store : str or Path, optional
        Folder of results; by default NPRED_STORE, else artifacts/. What it has is not made again.
    device : "auto", "cpu", "cuda" or "cuda:N", default "auto"
        Where networks run.
    jobs : int, optional
        Processes and threads; by default all cores.
    progress : bool, default True
        Whether it shows more than warnings.

    Returns
    -------
    StageResult
        The result of a stage: `result`, its numbers by name; `folder` and `key` in the store; `action`, `hit` or `run`.

    Raises
    ------
    ConfigError
        For a source that is not there and for settings that do not fit.
    MissingError
        For a device or a package that is not there.
    DivergedError
        For a loop or a loss that overflows.
    StoreError
        For corrupt results.
    """
    return run_stage(StageResult, "evaluate", source, settings, None, store, device, jobs, progress)


def run_stage(
    kind: type[Found], stage: str, source: Source, settings: Mapping[str, Any], model: str | None,
    store: str | Path | None, device: str, jobs: int | None, progress: bool,
) -> Found:  # fmt: skip
    """The result of a stage as that kind, from the store or run with all that the stage needs.

    On a terminal a table shows the stages, in a notebook one output, elsewhere lines now and then.
    """
    pipeline = resolved(source, settings)
    if model is not None and model not in pipeline.train.names:
        raise ConfigError(unlisted("model", model, pipeline.train.names))
    planner = Planner(pipeline, Store(Path(store) if store else defaults.store()), devices.resolve(device))
    needed, jobs = nodes(pipeline, [stage], model), jobs or devices.cores()
    shown: Callable[[], Console] = live_view.NotebookConsole if live_view.is_notebook() else Console
    console = shown() if progress else Console(quiet=True)
    with ExitStack() as stack:
        stack.enter_context(listener(console.wait))
        stack.enter_context(console.watch(pipeline.name, [node.title for node in needed]))
        devices.require(planner.device)
        executor = stack.enter_context(executors.opened(executors.LOCAL, jobs))
        planner.store.adopt()
        outcomes = Runner(console, jobs, executor).run(planner, needed)
    file = None if settings else _file(source)  # with settings it does not ask for the results
    if file:  # so that npred gc keeps them
        remember(planner.store, file, {done.node.name: done.artifact.manifest.key for done in outcomes})
    done, artifact = outcomes[-1], outcomes[-1].artifact
    result = STAGES[stage].result.read(artifact.folder)
    return kind(result, artifact.folder, artifact.manifest.key, done.action, stage, planner.plant, pipeline)


def table(source: Source) -> dict[str, Any]:
    """The pipeline as a plain dictionary; that of a plant has the defaults."""
    if isinstance(source, Plant):
        if source.spec is None:
            what = f"plant {source.name}: expected one with a name or a file, by which results are kept"
            cure = "write it to a file, and name that: my_plant.py:Tank"
            raise ConfigError(f"{what}, got a class; {cure}")
        if source.law and not source.law_table:
            what = f"plant {source.name}: expected a kappa by its name, by which results are kept"
            cure = "write it to the plant's file"
            raise ConfigError(f"{what}, got a function; {cure}")
        law = {"kappa": dict(source.law_table)} if source.law_table else {}
        name = re.sub(r"\W+", "_", source.name)
        return {"name": name, "plant": source.spec, "parameters": dict(source.parameters)} | law
    if not isinstance(source, str | Path | Pipeline):
        what, cure = "source: expected a pipeline or a plant, by name, file or as an object", "name one"
        raise ConfigError(f"{what}, got {source!r}; {cure}")
    if isinstance(source, Pipeline):
        return source.model_dump(exclude_unset=True)
    if _file(source):
        return config.table(defaults.pipeline(source))
    if not registry.in_file(str(source)) and str(source) not in plants.names():
        raise ConfigError(f"{defaults.missing(Path(source))}, nor a plant of that name; npred plants lists those")
    return table(plants.resolve(str(source)))


def _file(source: Source) -> Path | None:
    """The pipeline file that a text names, as the command line takes it; None where it names a plant."""
    if not isinstance(source, str | Path):
        return None
    path = defaults.pipeline(source)
    return path if path.is_file() or path.suffix == ".toml" else None
