"""Timing: every call is taken, predictors take turns, the collector is given back."""

import gc
import itertools
import os
import time

import numpy as np
import pytest

from npred.lab.stages.bench import timing


def test_each_predictor_is_called_in_turn_and_every_call_counted():
    log, told = [], []
    calls = {name: (lambda k, name=name: log.append((name, k))) for name in ("a", "b")}
    times = timing.sample(calls, 25, 60.0, told.append)
    assert {name: len(samples) for name, samples in times.items()} == {"a": 25, "b": 25}
    assert all((samples >= 0).all() for samples in times.values())
    assert sum(told) == 50
    rounds = "".join(name for name, _ in log[2 * timing.WARM_UP :])
    assert rounds.count("ab") == timing.ROUNDS, "ten rounds of a, then b"
    for name in ("a", "b"):
        assert set(range(25)) == {k for n, k in log if n == name}


def test_a_slow_predictor_has_fewer_calls_but_some():
    calls = {"slow": lambda k: time.sleep(0.002), "quick": lambda k: None}
    times = timing.sample(calls, 400, 0.01)
    assert len(times["slow"]) == timing.LEAST < len(times["quick"]) == 400


def test_the_collector_is_off_meanwhile_and_on_after():
    seen = []
    timing.sample({"a": lambda k: seen.append(gc.isenabled())}, 10, 1.0)
    assert not any(seen) and gc.isenabled()


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system does not choose cores")
def test_one_core_meanwhile_and_all_after():
    before = os.sched_getaffinity(0)
    with pytest.raises(RuntimeError), timing.undisturbed():
        assert len(os.sched_getaffinity(0)) == 1
        raise RuntimeError
    assert os.sched_getaffinity(0) == before and gc.isenabled()


def test_stops_are_gaps_between_two_looks_at_the_clock(monkeypatch):
    """A clock that goes on by 50 ns a look, and by 30 or 40 µs more at three of them."""
    late = {100: 40_000, 2000: 30_000, 3000: 40_000}
    looks = itertools.accumulate(50 + late.get(k, 0) for k in itertools.count())
    monkeypatch.setattr(timing.time, "perf_counter_ns", lambda: next(looks))
    assert timing.stops(0.001) == {"per_s": 3000.0, "median_us": pytest.approx(40.05)}
    assert timing.stops(0.001) == {"per_s": 0.0, "median_us": 0.0}


def test_quantiles_in_microseconds():
    found = timing.quantiles(np.arange(1001) * 1000)
    assert found == {"median_us": 500.0, "p95_us": 950.0, "p999_us": 999.0, "max_us": 1000.0}


def test_a_first_call_that_compiles_does_not_make_the_others_fewer(monkeypatch):
    """Calls of 1 s, then of 1 ms: a tenth of a second has room for a hundred of them."""
    now, lasts = [0], itertools.chain([10**9], itertools.repeat(10**6))
    monkeypatch.setattr(timing.time, "perf_counter_ns", lambda: now[0])
    assert timing.affordable(lambda k: now.__setitem__(0, now[0] + next(lasts)), 1000, 0.1) == 100
