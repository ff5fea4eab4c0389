"""The state of a controller after each call, for people."""

from typing import NamedTuple

import numpy as np


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
