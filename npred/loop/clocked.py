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
from npred.loop import measurement as sensing
from npred.loop import settable, signals
from npred.loop.controller import OLDEST, Controller
from npred.loop.engine import Engine
from npred.loop.loop import Loop
from npred.loop.signals import Events, Record
from npred.loop.simulation import Simulation
from npred.loop.timing import Timing, schedule
from npred.loop.trajectories import OnAClock, each
from npred.plants import inputs

SPARE = 4  # control steps that a sample may come later than the delay of the samples


def run(simulation: Simulation, progress: Callable[[int], Any] | None) -> tuple[Record, OnAClock]:
    """All loops of a simulation."""

    def one(number: int) -> tuple[Record, OnAClock]:
        result = run_one(simulation, number)
        if progress:
            progress(simulation.count)
        return result

    first = one(0)  # which compiles
    with devices.one_thread(), ThreadPoolExecutor(os.cpu_count() if simulation.compiled else 1) as pool:
        results = [first, *pool.map(one, range(1, len(simulation.loop.D)))]
    clock = each(lambda *arrays: np.stack(arrays), *(clock for _, clock in results))
    return signals.joined(record for record, _ in results), clock


def run_one(simulation: Simulation, number: int) -> tuple[Record, OnAClock]:
    """The loop of that number in the batch."""
    of, plant, D, delays = (
        simulation.loop,
        simulation.loop.plant,
        simulation.loop.D[number],
        simulation.delays[:, number],
    )
    samples, past = simulation.samples[number], simulation.past.of(slice(number, number + 1))
    one, pushes = _controller(of, float(of.D_hat[number]), past), np.zeros(0)
    if simulation.pushes.size:
        pushes = simulation.pushes[..., min(number, simulation.pushes.shape[2] - 1)]
    settings = one.settings._replace(
        every=simulation.every, row_count=simulation.rows, sample_count=len(samples),
        samples=np.ascontiguousarray(samples, dtype=np.int64), truth_p=of.real.p.copy(),
        tabulates=int(delays.size > 0), delays=np.ascontiguousarray(delays[:, None] * plant.ratios),
        disturbed=int(pushes.size > 0), disturbance=np.ascontiguousarray(pushes),
        **sensing.settings(of.measurement, of.dt, number, len(one.outputs)),
    )  # fmt: skip
    z = one.memory._replace(X=np.array(of.X0[number])[:, None], D=(plant.ratios * D)[:, None])
    events = _events(simulation, number, len(one.outputs), past)
    out = simulation.record(1, len(samples))
    parts = one.parts | {"advance": simulation.parts["advance"], "output": of.observer and of.observer.measure()}
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
    status = one.status
    out.D_hat_spread[:] = status.D_hat_spread
    return out, OnAClock(
        X_hat=events.X_hat[..., 0], age=events.age_then[:, 0], handed_over=events.handed_over[:, 0].astype(bool),
        skipped=events.skipped.sum(), lost=(events.lost & ~events.skipped.astype(bool)).sum(),
        refusals=events.refusals[0], late=np.array(status.late), refused=np.array(status.refused), offset=status.offset,
    )  # fmt: skip


def _controller(of: Loop, D_hat: float, past: inputs.Past) -> Controller:
    """The controller with the commands before t = 0."""
    law, age = of.adaptation, of.max_sample_age
    if age is None:
        age = max(OLDEST * of.dt, of.measurement.delay + SPARE * of.dt)
    u0: Any = past.held[0]
    if past.course is not None:
        reach = max(D_hat, law.bounds[1] if law and law.bounds else 0.0) + age
        rows = past.steps(math.ceil(reach / of.dt) + SPARE, of.dt)[:, :, 0]
        u0 = lambda t: rows[max(math.floor(t / of.dt) + len(rows), 0)]  # noqa: E731
    return Controller(of.filled(D_hat=D_hat, u0=u0, max_sample_age=age))


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
