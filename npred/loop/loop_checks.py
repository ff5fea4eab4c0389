"""Checks of the arguments of a closed loop before it runs: the compiled engine trusts their shapes."""

import math
from typing import Any

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.base.progress import say
from npred.loop import control_step
from npred.loop.loop import Loop
from npred.loop.timing import ROUNDING
from npred.plants.base import Plant


def samples(samples: Any, shape: tuple[int, ...], last: int) -> np.ndarray:
    """The steps to keep of each loop, (B, S)."""
    steps = np.zeros(0, dtype=np.int64) if samples is None else np.asarray(samples)
    fits = steps.ndim > 0 and steps.dtype.kind in "iu" and array_checks.fits(steps.shape[:-1], shape)
    if not fits or (np.diff(steps) < 0).any() or (steps < 0).any() or (steps > last).any():
        raise ConfigError(f"samples: expected sorted whole steps of 0 to {last}, (..., S), got {samples}; sort them")
    count = steps.shape[-1]
    return np.broadcast_to(steps.astype(np.int64), (*shape, count)).reshape(math.prod(shape), count)


def start(plant: Plant, X0: np.ndarray) -> None:
    """Raise ConfigError for a start that makes no state of the plant."""
    if X0.ndim < 1 or X0.shape[-1] != plant.n:
        axes = ", ".join(plant.states) if plant.n < 5 else "its states"
        what = f"expected shape (..., {plant.n}) for plant {plant.name}"
        raise ConfigError(f"X0: {what}, got {X0.shape}; the last axis is {axes}")
    array_checks.finite("X0", X0)
    for k, name in enumerate(plant.states):
        low, high = plant.state_bounds.get(name, (-np.inf, np.inf))
        if (X0[..., k] < low).any() or (X0[..., k] > high).any():
            came = f"got {X0[..., k].min():g} to {X0[..., k].max():g}"
            raise ConfigError(f"X0: expected {name} within its state_bounds [{low:g}, {high:g}], {came}; start inside")


def push(value: Any, m: int, shape: tuple[int, ...] = ()) -> np.ndarray:
    """The values that a disturbance adds to a batch of that shape: (1, m), or (B, m) where it has the batch's axes.

    Raises ConfigError for another shape or a number that is not finite.
    """
    array = array_checks.floats("disturbance(t)", value)
    if not array_checks.fits(array.shape, (*shape, m)) or not np.isfinite(array).all():
        each = f", or an array {(*shape, m)}" if shape else ""
        what = f"expected {m} finite numbers, one per input{each}"
        raise ConfigError(f"disturbance(t): {what}, got {value!r}; return a list")
    return np.broadcast_to(array, (*(shape if array.ndim > 1 else ()), m)).reshape(-1, m)


def stepped(loop: Loop, D: Any, D_hat: Any, t_end: Any) -> Loop:
    """The loop with a control step, where none is given the usual one of the delay, else of the estimate."""
    if loop.dt is not None:
        return loop
    ends, delays = array_checks.number("t_end", t_end), array_checks.floats("D", D)
    spans = delays if (delays > 0).any() else array_checks.floats("D_hat", D_hat)
    integrates = loop.adaptation is not None and loop.adaptation.integrates
    dt = min(control_step.usual(spans, loop.plant, integrates), ends)
    return loop.filled(dt=dt)


def delays(loop: Loop, D: np.ndarray, D_hat: np.ndarray, t_end: float) -> None:
    """Raise ConfigError for a control step that is longer than a delay which is estimated; say where it is long for the
    estimate or for the law, and where no command of the loop reaches the plant. A declared delay may pass through 0.
    """
    plant = loop.plant
    if loop.predictor is None or plant.declares_delay:
        return
    predicted = np.where((D_hat > 0) | (loop.adaptation is not None), D, 0.0)
    if loop.adaptation is not None:
        control_step.check("dt", loop.dt, D)
    if text := control_step.doubt("dt", loop.dt, predicted, plant, loop.adaptation is not None):
        say(text)
    if (late := predicted[predicted > t_end]).size:
        say(f"t_end: no command reaches the plant before t_end = {t_end:g}, with D = {plant.time_text(late.min())}")


def times(loop: Loop, t_end: Any, every: Any) -> None:
    """Raise ConfigError for what is no length of a loop or no control step of it, and for samples or kept states
    between two steps.
    """
    dt, period = loop.dt, loop.measurement.period
    if not isinstance(every, int | np.integer) or every < 1:
        raise ConfigError(f"every: expected a whole number of steps from 1 on, got {every!r}; give 1, 2, …")
    if not 0 < array_checks.number("dt", dt) <= array_checks.number("t_end", t_end) < np.inf:
        raise ConfigError(f"dt, t_end: expected 0 < dt <= t_end, got dt = {dt}, t_end = {t_end}")
    if period is not None and period < dt * (1 - ROUNDING):
        cure = "raise it, or leave it out for a sample each step"
        raise ConfigError(f"measurement: expected a period of at least dt = {dt:g}, got {period:g}; {cure}")


def one_per_loop(plant: Plant, D: np.ndarray, X0: np.ndarray) -> None:
    """Raise ConfigError where a list of delays may be meant as that of the inputs, which differ."""
    if not plant.one_delay and D.shape == (plant.m,) and X0.ndim == 1:
        shares = ", ".join(f"{name} after {r:.4g} D" for name, r in zip(plant.inputs, plant.ratios, strict=True))
        several = f"a delay for each of {plant.m} loops, or of {plant.m} inputs"
        cure = f"give the longest delay, or, for {plant.m} loops, X0 with a row for each"
        raise ConfigError(f"D: expected one delay, for plant {plant.name} declares {shares}, got {several}; {cure}")


def record(plant: Plant, loops: int, t_end: float, dt: float, every: int) -> None:
    """Raise ConfigError for loops whose record this machine cannot hold."""
    needed = 8 * loops * (2 * plant.n + plant.m + 3) * (float(t_end) / dt / every + 1)
    array_checks.room("t_end", "a record", needed, "shorten t_end, lengthen dt or keep every 10th step with every")


def history(plant: Plant, reach: float, dt: float) -> None:
    """Raise ConfigError for commands of the last `reach` that this machine cannot hold."""
    cure = "shorten D, the bounds of the law or the delay of the measurement, or lengthen dt"
    array_checks.room("D", "the history", 16 * plant.m * reach / dt, cure)
