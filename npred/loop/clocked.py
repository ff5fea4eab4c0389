"""Loops on a real clock: the controller that ships, called at its own times, and the plant as commands arrive.

One loop after the other, npred/kernels/c/clocked.h; what happens when is npred.loop.timing.
"""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np

from npred.base import devices
from npred.base.errors import ConfigError
from npred.loop import assembly, settable, signals, status
from npred.loop.engine import Engine
from npred.loop.loop import Loop
from npred.loop.memory import Memory
from npred.loop.signals import Events, Record
from npred.loop.simulation import Simulation
from npred.loop.timing import ROUNDING, Timing, ends, schedule
from npred.loop.trajectories import OnAClock, each
from npred.plants import inputs


def run(simulation: Simulation, progress: Callable[[int], Any] | None) -> tuple[Record, OnAClock]:
    """All loops of a simulation. Raises ConfigError where the controller uses none of the samples, they are so old."""
    loop, age = simulation.loop, assembly.oldest(simulation.loop) * simulation.loop.dt
    delay = loop.measurement.delay + ends((loop.timing or Timing()).sample_latency)[0]
    if delay > age * (1 + ROUNDING):
        late, most = map(loop.plant.time_text, (delay, age))
        what = f"expected at least the delay of the samples, {late}, else none is used, got {most}"
        raise ConfigError(f"max_sample_age: {what}; give max_sample_age = {delay:g} or more")

    def one(number: int) -> tuple[Record, OnAClock]:
        result = run_one(simulation, number)
        if progress:
            progress(simulation.count)
        return result

    first = one(0)  # which compiles
    with devices.one_thread(), ThreadPoolExecutor(os.cpu_count() if simulation.compiled else 1) as pool:
        results = [first, *pool.map(one, range(1, len(loop.D)))]
    clock = each(lambda *arrays: np.stack(arrays), *(clock for _, clock in results))
    return signals.joined(record for record, _ in results), clock


def run_one(simulation: Simulation, number: int) -> tuple[Record, OnAClock]:
    """The loop of that number in the batch."""
    of, plant, D, delays = (
        simulation.loop, simulation.loop.plant, simulation.loop.D[number], simulation.delays[:, number]
    )  # fmt: skip
    only = slice(number, number + 1)
    past, settings = simulation.past.of(only), simulation.settings(only)
    memory = Memory(of.filled(D_hat=float(simulation.D_hat[number])), simulation.law, settings, past)
    z = memory.signals._replace(X=np.array(of.X0[number])[:, None], D=(plant.ratios * D)[:, None])
    events = _events(simulation, number, settings.output_count, past)
    out = simulation.record(1, simulation.samples.shape[1])
    parts = simulation.parts | {"output": of.observer and of.observer.measure()}
    steps = Engine(parts, settings, z, out, events)
    for start, stop in pairwise(sorted({0, simulation.count, *simulation.begins})):
        simulation.begin(start, settings)
        steps.run_clocked(start, stop, simulation.count)
    rows = np.arange(simulation.rows) * simulation.every
    spans = delays[rows] if delays.size else np.full(len(rows), D)
    u_star = np.zeros((len(rows), plant.m))
    if plant.rests:
        u_star[:] = settable.targets(plant, simulation.course, rows * of.dt)[1]
    for goal in np.unique(u_star, axis=0):
        chosen = (u_star == goal).all(axis=1)
        out.energy[chosen, 0] = _energy(of, rows[chosen], spans[chosen], events, goal)
    said = status.of(memory)
    out.D_hat_spread[:] = said.D_hat_spread
    return out, OnAClock(
        X_hat=events.X_hat[..., 0], age=events.age_then[:, 0], handed_over=events.handed_over[:, 0].astype(bool),
        skipped=events.skipped.sum(), lost=(events.lost & ~events.skipped.astype(bool)).sum(),
        refusals=events.refusals[0], late=np.array(said.late), refused=np.array(said.refused), offset=said.offset,
    )  # fmt: skip


def _events(simulation: Simulation, number: int, outputs: int, past: inputs.Past) -> Events:
    """The schedule of a loop, and the commands before t = 0."""
    of, m, delays = simulation.loop, simulation.loop.plant.m, simulation.delays[:, number]
    timing = of.timing or Timing()
    plan = schedule(timing, of.measurement, of.dt, simulation.count, number + of.measurement.first)
    before = math.ceil(max(of.D[number], delays.max(initial=0.0)) / of.dt) + 2
    sent_at, sent = np.full(before + simulation.count, np.nan), np.zeros((before + simulation.count, m))
    sent_at[:before], sent[:before] = np.arange(-before, 0), past.steps(before, of.dt)[:, :, 0]
    arrays = {name: np.ascontiguousarray(getattr(plan, name)) for name in plan._fields}
    arrays |= {"sent_at": sent_at, "sent": sent, "sent_count": np.array([before])}
    sizes = {"samples": len(plan.taken), "outputs": outputs, "n": of.plant.n, "m": m, "row": simulation.rows}
    memory = signals.memory([s for s in signals.EVENTS if s.axes is not None], sizes, 1, arrays)
    return Events(**memory, sample_count=len(plan.taken), tells=int(timing.tells))


def _energy(of: Loop, rows: np.ndarray, D: np.ndarray, events: Events, u_star: np.ndarray) -> np.ndarray:
    """∫ |U - u_star|² over the true delay D (rows,) at control steps, of the commands that reached the actuator."""
    count = int(events.sent_count[0])
    at, square = events.sent_at[:count], (events.sent[:count] - u_star) ** 2
    ends = np.append(at, max(at[-1] + 1.0, float(len(events.skipped))))
    total = np.concatenate([np.zeros((1, of.plant.m)), np.cumsum(square * np.diff(ends)[:, None], axis=0)])
    span = D / of.dt
    energy = sum(
        np.interp(rows, ends, total[:, c]) - np.interp(rows - r * span, ends, total[:, c])
        for c, r in enumerate(of.plant.ratios)
    )
    return np.asarray(energy) * of.dt
