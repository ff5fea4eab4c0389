"""What the controller sees of the plant: noise, a sampling period with jitter, a delay, dropped samples.

Between samples the state is predicted from the last one by the controller's own model, with the commands that have
reached the plant since, as the controller believes. Random numbers are a function of the seed, the loop, the step and
the state: they depend neither on the batch nor on the order of evaluation.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit, types

from npred import array_checks
from npred.delays import family
from npred.errors import ConfigError
from npred.loop.actuator import ROUNDING, copy, leaving
from npred.symbolic.compile_cache import jit

Observer = Callable[[np.ndarray, np.ndarray, np.ndarray, float], Any]
NOISE, GAP, DROP = 1, 2, 3  # what a random number is for


@dataclass(frozen=True)
class Measurement:
    """Sensors: each sample is X (1 + noise ξ), ξ standard normal by state, taken every `period` seconds.

    `period` None is every control step; each gap between samples is period (1 + jitter r), r uniform on [-1, 1].
    A sample arrives `delay` seconds after it was taken, or, with probability `drop`, never; the first one, at t = 0, is
    there at once. Times are rounded to control steps, and no gap is shorter than one. `observer(X_hat, Y, U, t)`
    replaces the prediction between samples: it takes the last estimate X_hat (B, n), the sample Y (B, n) that arrived
    now, NaN where there is none, and the input U (B, m) that acted since the last call, and gives X_hat (B, n) at time
    t, which then is what a DelayObserver sees. `first` is the number of the batch's first loop, where the batch is a
    part of a larger one: each loop has the noise that it has there.
    Raises ConfigError for a value out of range.
    """

    noise: float = 0.0
    period: float | None = None
    jitter: float = 0.0
    delay: float = 0.0
    drop: float = 0.0
    seed: int = 0
    observer: Observer | None = None
    first: int = 0

    def __post_init__(self) -> None:
        period = math.inf if self.period is None else array_checks.number("measurement: period", self.period)
        if not period > 0:
            raise ConfigError(f"measurement: expected a period above 0, got {self.period!r}; None is every step")
        for name, highest in (("noise", math.inf), ("delay", math.inf), ("jitter", 1.0), ("drop", 1.0)):
            value = array_checks.number(f"measurement: {name}", getattr(self, name))
            if not 0 <= value < highest:
                room = "of at least 0" if highest == math.inf else f"from 0 up to {highest:g}, not included"
                raise ConfigError(f"measurement: expected {name} {room}, got {value:g}; give another")
        if self.jitter and self.period is None:
            raise ConfigError("measurement: expected a period that jitter spreads, got none; give period")
        for name in ("seed", "first"):
            number = getattr(self, name)
            if not isinstance(number, int | np.integer) or not -(2**63) <= number < 2**63:
                raise ConfigError(
                    f"measurement: expected a whole number of 64 bits as {name}, got {number!r}; give one"
                )
        if self.observer is not None and not callable(self.observer):
            raise ConfigError(
                f"measurement: expected a function of X_hat, Y, U and t as observer, got {self.observer!r}; write one"
            )

    @property
    def perfect(self) -> bool:
        """Whether the controller sees X itself."""
        return self.observer is None and self.period is None and not (self.noise or self.delay or self.drop)


class Sensor(NamedTuple):
    """A measurement as the engine runs it: times in control steps, `first` the number of the batch's first loop."""

    noise: float
    period: float
    jitter: float
    age: int
    drop: float
    seed: int
    first: int


A1, A2, A3 = (types.Array(types.float64, d, "C") for d in (1, 2, 3))
I1 = types.Array(types.int64, 1, "C")
SENSOR = types.NamedTuple(
    [types.float64, types.float64, types.float64, types.int64, types.float64, types.int64, types.int64], Sensor
)
# k, sensor, X (n, B), past states (R, n, B), due (B,), number of the next sample (B,) -> Y (n, B)
SAMPLE = types.void(types.int64, SENSOR, A2, A3, A1, I1, A2)


def sensor(measurement: Measurement, dt: float, first: int) -> Sensor:
    """The measurement for control steps of dt seconds, of loops whose first has that number in the whole batch."""
    period = 1.0 if measurement.period is None else max(measurement.period / dt, 1.0)
    age = round(measurement.delay / dt)
    return Sensor(
        float(measurement.noise), period, float(measurement.jitter), age, float(measurement.drop),
        int(measurement.seed), first + measurement.first,
    )  # fmt: skip


@njit
def _uniform(seed: int, loop: int, number: int, state: int, purpose: int) -> float:
    """A number of (0, 1) that those five decide: SplitMix64 [Steele, Lea, Flood 2014], a round for each."""
    z = np.uint64(0x9E3779B97F4A7C15)
    for part in (seed, loop, number, state, purpose):
        z = (z ^ np.uint64(part)) + np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return (np.float64(z >> np.uint64(11)) + 0.5) / 9007199254740992.0  # 2^53


@njit
def _normal(seed: int, loop: int, number: int, state: int) -> float:
    """A standard normal number [Box and Muller 1958]."""
    radius = math.sqrt(-2.0 * math.log(_uniform(seed, loop, number, state, NOISE)))
    return radius * math.cos(2.0 * math.pi * _uniform(seed, loop, number, state, -NOISE))


@jit(SAMPLE, nogil=True)
def sample(
    k: int, sensor: Sensor, X: np.ndarray, past: np.ndarray, due: np.ndarray, number: np.ndarray, Y: np.ndarray
) -> None:
    """The samples that arrive at control step k, Y; NaN in the loops where none does. `past` keeps the last states."""
    rows, taken = past.shape[0], k - sensor.age
    copy(X, past[k % rows])
    for l in range(X.shape[1]):
        for c in range(X.shape[0]):
            Y[c, l] = np.nan
        loop, j = sensor.first + l, number[l]
        if k == 0 or (taken >= 0 and taken >= due[l] - ROUNDING):
            if k == 0 or _uniform(sensor.seed, loop, j, 0, DROP) >= sensor.drop:
                for c in range(X.shape[0]):
                    state = X[c, l] if k == 0 else past[taken % rows, c, l]
                    Y[c, l] = state * (1.0 + sensor.noise * _normal(sensor.seed, loop, j, c)) if sensor.noise else state
            if k == 0 or taken > 0:
                gap = sensor.period * (1.0 + sensor.jitter * (2.0 * _uniform(sensor.seed, loop, j, 0, GAP) - 1.0))
                due[l] += max(gap, 1.0)
            number[l] += 1


@njit
def _reached(k: int, dt: float, D: np.ndarray, held: np.ndarray, l: int, U0: Any, U1: Any, share: Any) -> None:
    """The input that acts during control step k in loop l, as `actuator.actuate` gives it, read from the history."""
    rows = held.shape[0]
    for c in range(D.shape[0]):
        i, share[c, 0] = leaving(k, dt, D[c, l])
        U0[c, 0] = held[i % rows, c, l]
        U1[c, 0] = held[min(i + 1, k) % rows, c, l]


MODEL = family.pointer(family.signature(family.ADVANCE))
# k, origin, dt, age, D (m, B), held (R, m, B), Y, X_hat (n, B), the model's step, p -> X_hat
ESTIMATE = types.void(types.int64, types.int64, types.float64, types.int64, A2, A3, A2, A2, MODEL, A1)


@jit(ESTIMATE, nogil=True)
def estimate(
    k: int, origin: int, dt: float, age: int, D: np.ndarray, held: np.ndarray, Y: np.ndarray, X_hat: np.ndarray,
    advance: Any, p: np.ndarray,
) -> None:  # fmt: skip
    """X_hat at control step k: from the sample that arrived now, or from the last estimate, forward by the model."""
    n, m = X_hat.shape[0], D.shape[0]
    x, U0, U1, share = np.empty((n, 1)), np.empty((m, 1)), np.empty((m, 1)), np.empty((m, 1))
    for l in range(X_hat.shape[1]):
        arrived = not np.isnan(Y[0, l])
        start = k if k == 0 else k - age if arrived else k - 1
        for c in range(n):
            x[c, 0] = Y[c, l] if arrived else X_hat[c, l]
        for i in range(start, k):
            _reached(origin + i, dt, D, held, l, U0, U1, share)
            advance(x, U0, U1, share, dt, i * dt, p)
        for c in range(n):
            X_hat[c, l] = x[c, 0]


def estimator(measurement: Measurement, traced: bool) -> Callable[..., None]:
    """`estimate`, in Python where the model is not traced; or that of the measurement's observer."""
    if measurement.observer is not None:
        return observed(measurement.observer)
    return estimate if traced else estimate.py_func


def observed(observer: Observer) -> Callable[..., None]:
    """`estimate` by a user's observer, in Python. Raises ConfigError where it returns another shape."""

    def step(
        k: int, origin: int, dt: float, age: int, D: Any, held: Any, Y: Any, X_hat: Any, advance: Any, p: Any
    ) -> None:
        m, lanes = D.shape
        U0, U1, share = (np.empty((m, lanes)) for _ in range(3))
        for l in range(lanes):
            _reached(origin + max(k - 1, 0), dt, D, held, l, U0[:, l : l + 1], U1[:, l : l + 1], share[:, l : l + 1])
        U = share * U0 + (1.0 - share) * U1
        if k == 0:
            X_hat[:] = Y
        values = np.asarray(observer(X_hat.T.copy(), Y.T.copy(), U.T, k * dt), dtype=float)
        if values.shape != X_hat.T.shape:
            raise ConfigError(
                f"observer: expected to return {X_hat.T.shape}, a row per loop, got {values.shape}; return that"
            )
        X_hat[:] = values.T
        Y[:] = X_hat  # an observer of the delay takes the state for a sample, since a sample may lack states

    return step
