"""`npred export`: a trained model for another program, checked on held-out samples; the controller of a pipeline's
evaluated loop as C99 with a test inside, and as a Functional Mock-up Unit.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from npred import config, defaults, grid, operators, plants
from npred.cli import data_exchange
from npred.cli.options import Exporting, writable, writable_folder
from npred.conditions import condition
from npred.config import Evaluate
from npred.data import shards
from npred.data.dataset import Dataset
from npred.errors import ConfigError, imported, unlisted
from npred.loop.adaptation import DelayAdaptation
from npred.loop.controller import Controller
from npred.loop.loop import HISTORY
from npred.loop.watchdog import Watchdog
from npred.operators import TrainedOperator
from npred.pipeline import Stored, load_model
from npred.plants import Plant, inputs
from npred.predictors import Predictor, numerical
from npred.predictors.guarded import Guarded
from npred.runtimes import Samples, c_controller, c_files, c_network, fmu
from npred.runtimes.fused import Fused

NX = 101  # nodes of a model's file
COMPARED = 200  # held-out samples
NO_LIBRARY = "sources only, for there is no C compiler here; install one, or let the importer build them"
NO_PLACE = "sources only, for FMI 2.0 has no name for this machine; take --fmi 3, or let the importer build them"
RECALLS = (
    "the paper's law (12) is made for a measured u, and loses 16 of 30 loops of the paper's plant with its own "
    'commands (docs/delay_laws.md), DelayObserver none; set adaptation = "delay-observer" in [evaluate]'
)


class Built(NamedTuple):
    """A pipeline's controller, its name in words, and the table of its loop."""

    controller: Controller
    about: str
    table: Evaluate

    def document(self, options: Exporting, form: str) -> dict[str, object]:
        """What the JSON document says about the controller."""
        controller = self.controller
        return {
            "format": form, "plant": controller.plant.name, "predictor": controller.predictor.name,
            "nx": controller.predictor.nx, "precision": options.precision, "actuator": controller.actuator,
            "guarded": controller.predictor.guard is not None,
        }  # fmt: skip


def export(options: Exporting, form: str, key: str, output: Path | None) -> None:
    """Write the file. Raises ConfigError for a format that there is none of, NpredError for a graph that differs."""
    if (nx := options.nx) is not None and nx < 2:
        raise ConfigError(f"--nx: expected at least 2 nodes, both ends of [0, 1], got {nx}; dx = 0.01 is nx = 101")
    forms: dict[str, Callable[[], None]] = {
        **dict.fromkeys(("onnx", "c"), lambda: _model(options, form, key, output)),
        "controller": lambda: _controller_files(options, key, output),
        "fmu": lambda: _fmu(options, key, output),
        **dict.fromkeys(data_exchange.WRITERS, lambda: data_exchange.export(options, form, key, output)),
    }
    if form not in forms:
        raise ConfigError(unlisted("export", form, forms))
    forms[form]()


def _model(options: Exporting, form: str, key: str, output: Path | None) -> None:
    """P and U of a trained model as a file, compared on held-out samples where it can be run here."""
    nx = options.nx or NX
    onnx = imported("export onnx", "npred.runtimes.onnx", "onnx") if form == "onnx" else None
    stored, operator = _loaded(options, key)
    path = writable(output or Path(f"{stored.model}-{nx}.{form}"))
    source = options.results.find(str(stored.folder)).manifest.question.inputs["generate"]
    data = options.results.get("generate", source.key)
    if data is None:
        raise ConfigError(
            f"export: expected the model's data {source.key[:12]} in {options.store}, got none; generate it"
        )
    samples = _samples(shards.survey(data.verify().folder / "data.h5").subset(test=True), nx)
    if onnx is None:
        errors = c_network.export(operator, stored.plant, path, nx, samples)
    else:
        errors = onnx.export(operator.module(stored.plant), stored.plant, path, nx, samples, options.atol)
    document = {"file": str(path), "format": form, "model": stored.model, "nx": nx}
    line, count = f"{path}: P and U of {stored.model} on {nx} nodes", len(samples[0])
    if errors is None:
        options.show(document, lambda: f"{line}; not compared, for there is no C compiler here")
        return
    error, eps = errors  # on some held-out samples, and on other nodes than evaluate's: not its ε sup
    of_model = f"within {error:.2g} of the model, whose error there is {eps:.2g}"
    document |= {"error": error, "eps": eps, "samples": count}
    options.show(document, lambda: f"{line}; on {count} held-out samples {of_model}")


def _samples(held_out: Dataset, nx: int) -> Samples:
    """At most COMPARED samples on nx nodes, spread over the data; a time that is not known is 0."""
    rows = np.linspace(0, len(held_out) - 1, min(COMPARED, len(held_out))).astype(int)
    return held_out.X[rows], grid.means(held_out.u[rows], nx), held_out.D_hat[rows], np.nan_to_num(held_out.t[rows])


def _loaded(
    options: Exporting, spec: str, plant: Plant | None = None, precision: type[np.floating] = np.float32
) -> tuple[Stored, TrainedOperator]:  # fmt: skip
    """The trained network of a key, for `plant` or, without one, for the plant that the key names."""
    stored = load_model(spec, options.store, options.set)
    return stored, operators.read(stored.folder, plant or stored.plant, stored.snapshot, precision, stored.config)


def _controller_files(options: Exporting, key: str, output: Path | None) -> None:
    """Write the header and the source, and the gateway of a MEX file.

    Raises ConfigError as npred.runtimes.c_controller.sources does.
    """
    folder = writable_folder(output or Path(options.name), "controller")
    built = _built(options, key)
    files, digest = c_controller.write(
        built.controller, folder, options.name, options.precision, built.about, options.mex
    )
    written = [str(file) for file in files]
    document = {"files": written} | built.document(options, "controller") | {"digest": digest}
    options.show(document, lambda: f"{', '.join(written)}: {built.controller!r} in {options.precision} precision")


def _fmu(options: Exporting, key: str, output: Path | None) -> None:
    """Write the FMU. Raises ConfigError as npred.runtimes.fmu.write does."""
    path = writable(output or Path(f"{options.name}.fmu"))
    built = _built(options, key)
    written = fmu.write(
        built.controller, path, version=options.fmi, name=options.name, precision=options.precision, model=built.about,
        X0=built.table.X0 or built.controller.plant.target(0.0), t_end=built.table.t_end,
        platforms=list(filter(None, options.platforms.split(","))),
    )  # fmt: skip
    document = {"file": str(path)} | built.document(options, "fmu") | {
        "fmi": options.fmi, "library": written.library, "libraries": written.libraries, "token": written.token,
        "variables": [variable.name for variable in written.variables],
    }  # fmt: skip
    without = NO_PLACE if c_files.compiler() else NO_LIBRARY
    holds = f"{', '.join(written.libraries)} and sources" if written.libraries else without
    options.show(document, lambda: f"{path}: {built.controller!r} as FMI {options.fmi}.0, {holds}")


def _built(options: Exporting, key: str) -> Built:
    """The controller that a key and the flags mean. Raises ConfigError where there is none."""
    path, model = _named(key, options.predictor)
    pipeline = config.load(path, options.overrides)
    table, plant = pipeline.evaluate, plants.resolve(pipeline.plant, pipeline.parameters, pipeline.kappa)
    predictor = _predictor(options, f"{path}:{model}" if model else "", plant, table)
    more = {"max_sample_age": options.oldest, "watchdog": watchdog(options.watchdog)}
    controller = of_table(plant, predictor, table, **more)
    if controller.actuator == HISTORY and isinstance(controller.adaptation, DelayAdaptation):
        options.console.warn(RECALLS)
    return Built(controller, f"{pipeline.name}:{predictor.name}", table)


def _named(key: str, predictor: str) -> tuple[Path, str]:
    """The pipeline file and the network that a key means; no network where the predictor is a numerical one."""
    path, colon, model = key.rpartition(":")
    if predictor:
        return defaults.pipeline(path if colon else key), ""
    if not colon and (key.endswith(".toml") or "/" in key or key in defaults.shipped()):
        raise ConfigError(f"{key}: expected PIPELINE:MODEL, got no model; add one, or give --predictor rk4")
    return defaults.pipeline(path), model


def _predictor(options: Exporting, spec: str, plant: Plant, table: Evaluate) -> Predictor:
    nx = options.nx or table.nx
    exact = numerical(table.predictor, plant, nx)
    if not spec:
        predictor: Predictor = numerical(options.predictor, plant, nx)
    else:
        precision = np.float32 if options.precision == "float" else np.float64
        stored, operator = _loaded(options, spec, plant, precision)
        predictor = Fused(plant, operator, nx, stored.model, precision=precision)
    guard = dict(table.guard) if table.guard and spec else {}
    if options.guard is not None:
        guard["tolerance"] = options.guard
    return Guarded(predictor, exact=exact, **guard) if guard else predictor


def of_table(plant: Plant, predictor: Predictor, table: Evaluate, **more: Any) -> Controller:
    """The controller of the evaluated loop; `more` as in npred.Loop."""
    limits = inputs.bounds(plant, table.input_bounds)
    start = np.array([table.X0]) if table.X0 else np.zeros((1, plant.n))
    u0 = inputs.before(plant, table.u0, limits, start)[0] if table.u0 == inputs.LAW else table.u0
    D_hat = None if plant.declares_delay else table.D_hat0
    return Controller(replace(condition.described(table, plant, predictor), D_hat=D_hat, u0=u0, **more))


def watchdog(text: str) -> Watchdog | None:
    """That of TIME[:hold|zero]; None without a text. Raises ConfigError for another one."""
    if not text:
        return None
    after, _, then = text.partition(":")
    try:
        seconds = float(after)
    except ValueError:
        raise ConfigError(f"--watchdog: expected TIME[:hold|zero], got {text!r}; as 0.2:zero") from None
    return Watchdog(seconds, then or "hold")
