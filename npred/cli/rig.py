"""`npred rig`: the evaluated loop of a pipeline in real time, a plant and a controller as two processes."""

import math
import multiprocessing
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from npred import api, figures, plants
from npred.cli import export
from npred.cli.options import Rigged, drawable, writable
from npred.conditions import condition
from npred.config import Evaluate
from npred.errors import ConfigError, NpredError, UnmetError
from npred.figures.style import MEDIA
from npred.loop import loop_checks, metrics
from npred.loop.adaptation import DelayAdaptation
from npred.loop.controller import OLDEST, Controller
from npred.loop.loop import HISTORY
from npred.parallel import executors
from npred.pipeline import load_model
from npred.plants import Plant
from npred.predictors import numerical
from npred.predictors.guarded import Guarded
from npred.rig import clock, controller_side, log, network, plant_side
from npred.rig.network import Channel
from npred.terminal import interruption

EVERY = 0.1  # s between two looks at the processes
AHEAD = 0.1  # s from the agreement to the start


def rig(options: Rigged, output: Path | None, figure: Path | None) -> None:
    """Run it and say what its log says. Raises NpredError where a side was lost, UnmetError where the loop was."""
    if not 0 < options.seconds < math.inf:
        raise ConfigError(f"--seconds: expected a time above 0, got {options.seconds:g}; give seconds")
    channel = Channel(options.delay, options.jitter, options.loss, options.reorder, options.stops, options.seed)
    path, plot = writable(output or Path(f"{options.config.name}-rig.csv")), figure and drawable(figure)
    plant = plants.resolve(options.config.plant, options.config.parameters, options.config.kappa)
    if plant.declares_delay or not plant.one_delay or plant.time_unit != "s":
        raise ConfigError(f"rig: expected a plant with one delay and in seconds, got {plant.name}; take another")
    controller = _controller(options, plant, channel)
    _check(options.config.evaluate, controller)
    with interruption.orderly("interrupted; the log has all up to then"):
        late = run(options, plant, controller, channel, path)
    written = log.read(path)
    if written.why != log.OVER:
        raise NpredError(f"rig: expected a whole run, got an end, {written.why or 'a side was killed'}; read {path}")
    if plot:
        figures.write(figures.rig(plant, plot.stem, *written[:2]), plot.parent, MEDIA["page"], [plot.suffix[1:]])
    document = log.summary(plant, written, controller.dt) | log.micro("waits_late", late) | {"log": str(path)}
    rows = [[name, f"{x:.4g}" if isinstance(x, float) else str(x)] for name, x in document.items()]
    options.show_table(document, ("of the log", ""), rows)
    near, radius = metrics.LOST * metrics.size(plant.target(0.0)), document["radius"]
    if radius is None or radius > max(log.distance(plant, written.samples)[0], near):
        away = "that left the finite numbers" if radius is None else f"{radius:.3g} away at the end"
        raise UnmetError(f"rig: expected a loop that stays, got one {away}; read {path}")


def run(options: Rigged, plant: Plant, controller: Controller, channel: Channel, path: Path) -> np.ndarray:
    """Run both sides until they end, or this process is asked to; how late a process comes, in seconds, that only
    waits for the same times. Raises NpredError where one ends before it begins.
    """
    context, ends, seconds = multiprocessing.get_context("spawn"), network.pair(), options.seconds
    table, console = options.config.evaluate, options.console
    truth = condition.truth(plant, table) or plant
    work: list[tuple[Any, tuple[Any, ...]]] = [
        (controller_side.run, (controller, ends[0], channel, seconds, path)),
        (plant_side.run, (truth, table, controller.u0, controller.observer, ends[1], channel)),
        (clock.only_wait, (controller.dt, seconds)),
    ]
    pipes, sides = [context.Pipe() for _ in work], []
    path.unlink(missing_ok=True)
    try:
        for (target, values), (_, theirs) in zip(work, pipes, strict=True):
            side = context.Process(target=target, args=(*values, theirs))
            with executors.deaf():
                side.start()
            sides.append(side)
            theirs.close()  # else this process would keep open what a side closes by its end
        for end in ends:
            end.close()
        ours = [pipe for pipe, _ in pipes]
        start = _begin(ours)
        with console.bar("rig", math.ceil(seconds), "seconds") as bar:
            while sides[0].is_alive():
                time.sleep(EVERY)
                console.head(last := log.last_row(path))
                bar.advance(min(int(time.monotonic() - start), bar.total) - bar.done, last)
        return ours[2].recv() if ours[2].poll(2 * AHEAD) else np.zeros(1)
    finally:
        for pipe, _ in pipes:
            pipe.close()
        for side in sides:
            side.join(interruption.GRACE / 2)
            side.kill()


def _begin(pipes: list[Connection]) -> float:
    """Wait until all are ready, and tell them when to begin."""
    for pipe in pipes:
        while not pipe.poll(EVERY):
            interruption.check()
        try:
            pipe.recv()
        except EOFError:
            raise NpredError("rig: expected three processes that begin, got one that ended; read its message") from None
    start = time.monotonic() + AHEAD
    for pipe in pipes:
        pipe.send(start)
    return start


def _check(table: Evaluate, controller: Controller) -> None:
    """Raise ConfigError for keys of [evaluate] that the rig does not honour, or that do not fit the plant."""
    plant, observer = controller.plant, controller.observer
    sensors = {f"measurement.{key}": getattr(table.measurement, key) for key in ("jitter", "delay", "drop")}
    if keys := [f"evaluate.{key}" for key, value in (sensors | {"timing": table.timing}).items() if value]:
        cure = "leave it out, and describe the network by --delay, --jitter, --loss and --stops"
        raise ConfigError(f"rig: expected no delays, losses or clock but its own, got {', '.join(keys)}; {cure}")
    if table.X0:
        loop_checks.start(plant, np.array(table.X0))
    table.measurement.check(plant, observer and len(observer.outputs))


def _controller(options: Rigged, plant: Plant, channel: Channel) -> Controller:
    table = options.config.evaluate
    exact = predictor = numerical(table.predictor, plant, table.nx)
    if options.model:
        stored = load_model(f"{options.pipeline}:{options.model}", options.store, options.set)
        predictor = api.loaded(stored, table.nx, "cpu", None)
        predictor = Guarded(predictor, exact=exact, **dict(table.guard)) if table.guard else predictor
    age = max(OLDEST * table.dt, 2 * channel.longest)
    more = {"max_sample_age": age, "watchdog": export.watchdog(options.watchdog)}
    controller = export.of_table(plant, predictor, table.model_copy(update={"actuator": HISTORY}), **more)
    if isinstance(controller.adaptation, DelayAdaptation):
        options.console.warn(export.RECALLS)
    return controller
