"""`npred rig`: the evaluated loop of a pipeline in real time, a plant and a controller as two processes."""

import math
import multiprocessing
import time
from pathlib import Path
from typing import Any

import numpy as np

from npred import plants
from npred.base.errors import ConfigError, NpredError, UnmetError
from npred.cli import export
from npred.cli.options import drawable, writable
from npred.estimation.adaptation import DelayAdaptation
from npred.guard.guarded import Guarded
from npred.lab.config import conditions
from npred.lab.report import figures
from npred.lab.report.figures.style import MEDIA
from npred.lab.report.terminal import interruption
from npred.lab.scheduler import executors
from npred.lab.scheduler.models import load_model, loaded
from npred.loop import loop_checks, metrics, settable
from npred.loop.acts import HISTORY
from npred.loop.assembly import OLDEST
from npred.loop.controller import Controller
from npred.loop.timing import LATENCIES, ControlClock
from npred.plants import Plant
from npred.prediction.methods import numerical
from npred_rig import log, network, sides
from npred_rig.network import Channel
from npred_rig.options import Rigged

EVERY = 0.1  # s between two looks at the processes
AHEAD = 0.1  # s from the agreement to the start


def rig(options: Rigged, output: Path | None, figure: Path | None) -> None:
    """Run it and report its log. Raises NpredError if a side ends early, UnmetError if the loop ends far from rest."""
    if not 0 < options.seconds < math.inf:
        raise ConfigError(f"--seconds: expected a time above 0, got {options.seconds:g}; give seconds")
    timing = options.config.evaluate.timing or ControlClock()
    ways = zip(("samples", "commands"), LATENCIES, strict=True)
    latencies = {way: latency for way, name in ways if (latency := getattr(timing, name))}
    numbers = options.latency, options.jitter, options.loss, options.reorder, options.stops, options.seed
    channel = Channel(*numbers, latencies)
    path, plot = writable(output or Path(f"{options.pipeline.stem}-rig.csv")), figure and drawable(figure)
    plant = plants.resolve(*options.config.of_plant)
    if plant.declares_delay or not plant.one_delay or plant.time_unit != "s":
        raise ConfigError(f"rig: expected a plant with one delay and in seconds, got {plant.name}; take another")
    controller = _controller(options, plant, channel)
    setpoints, bounds = conditions.setpoints(options.config.evaluate), controller.settings.input_bounds
    course = settable.course(plant, setpoints, controller.fixed, bounds)
    with interruption.graceful("interrupted; the log has everything up to then"):
        late = run(options, plant, controller, course, channel, path)
    written = log.read(path)
    if written.why != log.OVER:
        why = written.why or "a side was killed"
        raise NpredError(f"rig: expected a complete run, it ended early: {why}; read {path}")
    if plot:
        figures.write(log.figure(plant, plot.stem, written), plot.parent, MEDIA["page"], [plot.suffix[1:]])
    document = log.summary(plant, course, written, controller.dt) | log.micro("waits_late", late) | {"log": str(path)}
    rows = [[name, f"{x:.4g}" if isinstance(x, float) else str(x)] for name, x in document.items()]
    options.show_table(document, ("of the log", ""), rows)
    near, radius = metrics.FAR * metrics.size(plant.target(0.0)), document["radius"]
    if radius is None or radius > max(log.distance(plant, course, written.samples)[0], near):
        away = "that overflows" if radius is None else f"that ends {radius:.3g} away"
        raise UnmetError(f"rig: expected a loop that stays near rest, got one {away}; read {path}")


def run(
    options: Rigged, plant: Plant, controller: Controller, course: list[settable.Piece], channel: Channel, path: Path
) -> np.ndarray:
    """Run both sides until they end, or this process is asked to; how late a process comes, in seconds, that only
    waits for the same times. Raises NpredError where one ends before it begins.
    """
    context, ends, seconds = multiprocessing.get_context("spawn"), network.pair(), options.seconds
    table, console = options.config.evaluate, options.console
    truth = conditions.truth(plant, table) or plant
    work: list[tuple[Any, tuple[Any, ...]]] = [
        (sides.control, (controller, course, ends[0], channel, seconds, path)),
        (sides.simulate, (truth, table, controller.u0, controller.observer, ends[1], channel)),
        (sides.only_wait, (controller.dt, seconds)),
    ]
    pipes, processes = [context.Pipe() for _ in work], []
    path.unlink(missing_ok=True)
    try:
        for (target, values), (_, theirs) in zip(work, pipes, strict=True):
            side = context.Process(target=target, args=(*values, theirs))
            with executors.signals_blocked():
                side.start()
            processes.append(side)
            theirs.close()  # else this process would keep open what a side closes by its end
        for end in ends:
            end.close()
        ours = [pipe for pipe, _ in pipes]
        for pipe in ours:  # until all are ready
            while not pipe.poll(EVERY):
                interruption.check()
            try:
                pipe.recv()
            except EOFError:
                what = "expected three processes to start, got one that ended"
                raise NpredError(f"rig: {what}; read its message") from None
        start = time.monotonic() + AHEAD
        for pipe in ours:
            pipe.send(start)
        with console.bar("rig", math.ceil(seconds), "seconds") as bar:
            while processes[0].is_alive():
                time.sleep(EVERY)
                console.head(last := log.last_row(path))
                bar.advance(min(int(time.monotonic() - start), bar.total) - bar.done, last)
        return ours[2].recv() if ours[2].poll(2 * AHEAD) else np.zeros(1)
    finally:
        for pipe, _ in pipes:
            pipe.close()
        for side in processes:
            side.join(interruption.GRACE / 2)
            side.kill()


def _controller(options: Rigged, plant: Plant, channel: Channel) -> Controller:
    """Raises ConfigError for keys of [evaluate] that the rig does not honour, or that do not fit the plant."""
    table = options.config.evaluate
    exact = predictor = numerical(table.predictor, plant, table.nx)
    if options.model:
        stored = load_model(f"{options.pipeline}:{options.model}", options.store, options.set)
        predictor = loaded(stored, table.nx, "cpu", None)
        predictor = Guarded(predictor, exact=exact, **dict(table.guard)) if table.guard else predictor
    age = table.max_sample_age or max(OLDEST * table.dt, 2 * channel.longest)
    more = {"max_sample_age": age, "watchdog": export.watchdog(options.watchdog) or table.watchdog}
    controller = export.of_table(plant, predictor, table.model_copy(update={"actuator": HISTORY}), **more)
    if isinstance(controller.adaptation, DelayAdaptation):
        options.console.warn(export.RECALLS)
    others = {f"measurement.{key}": getattr(table.measurement, key) for key in ("jitter", "delay", "drop")}
    clock = vars(table.timing or ControlClock())
    others |= {f"timing.{key}": value for key, value in clock.items() if key not in LATENCIES}
    if keys := [f"evaluate.{key}" for key, value in others.items() if value]:
        cure = "leave it out, and describe the network by --latency, --jitter, --loss, --stops and timing's latencies"
        what = "expected no delays, losses and clock besides those of the rig"
        raise ConfigError(f"rig: {what}, got {', '.join(keys)}; {cure}")
    if table.X0:
        loop_checks.start(plant, np.array(table.X0))
    observer = controller.observer
    table.measurement.check(plant, observer and len(observer.outputs))
    return controller
