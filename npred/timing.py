"""Timing of single calls, interleaved and with the tail kept: control loops miss deadlines in the tail."""

import gc
import time
from collections.abc import Callable, Mapping

import numpy as np

ROUNDS = 10  # the machine's drift falls on all contenders alike


def sample(
    calls: Mapping[str, Callable[[int], None]], count: int, progress: Callable[[int], None] | None = None
) -> dict[str, np.ndarray]:
    """Nanoseconds of `count` calls of each contender, (count,): call(k) is the k-th call. Garbage collector off."""
    taken: dict[str, list[np.ndarray]] = {name: [] for name in calls}
    edges = np.linspace(0, count, ROUNDS + 1).astype(int)
    gc_was_on = gc.isenabled()
    gc.disable()
    try:
        for start, stop in zip(edges, edges[1:], strict=False):
            for name, call in calls.items():
                call(start)  # back into the caches
                taken[name].append(_clock(call, range(start, stop)))
                if progress:
                    progress(stop - start)
    finally:
        if gc_was_on:
            gc.enable()
    return {name: np.concatenate(parts) for name, parts in taken.items()}


def _clock(call: Callable[[int], None], numbers: range) -> np.ndarray:
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
