"""The controller's view of the plant: noise, a sampling period with jitter, a delay, dropped samples.

Between samples the state is predicted from the last one by the controller's own model, with the commands that have
reached the plant since, as the controller believes. Random numbers are a function of the seed, the loop, the step and
the state: they depend neither on the batch nor on the order of evaluation.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError

if TYPE_CHECKING:  # reading a pipeline has no use for what compiles
    from npred.plants.base import Plant

PER_STATE = ("noise", "relative_noise", "bias", "resolution")  # one number, or one for each state
Estimate = Callable[[np.ndarray, np.ndarray, np.ndarray, float], Any]
PerState: TypeAlias = float | Sequence[float]


def share(label: str, name: str, number: Any, highest: float = 1.0) -> None:
    """Raise ConfigError unless it is a number from 0 up to the highest, not included."""
    value = array_checks.number(f"{label}: {name}", number)
    if not 0 <= value < highest:
        room = "of at least 0" if highest == math.inf else f"from 0 up to {highest:g}, not included"
        raise ConfigError(f"{label}: expected {name} {room}, got {value:g}; give another")


def whole(label: str, name: str, number: Any) -> None:
    """Raise ConfigError unless it is a whole number of 64 bits."""
    if not isinstance(number, int | np.integer) or not -(2**63) <= number < 2**63:
        raise ConfigError(f"{label}: expected a whole number of 64 bits as {name}, got {number!r}; give one")


@dataclass(frozen=True)
class Sensors:
    """Sensors: a sample of state i is q_i(X_i (1 + relative_noise_i ξ_i) + noise_i η_i + bias_i), each `period`.

    ξ and η are standard normal, independent by sample and state; q_i rounds to the nearest multiple of resolution_i,
    half to even, and not at all where that is 0. The first sample, at t = 0, is there at once. Times are rounded to
    control steps, and no gap between samples is shorter than one. Between samples the controller predicts the state
    from the last one and its commands.

    Raises ConfigError for a value out of range.
    """

    noise: PerState = 0.0  #: standard deviation of a sample, in units of the state
    relative_noise: PerState = field(default=0.0, kw_only=True)  #: the same, relative to its value
    bias: PerState = field(default=0.0, kw_only=True)  #: offset of each sample, in units of the state
    resolution: PerState = field(default=0.0, kw_only=True)  #: step of the sensor, in units of the state; 0 for none
    period: float | None = None  #: between samples, in the plant's unit of time; by default the control step
    jitter: float = 0.0  #: largest deviation of a period, relative to it
    delay: float = 0.0  #: from a sample to its arrival, in the plant's unit of time
    drop: float = 0.0  #: probability that a sample never arrives

    def __post_init__(self) -> None:
        period = math.inf if self.period is None else array_checks.number("measurement: period", self.period)
        if not period > 0:
            raise ConfigError(f"measurement: expected a period above 0, got {self.period!r}; None is every step")
        for name in PER_STATE:
            kind = "one real number, or one per state"
            values = array_checks.floats(f"measurement: {name}", getattr(self, name), kind)
            if values.ndim > 1:
                came = f"an array of shape {values.shape}"
                raise ConfigError(f"measurement: {name}: expected {kind}, got {came}; give a list")
            if name == "bias":
                array_checks.finite("measurement: bias", values)
            else:
                array_checks.at_least_0("measurement", values, name)
            object.__setattr__(self, name, tuple(values.tolist()) if values.ndim else float(values))
        share("measurement", "delay", self.delay, math.inf)
        share("measurement", "jitter", self.jitter)
        share("measurement", "drop", self.drop)
        if self.jitter and self.period is None:
            raise ConfigError("measurement: expected a period that jitter spreads, got none; give period")

    @property
    def exact(self) -> bool:
        """Whether each sample is X itself, at once."""
        perturbed = any(np.any(getattr(self, name)) for name in PER_STATE)
        return not perturbed and self.period is None and not (self.delay or self.drop)

    def sampled(self, X: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """A sample of X (n,) at its time, by another generator than that of npred/kernels/c/sensor_errors.h."""
        Y = X * (1 + np.asarray(self.relative_noise) * rng.standard_normal(X.shape))
        Y = Y + np.asarray(self.noise) * rng.standard_normal(X.shape) + np.asarray(self.bias)
        step = np.broadcast_to(self.resolution, X.shape).astype(float)
        return np.where(step > 0, np.round(Y / np.where(step > 0, step, 1.0)) * step, Y)

    def check(self, plant: "Plant", outputs: int | None = None) -> None:
        """Raise ConfigError where there is not a number for each state of the plant, or for each of its outputs."""
        count, what = (plant.n, "state") if outputs is None else (outputs, "output")
        for name in PER_STATE:
            value = getattr(self, name)
            if isinstance(value, tuple) and len(value) != count:
                what = f"expected {name} as one number or {count}, one per {what} of plant {plant.name}"
                raise ConfigError(f"measurement: {what}, got {len(value)}; give as many")


@dataclass(frozen=True)
class Measurement(Sensors):
    """Sensors with the seed of their noise, and an observer X_hat = observer(X_hat, Y, U, t) in Python.

    `first` is the number of the first loop, where loops are part of a larger batch.
    """

    seed: int = 0  #: seed of the noise, of gaps and of lost samples
    observer: Estimate | None = None  #: gives X_hat (B, n), of the last one, the sample Y, NaN without, U and t
    first: int = 0  #: number of the batch's first loop in a larger batch: each has the noise that it has there

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("measurement", "seed", self.seed)
        whole("measurement", "first", self.first)
        if self.observer is not None and not callable(self.observer):
            what = "expected a function of X_hat, Y, U and t as observer"
            raise ConfigError(f"measurement: {what}, got {self.observer!r}; write one")

    @property
    def perfect(self) -> bool:
        """Whether the controller sees X itself."""
        return self.exact and self.observer is None


def settings(measurement: Measurement, dt: float, first: int, n: int) -> dict[str, Any]:
    """The measurement of n states by the names of npred.loop.signals: times in control steps of dt.

    `first` is the number that the first of these loops has in the batch.
    """
    return {name: np.full(n, getattr(measurement, name)) for name in PER_STATE} | {
        "period": 1.0 if measurement.period is None else max(measurement.period / dt, 1.0),
        "jitter": measurement.jitter,
        "drop": measurement.drop,
        "age": round(measurement.delay / dt),
        "seed": measurement.seed,
        "first": first + measurement.first,
    }


def observed(observer: Estimate) -> Callable[..., None]:
    """problem.ESTIMATE of npred.prediction.delays by a user's observer. Raises ConfigError for another shape."""
    from npred.loop.actuator import acting

    def step(k: int, origin: int, dt: float, D_seen: Any, held: Any, Y: Any, X_hat: Any) -> None:
        acting(origin + max(k - 1, 0), dt, D_seen, held, U := np.empty_like(D_seen))
        if k == 0:
            X_hat[:] = Y
        values = np.asarray(observer(X_hat.T.copy(), Y.T.copy(), U.T, k * dt), dtype=float)
        if values.shape != X_hat.T.shape:
            what = f"expected to return {X_hat.T.shape}, a row per loop"
            raise ConfigError(f"observer: {what}, got {values.shape}; return that")
        X_hat[:] = values.T
        Y[:] = X_hat  # the observer of the delay reads X_hat, because Y may be incomplete

    return step
