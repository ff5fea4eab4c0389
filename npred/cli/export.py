"""`npred export`: the controller of a pipeline's evaluated loop, or a trained model, for another program."""

import inspect
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from npred import exports, plants
from npred.base import defaults, grid
from npred.base.errors import ConfigError
from npred.cli.options import Exporting, ExportingLoop, argument, flag, writable, writable_folder
from npred.exports import FORMATS, NetworkAlone, WholeController
from npred.guard.guarded import Guarded
from npred.lab import config
from npred.lab.config import PAPER, Evaluate, conditions
from npred.lab.scheduler.models import held_out, load_model
from npred.loop.acts import HISTORY
from npred.loop.controller import Controller
from npred.loop.watchdog import Watchdog
from npred.networks import weights
from npred.networks.fused import Fused
from npred.plants import Plant, inputs
from npred.prediction.methods import Predictor, numerical

NX = 101  # nodes of a model's file
COMPARED = 200  # held-out samples
RECALLS = (
    "the paper's law (12) is made for a measured u; with u from the commands 16 of 30 loops of the paper's plant "
    'do not converge (docs/delay_laws.md), with DelayObserver none; set adaptation = "delay-observer" in [evaluate]'
)


def format_command(form: str) -> Callable[..., None]:
    """The command that writes the files of a format, whose options are its flags, and describes them."""
    declared = FORMATS[form]

    def write(
        options: Exporting,
        *,
        key: Annotated[str, argument("KEY", "PIPELINE:MODEL, MODEL, or the folder or key of a result.")],
        output: Annotated[
            Path | None,
            flag("The file, or a folder for `controller`; by default named after the model.", "-o", "--output"),
        ] = None,
        **values: Any,
    ) -> None:
        if (nx := options.nx) is not None and nx < 2:
            raise ConfigError(f"--nx: expected at least 2 nodes, both ends of [0, 1], got {nx}; dx = 0.01 is nx = 101")
        written = exports.writer(form, values)
        if output is not None:
            writable(output) if declared.suffix else writable_folder(output, form)
        if isinstance(options, ExportingLoop):
            of: WholeController | NetworkAlone = _loop(options, key, values["precision"])
            path = output or Path(values["name"] + declared.suffix)
        else:
            of = _network(options, key)
            path = output or Path(f"{of.name}-{of.nx}{declared.suffix}")
        files, facts, text = written(of, path)
        document = {"files": [str(file) for file in files], "format": form} | of.facts | values | facts
        options.show(document, lambda: f"{', '.join(map(str, files))}: {text}")

    first, *shared, _ = inspect.signature(write).parameters.values()
    flags = []
    for name, option in declared.options.items():
        kind = str if option.default == () else type(option.default)
        annotation = Annotated[kind, flag(option.help, word=option.word)]
        flags.append(
            first.replace(
                name=name, kind=inspect.Parameter.KEYWORD_ONLY, default=option.default or "", annotation=annotation
            )
        )
    first = first.replace(annotation=Exporting if declared.network else ExportingLoop)
    write.__signature__ = inspect.Signature([first, *shared, *flags])  # type: ignore[attr-defined]
    return write


def _network(options: Exporting, key: str) -> NetworkAlone:
    """A trained model, and held-out samples of its data on as many nodes; a time that is not known is 0."""
    if key.endswith(".toml") or key in defaults.shipped():
        todo = f"write {key}:deeponet; without a network, npred export controller {key} --predictor heun"
        raise ConfigError(f"{key}: expected PIPELINE:MODEL, a trained network, got no model; {todo}")
    nx, stored = options.nx or NX, load_model(key, options.store, options.set)
    operator = weights.read(stored.folder, stored.plant, stored.snapshot, np.float32, stored.config)
    rows = held_out(stored, options.results)
    chosen = np.linspace(0, len(rows) - 1, min(COMPARED, len(rows))).astype(int)
    u, t = grid.means(rows.u[chosen], nx), np.nan_to_num(rows.t[chosen])
    return NetworkAlone(operator, stored.plant, nx, (rows.X[chosen], u, rows.D_hat[chosen], t), stored.model)


def _loop(options: ExportingLoop, key: str, precision: str) -> WholeController:
    """The controller that a key and the flags mean; of a pipeline that names no networks, with its predictor.

    Raises ConfigError where there is none.
    """
    path, colon, model = key.rpartition(":")
    whole = not colon and bool(options.predictor or key.endswith(".toml") or "/" in key or key in defaults.shipped())
    file, model = defaults.pipeline(key if whole else path), "" if whole or options.predictor else model
    pipeline = config.load(file, options.overrides)
    if whole and not options.predictor and "train" in pipeline.model_fields_set:
        raise ConfigError(f"{key}: expected PIPELINE:MODEL, got no model; add one, or give --predictor rk4")
    table, plant = pipeline.evaluate, plants.resolve(*pipeline.of_plant)
    nx = options.nx or table.nx
    exact = numerical(table.predictor, plant, nx)
    guard = dict(table.guard) if table.guard and model else {}
    guard |= {} if options.guard is None else {"tolerance": options.guard}
    if model:
        kind = np.float32 if precision == "float" else np.float64
        stored = load_model(f"{file}:{model}", options.store, options.set)
        operator = weights.read(stored.folder, plant, stored.snapshot, kind, stored.config)
        predictor: Predictor = Fused(plant, operator, nx, stored.model, precision=kind)
    else:
        predictor = numerical(options.predictor or table.predictor, plant, nx)
    predictor = Guarded(predictor, exact=exact, **guard) if guard else predictor
    flags = {"max_sample_age": options.max_sample_age, "watchdog": watchdog(options.watchdog)}
    controller = of_table(plant, predictor, table, **{key: value for key, value in flags.items() if value is not None})
    if controller.actuator == HISTORY and table.adaptation == PAPER:
        options.console.warn(RECALLS)
    about = f"{pipeline.name}:{predictor.name}"
    return WholeController(controller, about, table.X0 or plant.target(0.0), table.t_end)


def of_table(plant: Plant, predictor: Predictor, table: Evaluate, **more: Any) -> Controller:
    """The controller of the evaluated loop; `more` as in npred.Loop."""
    limits = inputs.bounds(plant, table.input_bounds)
    start = np.array([table.X0]) if table.X0 else np.zeros((1, plant.n))
    u0 = inputs.before(plant, table.u0, limits, start)[0] if table.u0 == inputs.LAW else table.u0
    D_hat = None if plant.declares_delay else table.D_hat
    loop = conditions.described(table, plant, predictor, D_hat=D_hat, **more)
    return Controller(replace(loop, u0=u0) if loop.keeps_commands else loop)


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
