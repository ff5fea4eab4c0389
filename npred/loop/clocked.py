"""Loops on a real clock: the controller that ships, called at its own times, and the plant with what reached it.

One loop after the other, npred/kernels/c/clocked.h; what happens when is npred.loop.timing.
"""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from npred.base import devices
from npred.base.errors import ConfigError
from npred.estimation.observers import Observer
from npred.loop import measurement as sensing
from npred.loop import signals
from npred.loop.controller import OLDEST, Controller
from npred.loop.engine import Engine
from npred.loop.loop import HISTORY, Loop
from npred.loop.signals import Events, Record
from npred.loop.timing import Timing, schedule
from npred.loop.trajectories import OnAClock
from npred.plants import inputs
from npred.plants.base import Plant

SPARE = 4  # control steps that a sample may come later than the delay of the samples


def check(loop: Loop) -> None:
    """Raise ConfigError for what a loop on a real clock cannot have."""
    if loop.timing is not None and not isinstance(loop.timing, Timing):
        raise ConfigError(f"timing: expected an npred.Timing, got {loop.timing!r}; make one")
    if loop.observer is not None and not isinstance(loop.observer, Observer):
        raise ConfigError(f"observer: expected one of npred.observers, got {loop.observer!r}; make one")
    if loop.actuator != HISTORY:
        raise ConfigError(f'actuator: expected "history" for a loop on a real clock, got {loop.actuator!r}; give it')
    if loop.predictor is None:
        raise ConfigError("predictor: expected one for a loop on a real clock, got None; make one")
    serves(loop.plant)
    if loop.measurement.observer is not None:
        raise ConfigError("measurement: expected no observer in Python on a real clock, got one; give observer")


def serves(plant: Plant) -> None:
    """Raise ConfigError for a plant that no loop on a real clock is made for."""
    if plant.declares_delay:
        raise ConfigError(f"timing: expected a plant that does not declare its delay, got {plant.name}; leave it out")


@dataclass(frozen=True)
class Clocked:
    """All loops of one simulation on a real clock; `loop` has nothing left to be filled in."""

    of: Loop
    count: int
    every: int
    advance: Any  # npred.prediction.delays.family.ADVANCE of the simulated plant
    pushes: np.ndarray  # (count, m, 0, 1 or B)

    def run(
        self, past: inputs.Past, samples: np.ndarray, delays: np.ndarray, compiled: bool,
        progress: Callable[[int], Any] | None,
    ) -> tuple[Record, OnAClock]:  # fmt: skip
        """The loops, of samples (B, S) and delays (count + 1 or 0, B)."""

        def one(l: int) -> tuple[Record, OnAClock]:
            result = self.loop(l, past.of(slice(l, l + 1)), samples[l], delays[:, l])
            if progress:
                progress(self.count)
            return result

        first = one(0)  # which compiles
        with devices.one_thread(), ThreadPoolExecutor(os.cpu_count() if compiled else 1) as pool:
            results = [first, *pool.map(one, range(1, len(self.of.D)))]
        records = Record(*(np.concatenate(parts, axis=-1) for parts in zip(*(r for r, _ in results), strict=True)))
        names = OnAClock.__dataclass_fields__
        return records, OnAClock(**{name: np.stack([getattr(e, name) for _, e in results]) for name in names})

    def loop(self, number: int, past: inputs.Past, samples: np.ndarray, delays: np.ndarray) -> tuple[Record, OnAClock]:
        """The loop of that number in the batch."""
        of, plant, m, D = self.of, self.of.plant, self.of.plant.m, self.of.D[number]
        assert of.predictor is not None
        one = self._controller(float(of.D_hat[number]), past)
        pushes = self.pushes[..., min(number, self.pushes.shape[2] - 1)] if self.pushes.size else np.zeros(0)
        sensors = sensing.settings(of.measurement, of.dt, number, len(one.outputs))
        settings = one.settings._replace(
            every=self.every, row_count=(self.count - 1) // self.every + 1, sample_count=len(samples),
            samples=np.ascontiguousarray(samples, dtype=np.int64), truth_p=of.real.p,
            tabulates=int(delays.size > 0), delays=np.ascontiguousarray(delays[:, None] * plant.ratios),
            disturbed=int(pushes.size > 0), disturbance=np.ascontiguousarray(pushes), **sensors,
        )  # fmt: skip
        z = one.memory._replace(X=np.array(of.X0[number])[:, None], D=(plant.ratios * D)[:, None])
        events = self._events(one, number + of.measurement.first, D, delays, past)
        sizes = {"n": plant.n, "m": m, "nx": of.predictor.nx, "row": settings.row_count}
        sizes |= {"sample": len(samples) + 1, "breach": plant.n + m + 1}
        out = Record(**signals.memory(signals.RECORD, sizes, 1, {}))
        parts = one.parts | {"advance": self.advance, "output": of.observer and of.observer.measure()}
        Engine(parts, settings, z, out, events).run_clocked(0, self.count)
        self._add_energy(out, events, D, delays)
        return out, self._told(one, events)

    def _controller(self, D_hat: float, past: inputs.Past) -> Controller:
        """The controller with the commands before t = 0."""
        of, law, age = self.of, self.of.adaptation, self.of.max_sample_age
        if age is None:
            age = max(OLDEST * of.dt, of.measurement.delay + SPARE * of.dt)
        u0: Any = past.held[0]
        if past.course is not None:
            reach = max(D_hat, law.bounds[1] if law and law.bounds else 0.0) + age
            rows = past.steps(math.ceil(reach / of.dt) + SPARE, of.dt)[:, :, 0]
            u0 = lambda t: rows[max(math.floor(t / of.dt) + len(rows), 0)]  # noqa: E731
        return Controller(replace(of, D_hat=D_hat, u0=u0, max_sample_age=age))

    def _events(self, one: Controller, loop: int, D: float, delays: np.ndarray, past: inputs.Past) -> Events:
        """What happens, and the commands before t = 0."""
        timing = self.of.timing or Timing()
        plan = schedule(timing, self.of.measurement, self.of.dt, self.count, loop)
        m, before = self.of.plant.m, math.ceil(max(D, delays.max(initial=0.0)) / self.of.dt) + 2
        sent_at, sent = np.full(before + self.count, np.nan), np.zeros((before + self.count, m))
        sent_at[:before], sent[:before] = np.arange(-before, 0), past.steps(before, self.of.dt)[:, :, 0]
        arrays = {name: np.ascontiguousarray(getattr(plan, name)) for name in plan._fields}
        arrays |= {"sent_at": sent_at, "sent": sent, "sent_count": np.array([before])}
        sizes = {"samples": len(plan.taken), "outputs": len(one.outputs), "n": self.of.plant.n, "m": m}
        sizes |= {"row": (self.count - 1) // self.every + 1}
        memory = signals.memory([s for s in signals.EVENTS if s.axes is not None], sizes, 1, arrays)
        return Events(**memory, sample_count=len(plan.taken), tells=int(timing.tells))

    def _add_energy(self, out: Record, events: Events, D: float, delays: np.ndarray) -> None:
        """The integral of |U - U*|² over the true delay, of the commands that reached the actuator."""
        count = int(events.sent_count[0])
        u_star = self.of.plant.u_equilibrium if self.of.plant.rests else np.zeros(self.of.plant.m)
        at, square = events.sent_at[:count], (events.sent[:count] - u_star) ** 2
        ends = np.append(at, max(at[-1] + 1.0, float(self.count)))
        total = np.concatenate([np.zeros((1, self.of.plant.m)), np.cumsum(square * np.diff(ends)[:, None], axis=0)])
        rows = np.arange(len(out.energy)) * self.every
        span = (delays[rows] if delays.size else np.full(len(rows), D)) / self.of.dt
        energy = sum(
            np.interp(rows, ends, total[:, c]) - np.interp(rows - r * span, ends, total[:, c])
            for c, r in enumerate(self.of.plant.ratios)
        )
        out.energy[:, 0] = np.asarray(energy) * self.of.dt

    def _told(self, one: Controller, e: Events) -> OnAClock:
        status = one.status
        count = {"skipped": e.skipped.sum(), "lost": (e.lost & ~e.skipped.astype(bool)).sum()}
        return OnAClock(
            X_hat=e.X_hat[..., 0], age=e.age_then[:, 0], handed_over=e.handed_over[:, 0].astype(bool),
            refusals=e.refusals[0], late=np.array(status.late), refused=np.array(status.refused),
            offset=status.offset, **count,
        )  # fmt: skip
