"""The state of a controller after each call, for people."""

import math
from typing import NamedTuple

import numpy as np

from npred.loop import engine
from npred.loop.memory import Memory


class Status(NamedTuple):
    """The state of a controller after its last call; times in the plant's unit.

    D_hat, D_hat_spread: the estimate of the delay, and half the range of the delays that it may be taken for, NaN
    without an observer of the delay. It is wide where commands changed too little, or too long ago, to tell the delay;
    at a bound it is the whole range of the bounds.
    at_bound: whether D_hat stands at a bound of its law: the delay may lie outside.
    age: the age of the last used sample, infinity before the first.
    innovation (outputs,): the last sample minus the model's value, NaN before the first.
    late: number of samples that came after a newer one, or were older than `max_sample_age`. They were not used.
    refused: number of samples farther from the model than `outlier_limit` allows. missed: the latest of these in a row.
    renewed: how often the observer of the state restarted. offset (m,): its estimate of a constant added to U.
    handed_over: whether the watchdog gives U.
    fallback, error: whether the guard took the numerical answer, and its estimate of the error of U.
    filtered: whether the safety filter changed U. kept: the smallest h = safe(P, t) of the predicted states.
    unkept: whether it found no U within the bounds that keeps all limits.
    promised: whether U begins a plan that keeps all limits for good; see docs/safety.md for the conditions.
    withdrawn: how often such a promise ended.
    """

    D_hat: float
    D_hat_spread: float
    at_bound: bool
    age: float
    innovation: np.ndarray
    late: int
    refused: int
    missed: int
    renewed: int
    handed_over: bool
    offset: np.ndarray
    fallback: bool
    error: float
    filtered: bool
    kept: float
    unkept: bool
    promised: bool
    withdrawn: int


def of(memory: Memory) -> Status:
    """The status that a controller's memory tells."""
    loop, z, clock = memory.loop, memory.signals, memory.clock
    (n, m), dt, law = (loop.plant.n, loop.plant.m), loop.dt, loop.adaptation
    age, spread = (clock["at"] - clock["sample_at"]) * dt, math.nan
    if memory.watches:
        spread = float(engine.spreads(m, memory.settings.law, z.observer, z.D_hat)[0])
    offset = z.filter[n : n + m, 0].copy() if memory.settings.offsets else np.zeros(m)
    low, high = law.ends(dt) if law else (-math.inf, math.inf)
    return Status(
        D_hat=memory.D_hat, D_hat_spread=spread, at_bound=low < high and not low < memory.D_hat < high,
        age=math.inf if math.isnan(age) else age,
        innovation=z.innovation[:, 0].copy(), late=int(clock["late"]), refused=int(clock["refused"]),
        missed=int(z.missed[0]), renewed=int(clock["renewed"]), handed_over=clock["handed"] > 0, offset=offset,
        fallback=bool(z.fallback[0]), error=float(z.error[0]), filtered=z.filtered[0] > 0,
        kept=float(z.kept[0]) if z.plan.size else math.nan, unkept=z.unkept[0] > 0,
        promised=z.promised[0] > 0,
        withdrawn=int(z.withdrawn[0]),
    )  # fmt: skip
