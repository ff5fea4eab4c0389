"""`npred rig`: the evaluated loop of a pipeline in real time, a plant and a controller as two processes."""

import math
import multiprocessing
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from npred import plants
from npred.cli import export
from npred.cli.options import Rigged, writable
from npred.conditions import condition
from npred.config import Evaluate
from npred.errors import ConfigError, NpredError, UnmetError
from npred.loop import metrics
from npred.loop.adaptation import DelayAdaptation
from npred.loop.controller import OLDEST, Controller
from npred.loop.loop_checks import HISTORY
from npred.loop.watchdog import Watchdog
from npred.predictors import numerical
from npred.rig import clock, controller_side, link, plant_side
from npred.rig.log import OVER, RigLog
from npred.rig.network import Channel
from npred.rig.plant_side import Truth
from npred.rig.view import View
from npred.terminal import interruption, streams

FINE = 4  # steps of the truth in a control step, at least
EVERY = 0.1  # s between two looks at the processes


def rig(options: Rigged, log: Path | None, plain: bool) -> None:
    """Run it and say what its log says. Raises NpredError where a side was lost, UnmetError where the loop was."""
    if not 0 < options.seconds < math.inf:
        raise ConfigError(f"--seconds: expected a time above 0, got {options.seconds:g}; give seconds")
    network = Channel(options.delay, options.jitter, options.loss, options.reorder, options.stops, options.seed)
    path, (controller, truth) = writable(log or Path(f"{options.config.name}-rig.csv")), _sides(options, network)
    interactive = streams.MESSAGES.isatty() and not (plain or options.quiet or options.json)
    with interruption.orderly():
        late = run(controller, truth, network, options.seconds, path, View(path) if interactive else None)
    written = RigLog(path, truth.plant)
    if written.why != OVER:
        raise NpredError(f"rig: expected a whole run, got an end, {written.why or 'a side was killed'}; read {path}")
    summary = written.summary(controller.dt) | {"log": str(path)}
    summary |= {
        f"machine_late_{name}_us": 1e6 * float(np.quantile(late, q)) for name, q in (("p999", 0.999), ("max", 1))
    }
    options.show(summary, lambda: _said(summary, controller))
    start = written.distance()[0]
    if not summary["radius"] <= max(start, metrics.LOST * metrics.size(truth.plant.target(0.0))):
        raise UnmetError(
            f"rig: expected a loop that stays, got one {summary['radius']:.3g} away at the end; read {path}"
        )


def run(
    controller: Controller, truth: Truth, network: Channel, seconds: float, path: Path, view: View | None = None
) -> np.ndarray:
    """Run both sides until they end, and end them where this process is asked to; how late a process comes, in
    seconds, that only waits for the same times.
    """
    context, parent, ends = multiprocessing.get_context("spawn"), os.getpid(), link.pair()
    reader, writer = context.Pipe(duplex=False)
    sides = [
        context.Process(target=controller_side.run, args=(controller, ends[0], network, seconds, path, parent)),
        context.Process(target=plant_side.run, args=(truth, ends[1], network, seconds, parent)),
        context.Process(target=clock.witness, args=(controller.dt, seconds, writer, parent), daemon=True),
    ]  # fmt: skip
    path.unlink(missing_ok=True)
    try:
        for side in sides:
            side.start()
        for end in ends:
            end.close()  # the sides have them: with theirs closed, the other one hears of it
        while any(side.is_alive() for side in sides[:2]):
            interruption.check()
            time.sleep(EVERY)
            if view:
                view.draw()
        return reader.recv() if reader.poll(2 * link.AHEAD) else np.zeros(1)
    finally:
        if view:
            view.close()
        for side in sides:
            if side.pid is not None:
                side.terminate()
                side.join(interruption.GRACE / 2)
                side.kill()


def _sides(options: Rigged, network: Channel) -> tuple[Controller, Truth]:
    """The controller and the plant. Raises ConfigError for a plant that no network can be between."""
    config = options.config
    table, plant = config.evaluate, plants.resolve(config.plant, config.parameters)
    if plant.declares_delay or not plant.one_delay or plant.time_unit != "s":
        raise ConfigError(f"rig: expected a plant with one delay and in seconds, got {plant.name}; take another")
    table = table.model_copy(update={"dt": 1 / options.rate if options.rate else table.dt})
    controller = _controller(options, plant, table, network)
    if isinstance(controller.adaptation, DelayAdaptation):
        options.console.warn(export.RECALLS)
    X0 = np.array(table.X0 or plant.target(0.0))
    period = table.measurement.period or table.dt
    truth = Truth(
        condition.truth(plant, table) or plant, X0, controller.u0, table.D, period, table.dt / FINE,
        table.measurement, table.disturbance, options.seed,
    )  # fmt: skip
    return controller, truth


def _controller(options: Rigged, plant: Any, table: Evaluate, network: Channel) -> Controller:
    if options.network:
        from npred import api

        predictor = api.load(f"{options.pipeline}:{options.network}", store=options.store, nx=table.nx)
    else:
        predictor = numerical(table.predictor, plant, table.nx)
    oldest = max(OLDEST * table.dt, 2 * network.longest)
    watchdog = None if options.watchdog is None else Watchdog(options.watchdog)
    return export.of_table(plant, predictor, table, HISTORY, oldest=oldest, watchdog=watchdog)


def _said(summary: dict[str, Any], controller: Controller) -> str:
    """The summary for people."""
    text, f = controller.plant.time_text, summary
    delay, acting = (math.nan if f[name] is None else f[name] for name in ("delay", "acting"))
    return "\n".join([
        f"{f['calls']} calls in {text(f['seconds'])}, {100 * f['without_sample']:.1f} % without a new sample, "
        f"{f['refused']} refused, {100 * f['handed_over']:.1f} % by the watchdog",
        f"D_hat {text(f['D_hat'])} at the end; commands act {text(delay)} after their stamp, "
        f"and the acting one's mean age less half a step is {text(acting)}",
        f"samples: {f['samples']} arrived, {text(f['samples_late'])} late, {f['samples_lost']} lost, "
        f"{f['samples_reordered']} out of order",
        f"calls come {f['late_p999_us']:.0f} µs late (99.9 %), {f['late_max_us']:.0f} µs at worst; a process that only "
        f"waits {f['machine_late_p999_us']:.0f} and {f['machine_late_max_us']:.0f} µs; {f['skipped']} skipped",
        f"a call takes {f['took_median_us']:.0f} µs (median), {f['took_p999_us']:.0f} µs (99.9 %), "
        f"{f['took_max_us']:.0f} µs at worst",
        f"radius {f['radius']:.3g} over the last tenth",
        f"wrote {f['log']}: npred identify {f['log']} --plant {controller.plant.name} reads it",
    ])  # fmt: skip
