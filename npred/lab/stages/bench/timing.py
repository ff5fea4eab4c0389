"""Timing of single calls, interleaved and with the tail kept: control loops miss deadlines in the tail."""

import gc
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np

ROUNDS = 10  # the machine's drift falls on all predictors alike
STOP = 5000  # ns: reading the clock takes a hundredth of that
LEAST = 10  # calls of a predictor, however long they take
WARM_UP = 3
PROBE = 100  # calls at most that show how much calls differ
INTERVAL = 0.01  # half of the median's 95 % interval, as a share of the median: more calls would say no more
SHARE = 0.1  # of the time that there is, which a predictor gets whatever its calls show: for the tail
Call = Callable[[int], None]


def sample(
    calls: Mapping[str, Call], count: int | Mapping[str, int], seconds: float = np.inf,
    progress: Callable[..., None] | None = None,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Nanoseconds of the calls of each predictor: call(k) is the k-th call, of `count` or of as many as take `seconds`.

    Predictors take turns, on one core where that can be had, with the garbage collector off. `progress` takes a
    number of calls.
    """
    counts = dict.fromkeys(calls, count) if isinstance(count, int) else count
    taken: dict[str, list[np.ndarray]] = {name: [] for name in calls}
    with undisturbed():
        edges = {
            name: np.linspace(0, affordable(call, counts[name], seconds), ROUNDS + 1).astype(int)
            for name, call in calls.items()
        }
        for turn in range(ROUNDS):
            for name, call in calls.items():
                numbers = range(edges[name][turn], edges[name][turn + 1])
                call(numbers.start)  # back into the caches
                taken[name].append(_clock(call, numbers))
                if progress:
                    progress(len(numbers))
    return {name: np.concatenate(parts) for name, parts in taken.items()}


def affordable(call: Call, count: int, seconds: float) -> int:
    """The number of calls, at most `count`, that fit into `seconds` if each takes as long as the quickest warm-up.

    No more than the median needs for an interval of INTERVAL, by how much the calls of a probe differ; but as many as
    fit into SHARE of the time.
    """
    if np.isinf(seconds):
        return count
    quickest = max(_clock(call, range(WARM_UP)).min() / 1e9, 1e-9)
    few, most = (min(count, max(LEAST, share * seconds / quickest)) for share in (SHARE, 1.0))
    if few == most:
        return int(most)
    low, median, high = np.quantile(_clock(call, range(int(min(few, PROBE)))), (0.25, 0.5, 0.75))
    deviation = (high - low) / 1.349 / max(median, 1.0)
    needed = (1.96 * 1.253 * deviation / INTERVAL) ** 2  # the median's error is 1.253 times that of the mean
    return int(min(most, max(few, needed)))


@contextmanager
def undisturbed() -> Iterator[None]:
    """The garbage collector off, and this thread on one core, where the system lets it choose."""
    collects, cores = gc.isenabled(), os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    gc.disable()
    if cores:
        os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        if cores:
            os.sched_setaffinity(0, cores)
        if collects:
            gc.enable()


def stops(seconds: float = 0.5) -> dict[str, float]:
    """The stops per second of a thread that only reads the clock, when the system takes its core, and their length.

    That is in the tail of whatever is timed here: of calls that last c seconds it meets the share c times `per_s`.
    """
    gaps, now = [], time.perf_counter_ns
    with undisturbed():
        before = now()
        end = before + int(seconds * 1e9)
        while before < end:
            after = now()
            if after - before > STOP:
                gaps.append(after - before)
            before = after
    return {"per_s": len(gaps) / seconds, "median_us": float(np.median(gaps)) / 1000 if gaps else 0.0}


def _clock(call: Call, numbers: range) -> np.ndarray:
    times = np.empty(len(numbers), dtype=np.int64)
    now = time.perf_counter_ns
    for row, k in enumerate(numbers):
        before = now()
        call(k)
        times[row] = now() - before
    return times


def quantiles(nanoseconds: np.ndarray) -> dict[str, float]:
    """median, 95 and 99.9 % quantiles and maximum, in microseconds."""
    median, p95, p999 = np.quantile(nanoseconds, (0.5, 0.95, 0.999)) / 1000
    return {"median_us": median, "p95_us": p95, "p999_us": p999, "max_us": float(nanoseconds.max()) / 1000}
