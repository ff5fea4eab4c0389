"""The state of a controller after each call, for people."""

from typing import NamedTuple

import numpy as np


class Status(NamedTuple):
    """The state of a controller after its last call; times in the plant's unit.

    `D_hat_spread` is half the range of the candidates that an observer of the delay cannot tell apart, NaN without one.
    `age` is how old the last used sample is, infinity before the first. `innovation` (outputs,) is what that sample
    differed from what the model said of its time, NaN before the first. `late` counts the samples that were not used,
    for they came after a newer one or were older than `max_sample_age`, `refused` those that the gate did not believe,
    `missed` the last of these in a row, `renewed` how often the observer of the state was lost and began anew.
    `handed_over` says whether the watchdog has U, `offset` (m,) what an observer of the state finds at the inputs,
    `fallback` and `error` what a guard says. With a safety filter `filtered` says whether it changed U, `kept` is the
    least h = safe(P, t) of the predicted states, and `unkept` whether it found no plan that keeps the limits.
    """

    D_hat: float
    D_hat_spread: float
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
