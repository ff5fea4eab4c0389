"""When things happen in a loop on a real clock: calls, samples and losses, all known before it runs."""

import csv
import math
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.loop.measurement import Measurement, share, whole

ROUNDING = 1e-9  # in control steps: positions this close to a step's start are on it
SNAP = 1e-6  # in control steps: times this close to a regular clock's are on it
# what a random number is for, as in npred/kernels/c/sensor_errors.h
GAP, DROP, CALL, OVERRUN, LOST, SAMPLE, COMMAND = 2, 3, 5, 6, 7, 8, 9
LATENCIES = ("sample_latency", "command_latency")
Latency: TypeAlias = float | str | Path | Sequence[float] | Sequence[tuple[float, float]]
FIRST = np.uint64(0x9E3779B97F4A7C15)
FACTORS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


@dataclass(frozen=True)
class ControlClock:
    """The clock of a control loop: call k comes at k dt + jitter dt r, r uniform on [-1, 1]; the first one at 0.

    In a control step whose call is skipped nothing is computed.

    Of samples and commands each packet takes its own time, and the newest wins: one that arrives with or after a newer
    one is not used. Such a latency is a number; a list, of packet after packet, from the start again at its end,
    infinite for a lost one; pairs (share, latency), the quantiles of a distribution, as [(0, 0.01), (0.9, 0.02), (1,
    0.2)], linear between; or the name of a CSV file with the column `latency`, or `sent` and `received` in times, empty
    for a lost one. Samples and control steps are counted also where they are lost.

    Raises ConfigError for a value out of range, and for a file that is not such a table.
    """

    jitter: float = 0.0  #: largest deviation of a call from its time, in control steps
    lost: float = 0.0  #: probability that a command is lost; the actuator keeps the last one
    overrun: float = 0.0  #: probability that a call is skipped
    tells: bool = False  #: whether the next call reports a lost command to the controller
    stop: float = 0.0  #: samples of the last `stop` are lost …
    stop_every: float | None = None  #: … of each period of this length, both in the plant's unit of time
    sample_latency: Latency = 0.0  #: how long each sample travels besides the measurement's delay, in that unit
    command_latency: Latency = 0.0  #: how long each command travels to the actuator; the plant's D follows

    def __post_init__(self) -> None:
        share("timing", "jitter", self.jitter, 0.5)
        share("timing", "lost", self.lost)
        share("timing", "overrun", self.overrun)
        every = math.inf if self.stop_every is None else array_checks.number("timing: stop_every", self.stop_every)
        if not 0 <= (stop := array_checks.number("timing: stop", self.stop)) < every or bool(stop) == math.isinf(every):
            came = f"got {self.stop!r} and {self.stop_every!r}"
            raise ConfigError(f"timing: expected 0 < stop < stop_every, or neither, {came}; give two times")
        for name in LATENCIES:
            object.__setattr__(self, name, packets(f"timing: {name}", getattr(self, name)))


@dataclass(frozen=True)
class Timing(ControlClock):
    """The clock of a control loop, with the seed of its random numbers, which are functions of loop and call too."""

    seed: int = 0  #: seed of jitter, of lost commands and of skipped calls

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("timing", "seed", self.seed)


def packets(name: str, value: Any) -> float | tuple[Any, ...]:
    """A latency as numbers: one, several, or pairs. Raises ConfigError for any other."""
    what = "a latency, a list of them, or pairs (share, latency) from share 0 to 1"
    array = _recorded(name, value) if isinstance(value, str | Path) else array_checks.floats(name, value, what)
    array = np.where(np.isnan(array), np.inf, array) if array.ndim == 1 else array
    values = array[:, -1] if array.ndim == 2 and array.size else array
    good = array.ndim < 3 and (values >= 0).all() and np.isfinite(values).any()
    if array.ndim == 2:
        good = good and array.shape[1] == 2 and np.isfinite(array).all() and (array[0, 0], array[-1, 0]) == (0, 1)
        good = good and (np.diff(array, axis=0) >= 0).all()
    if not good:
        came = repr(str(value)) if isinstance(value, str | Path) else reprlib.repr(value)
        raise ConfigError(f"{name}: expected {what}, none below 0 and one finite, got {came}; give another")
    return float(array) if array.ndim == 0 else tuple(map(tuple, array.tolist()) if array.ndim == 2 else array.tolist())


def _recorded(name: str, file: str | Path) -> np.ndarray:
    """The latencies in a CSV file, NaN for a lost packet. Raises ConfigError where there are none."""
    try:
        lines = Path(file).read_text(encoding="utf-8-sig").rstrip().splitlines()
        names, *cells = csv.reader(lines, skipinitialspace=True)
        if "latency" not in names and not {"sent", "received"} <= {*names}:
            raise ValueError(f"columns {', '.join(names)}")
        rows = [dict(zip(names, row, strict=False)) for row in cells]
        latency, sent, received = (
            np.array([float(row.get(column) or "nan") for row in rows]) for column in ("latency", "sent", "received")
        )
        return latency if "latency" in names else received - sent
    except (OSError, ValueError, csv.Error) as error:
        what = "expected a CSV file with the column latency, or sent and received"
        raise ConfigError(f"{name}: {what}, got {str(file)!r}: {error}; write one") from None


def travels(latency: Any, numbers: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """How long the packets of these numbers travel, each at its share of a distribution; infinite where lost."""
    values = np.atleast_1d(np.array(latency))
    return np.interp(shares, *values.T) if values.ndim == 2 else values[numbers % len(values)]


def ends(latency: Any) -> tuple[float, float]:
    """The shortest and the longest latency of a packet that is not lost."""
    values = np.atleast_1d(np.array(latency))
    values = values[:, 1] if values.ndim == 2 else values[np.isfinite(values)]
    return float(values.min()), float(values.max())


class Schedule(NamedTuple):
    """The events of a loop of K control steps, in control steps: of each one the call at `at` (K,), `gap` after the
    one before, whose command reaches the actuator at `reaches` (K,); `skipped`, `lost` (K,); `sample` (K,) is the row
    of the sample that it gets, -1 without a new one, of the age `age` (K,). Of each sample (S,) when it is `taken`, and
    its `number`.
    """

    at: np.ndarray
    gap: np.ndarray
    reaches: np.ndarray
    skipped: np.ndarray
    lost: np.ndarray
    sample: np.ndarray
    age: np.ndarray
    taken: np.ndarray
    number: np.ndarray


def schedule(timing: Timing, measurement: Measurement, dt: float, count: int, loop: int) -> Schedule:
    """The schedule of `count` control steps of dt in the loop of that number.

    Sensors run on another clock: the gaps between two are period (1 + jitter r), as npred.Measurement has them, not
    rounded to control steps. Without a period a call takes one. A sample arrives `delay` and its latency after it was
    taken or, with probability `drop`, never; the first one, at 0, is there at once. A call gets the newest that has
    arrived.
    """
    steps = np.arange(count)
    at = steps.astype(float)
    if timing.jitter:
        at[1:] += timing.jitter * (2 * uniform(timing.seed, loop, steps[1:], CALL) - 1)
    skipped = happens(timing.overrun, timing.seed, loop, steps, OVERRUN)
    skipped[0] = False
    reaches = at + travels(timing.command_latency, steps, uniform(timing.seed, loop, steps, COMMAND)) / dt
    lost = happens(timing.lost, timing.seed, loop, steps, LOST) | np.isinf(reaches)
    taken = at[~skipped]
    if measurement.period is not None:  # by the sensors' clock
        period = measurement.period / dt
        numbers = np.arange(math.ceil(at[-1] / (period * (1 - measurement.jitter))) + 2)
        gaps = period * (1 + measurement.jitter * (2 * uniform(measurement.seed, loop, numbers, GAP) - 1))
        taken = np.concatenate([[0.0], np.cumsum(gaps)[:-1]]) if measurement.jitter else numbers * period
        taken = snapped(taken)
        taken = taken[taken <= at[-1] + ROUNDING]
    number = np.arange(len(taken))
    travelling = travels(timing.sample_latency, number, uniform(timing.seed, loop, number, SAMPLE))
    late = (measurement.delay + travelling) / dt
    kept = ~happens(measurement.drop, measurement.seed, loop, number, DROP) & np.isfinite(late)
    if timing.stop_every is not None:
        kept &= (taken + SNAP) % (timing.stop_every / dt) < (timing.stop_every - timing.stop) / dt
    kept[0] = True
    taken, number = taken[kept], number[kept]
    arrives = taken + late[kept]
    arrives[0] = 0.0
    order = np.argsort(arrives, kind="stable")
    called = np.flatnonzero(~skipped)
    gap, sample, age = np.ones(count), np.full(count, -1), np.zeros(count)
    gap[called[1:]] = snapped(np.diff(at[called]))
    count_by = np.searchsorted(arrives[order], at[called] + ROUNDING, side="right")
    newest = np.maximum.accumulate(order)[count_by - 1]
    new = np.diff(newest, prepend=-1) > 0
    sample[called[new]] = newest[new]
    age[called[new]] = np.maximum(snapped(at[called[new]] - taken[newest[new]]), 0.0)
    return Schedule(at, gap, reaches, skipped, lost, sample, age, taken, number)


def on_steps(measurement: Measurement, dt: float | None) -> bool:
    """Whether samples are taken at control steps and are there at once; False for a dt that is not known yet."""
    if measurement.jitter or measurement.delay or dt is None:
        return False
    steps = 1.0 if measurement.period is None else measurement.period / dt
    return abs(steps - round(steps)) <= ROUNDING


def snapped(steps: np.ndarray | float) -> np.ndarray:
    """Numbers of control steps, whole where they are nearly."""
    return np.where(np.abs(steps - np.round(steps)) <= SNAP, np.round(steps), steps)


def happens(share: float, seed: int, loop: int, numbers: np.ndarray, purpose: int) -> np.ndarray:
    """Whether something of that probability happens, for each number."""
    return uniform(seed, loop, numbers, purpose) < share if share else np.zeros(len(numbers), dtype=bool)


def uniform(seed: int, loop: int, numbers: np.ndarray, purpose: int) -> np.ndarray:
    """Numbers of (0, 1) that those four decide: `uniform` of npred/kernels/c/sensor_errors.h, at state 0."""
    z = np.full(len(numbers), FIRST)
    parts = (np.int64(seed), np.int64(loop), numbers.astype(np.int64), np.int64(0), np.int64(purpose))
    with np.errstate(over="ignore"):
        for part in parts:
            z = (z ^ np.asarray(part).astype(np.uint64)) + FIRST
            z = (z ^ (z >> np.uint64(30))) * FACTORS[0]
            z = (z ^ (z >> np.uint64(27))) * FACTORS[1]
            z = z ^ (z >> np.uint64(31))
    return ((z >> np.uint64(11)).astype(float) + 0.5) / 2.0**53
