"""Loops on a real clock: the controller that ships, called at its own times, and the plant with what reached it.

One loop after the other, npred/kernels/c/clocked.h; what happens when is npred.loop.timing.
"""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from npred.errors import ConfigError
from npred.loop import loop_checks, signals
from npred.loop import measurement as sensing
from npred.loop.controller import OLDEST, Controller
from npred.loop.delay_law import DelayLaw
from npred.loop.engine import Engine
from npred.loop.measurement import Measurement
from npred.loop.signals import Events, Record
from npred.loop.timing import Timing, schedule
from npred.loop.trajectories import OnAClock
from npred.loop.watchdog import Watchdog
from npred.observers import Observer
from npred.parallel import devices
from npred.plants import inputs
from npred.plants.base import Plant
from npred.predictors import Predictor
from npred.safety import SafetyFilter

SPARE = 4  # control steps that a sample may come later than the delay of the samples


def check(
    plant: Plant, predictor: Predictor | None, actuator: str, measurement: Measurement | None, timing: Any,
    observer: Any,
) -> None:  # fmt: skip
    """Raise ConfigError for what a loop on a real clock cannot have."""
    if timing is not None and not isinstance(timing, Timing):
        raise ConfigError(f"timing: expected an npred.Timing, got {timing!r}; make one")
    if observer is not None and not isinstance(observer, Observer):
        raise ConfigError(f"observer: expected one of npred.observers, got {observer!r}; make one")
    if actuator != loop_checks.HISTORY:
        raise ConfigError(f'actuator: expected "history" for a loop on a real clock, got {actuator!r}; give it')
    if predictor is None:
        raise ConfigError("predictor: expected one for a loop on a real clock, got None; make one")
    serves(plant)
    if measurement is not None and measurement.observer is not None:
        raise ConfigError("measurement: expected no observer in Python on a real clock, got one; give observer")


def serves(plant: Plant) -> None:
    """Raise ConfigError for a plant that no loop on a real clock is made for."""
    if plant.declares_delay:
        raise ConfigError(f"timing: expected a plant that does not declare its delay, got {plant.name}; leave it out")


@dataclass(frozen=True)
class Clocked:
    """What all loops of one simulation on a real clock share. `law` has what the plant lacks filled in."""

    plant: Plant
    predictor: Predictor
    law: DelayLaw | None
    limits: np.ndarray
    dt: float
    count: int
    every: int
    advance: Any  # npred.delays.family.ADVANCE of the simulated plant
    truth: Plant
    pushes: np.ndarray  # (count, m, 0, 1 or B)
    measurement: Measurement
    timing: Timing
    observer: Observer | None
    watchdog: Watchdog | None
    safety: SafetyFilter | None

    def run(
        self, X0: np.ndarray, D: np.ndarray, D_hat: np.ndarray, past: inputs.Past, samples: np.ndarray,
        delays: np.ndarray, compiled: bool, progress: Callable[[int], Any] | None,
    ) -> tuple[Record, OnAClock]:  # fmt: skip
        """The loops of X0 (B, n), D, D_hat (B,), samples (B, S) and delays (count + 1 or 0, B)."""

        def one(l: int) -> tuple[Record, OnAClock]:
            result = self.loop(l, X0[l], D[l], D_hat[l], past.of(slice(l, l + 1)), samples[l], delays[:, l])
            if progress:
                progress(self.count)
            return result

        first = one(0)  # which compiles
        with devices.one_thread(), ThreadPoolExecutor(os.cpu_count() if compiled else 1) as pool:
            results = [first, *pool.map(one, range(1, len(D)))]
        records = Record(*(np.concatenate(parts, axis=-1) for parts in zip(*(r for r, _ in results), strict=True)))
        names = OnAClock.__dataclass_fields__
        return records, OnAClock(**{name: np.stack([getattr(e, name) for _, e in results]) for name in names})

    def loop(
        self, number: int, X0: np.ndarray, D: float, D_hat: float, past: inputs.Past, samples: np.ndarray,
        delays: np.ndarray,
    ) -> tuple[Record, OnAClock]:  # fmt: skip
        """The loop of that number in the batch."""
        plant, m = self.plant, self.plant.m
        one = self._controller(D_hat, past)
        pushes = self.pushes[..., min(number, self.pushes.shape[2] - 1)] if self.pushes.size else np.zeros(0)
        sensors = sensing.settings(self.measurement, self.dt, number, len(one.outputs))
        settings = one.settings._replace(
            every=self.every, row_count=(self.count - 1) // self.every + 1, sample_count=len(samples),
            samples=np.ascontiguousarray(samples, dtype=np.int64), truth_p=self.truth.p,
            tabulates=int(delays.size > 0), delays=np.ascontiguousarray(delays[:, None] * plant.ratios),
            disturbed=int(pushes.size > 0), disturbance=np.ascontiguousarray(pushes), **sensors,
        )  # fmt: skip
        z = one.memory._replace(X=np.array(X0)[:, None], D=(plant.ratios * D)[:, None])
        events = self._events(one, number + self.measurement.first, D, delays, past)
        sizes = {"n": plant.n, "m": m, "nx": self.predictor.nx, "row": settings.row_count}
        sizes |= {"sample": len(samples) + 1, "breach": plant.n + m + 1}
        out = Record(**signals.memory(signals.RECORD, sizes, 1, {}))
        parts = one.parts | {"advance": self.advance, "output": self.observer and self.observer.measure()}
        Engine(parts, settings, z, out, events).run_clocked(0, self.count)
        self._add_energy(out, events, D, delays)
        return out, self._told(one, events)

    def _controller(self, D_hat: float, past: inputs.Past) -> Controller:
        """The controller with the commands before t = 0."""
        oldest = self.timing.oldest
        if oldest is None:
            oldest = max(OLDEST * self.dt, self.measurement.delay + SPARE * self.dt)
        u0: Any = past.held[0]
        if past.course is not None:
            reach = max(D_hat, self.law.bounds[1] if self.law and self.law.bounds else 0.0) + oldest
            rows = past.steps(math.ceil(reach / self.dt) + SPARE, self.dt)[:, :, 0]
            u0 = lambda t: rows[max(math.floor(t / self.dt) + len(rows), 0)]  # noqa: E731
        return Controller(
            self.plant, self.predictor, self.law, self.dt, D_hat=float(D_hat), input_bounds=self.limits,
            actuator=loop_checks.HISTORY, u0=u0, gate=self.timing.gate, oldest=oldest, observer=self.observer,
            watchdog=self.watchdog, safety=self.safety,
        )  # fmt: skip

    def _events(self, one: Controller, loop: int, D: float, delays: np.ndarray, past: inputs.Past) -> Events:
        """What happens, and the commands before t = 0."""
        plan = schedule(self.timing, self.measurement, self.dt, self.count, loop)
        m, before = self.plant.m, math.ceil(max(D, delays.max(initial=0.0)) / self.dt) + 2
        sent_at, sent = np.full(before + self.count, np.nan), np.zeros((before + self.count, m))
        sent_at[:before], sent[:before] = np.arange(-before, 0), past.steps(before, self.dt)[:, :, 0]
        arrays = {name: np.ascontiguousarray(getattr(plan, name)) for name in plan._fields}
        arrays |= {"sent_at": sent_at, "sent": sent, "sent_count": np.array([before])}
        sizes = {"samples": len(plan.taken), "outputs": len(one.outputs), "n": self.plant.n, "m": m}
        sizes |= {"row": (self.count - 1) // self.every + 1}
        memory = signals.memory([s for s in signals.EVENTS if s.axes is not None], sizes, 1, arrays)
        return Events(**memory, sample_count=len(plan.taken), tells=int(self.timing.tells))

    def _add_energy(self, out: Record, events: Events, D: float, delays: np.ndarray) -> None:
        """The integral of |U - U*|² over the true delay, of the commands that reached the actuator."""
        count = int(events.sent_count[0])
        u_star = self.plant.u_equilibrium if self.plant.rests else np.zeros(self.plant.m)
        at, square = events.sent_at[:count], (events.sent[:count] - u_star) ** 2
        ends = np.append(at, max(at[-1] + 1.0, float(self.count)))
        total = np.concatenate([np.zeros((1, self.plant.m)), np.cumsum(square * np.diff(ends)[:, None], axis=0)])
        rows = np.arange(len(out.energy)) * self.every
        span = (delays[rows] if delays.size else np.full(len(rows), D)) / self.dt
        energy = sum(
            np.interp(rows, ends, total[:, c]) - np.interp(rows - r * span, ends, total[:, c])
            for c, r in enumerate(self.plant.ratios)
        )
        out.energy[:, 0] = np.asarray(energy) * self.dt

    def _told(self, one: Controller, e: Events) -> OnAClock:
        status = one.status
        count = {"skipped": e.skipped.sum(), "lost": (e.lost & ~e.skipped.astype(bool)).sum()}
        return OnAClock(
            X_hat=e.X_hat[..., 0], age=e.age_then[:, 0], handed_over=e.handed_over[:, 0].astype(bool),
            refusals=e.refusals[0], late=np.array(status.late), refused=np.array(status.refused),
            offset=status.offset, **count,
        )  # fmt: skip
