"""The comparison of the benchmark, and the times in it."""

import gc
import itertools
import math
import os
import time

import numpy as np
import pytest

import npred
from npred.base.errors import ConfigError
from npred.lab.stages.bench import comparison, timing

PLANT = npred.plant("scalar")
LOOP = {"D": 0.5, "D_hat": 0.5, "X0": [1.0], "t_end": 8.0, "dt": 0.01}


class Growth:
    """X' = a X + U: P(x) is known in closed form where U is held."""

    states, inputs, guess = ("X",), ("U",), (0.0,)
    parameters = {"a": 1.0}
    f = lambda x, u, t, p, M: [p.a * x.X + u.U]
    kappa = lambda x, t, p, M: [-2 * x.X]


@pytest.fixture(scope="module")
def compared():
    plant = npred.plants.Plant("growth", Growth)
    runs = {f"euler {nx}": npred.predictor(plant, "euler", nx) for nx in (11, 21, 41)}
    return npred.compare(plant, runs, X0=[1.0], t_end=8.0, D=0.5, D_hat=0.5, dt=0.01)


def test_the_errors_fall_with_the_order_of_the_method(compared):
    eps = [row.eps_sup for row in compared.rows]
    orders = [math.log2(a / b) for a, b in zip(eps, eps[1:], strict=False)]
    assert all(0.8 < order < 1.2 for order in orders)


def test_the_loops_are_those_of_simulate(compared):
    plant = npred.plants.Plant("growth", Growth)
    run = npred.simulate(plant, npred.predictor(plant, "euler", 11), X0=[1.0], t_end=8.0, D=0.5, D_hat=0.5, dt=0.01)
    np.testing.assert_array_equal(compared.loops["euler 11"].X, run.X)
    row = compared.rows[0]
    assert row.radius == np.abs(run.X[run.t >= 7.2 - 1e-9]).max()
    outside = np.flatnonzero(np.abs(run.X[:, 0]) > 0.01)
    assert row.converged == 1.0 and row.settle_time == pytest.approx(run.t[outside[-1] + 1])


def test_table_data_frame_and_notebook(compared):
    lines = str(compared).splitlines()
    assert [line.split("  ")[0] for line in lines] == ["predictor", "euler 11", "euler 21", "euler 41"]
    assert compared._repr_html_().count("euler") == 3
    frame = compared.to_dataframe()
    assert list(frame.index) == ["euler 11", "euler 21", "euler 41"] and (frame.us > 0).all()


def test_a_guard_saves_a_wrong_predictor():
    plant = npred.plant("activator_repressor")
    euler = npred.predictor(plant, "euler", 11)
    guarded = npred.guarded(euler, 1e-6)
    about = {"D": 1.0, "D_hat": [0.8, 1.0], "X0": [0.03, 30.0], "t_end": 10.0}
    bare, safe = npred.compare(plant, {"bare": euler, "guarded": guarded}, **about).rows
    assert safe.eps_sup < bare.eps_sup


def test_names_of_a_list():
    runs = [npred.predictor(PLANT, "rk4", nx) for nx in (11, 21)] + [npred.predictor(PLANT, "heun")]
    assert list(comparison._named(runs)) == ["rk4, nx = 11", "rk4, nx = 21", "heun"]
    with pytest.raises(ConfigError, match="expected different ones, got heun, nx = 101; heun, nx = 101; name them"):
        comparison._named([runs[2]] * 2)


@pytest.mark.parametrize("wrong", [[], {}, "rk4", ["rk4"], {"rk4": 3}, None])
def test_what_is_no_predictor_is_refused(wrong):
    with pytest.raises(ConfigError, match="predictors: expected a list of predictors, or a dictionary"):
        npred.compare(PLANT, wrong, **LOOP)


def test_what_is_no_plant_is_refused():
    with pytest.raises(ConfigError, match=r"plant: expected a Plant, got 'scalar'; make one with npred.plant"):
        npred.compare("scalar", [npred.predictor(PLANT, "rk4")], **LOOP)


def test_loops_that_are_shorter_than_the_delay_leave_nothing_to_compare():
    with pytest.raises(ConfigError, match=r"t_end: expected loops longer than the delay 0.5, got 0.5; raise it"):
        npred.compare(PLANT, [npred.predictor(PLANT, "rk4")], **LOOP | {"t_end": 0.5})


def test_a_delay_that_varies_and_one_that_the_plant_declares():
    runs = [npred.predictor(PLANT, "rk4")]
    varying = npred.compare(PLANT, runs, **LOOP | {"D": lambda t: 0.5 + 0.1 * math.sin(t)})
    assert varying.rows[0].eps_sup < 1e-6
    declares = npred.plant("transport_tank")
    X0 = declares.target(0.0) * 1.01
    declared = npred.compare(declares, [npred.predictor(declares, "rk4")], X0=X0, t_end=5.0, dt=0.01)
    assert declared.rows[0].eps_sup < 1e-3


def test_each_contender_is_called_in_turn_and_every_call_counted():
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


def test_a_slow_contender_has_fewer_calls_but_some():
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


@pytest.mark.parametrize(
    ("lasts", "count"),
    [
        ([1000], 1000),  # µs; a tenth of ten seconds has room for a thousand
        ([1000, 1010], 1000),
        ([1000, 1200], 1104),  # the middle half spans 0.2 / 1.1 of the median: 24.6 times 0.1348, in per cent, squared
        ([1000, 9000], 10_000),  # more than there is time for
    ],
)
def test_calls_are_as_many_as_the_median_needs_and_a_tenth_of_the_time_holds(monkeypatch, lasts, count):
    now, each = [0], itertools.cycle(lasts)
    monkeypatch.setattr(timing.time, "perf_counter_ns", lambda: now[0])
    found = timing.affordable(lambda k: now.__setitem__(0, now[0] + 1000 * next(each)), 10**6, 10.0)
    assert found == pytest.approx(count, rel=0.01)


def test_a_first_call_that_compiles_does_not_make_the_others_fewer(monkeypatch):
    """Calls of 1 s, then of 1 ms: a tenth of a second has room for a hundred of them, and needs ten."""
    now, lasts = [0], itertools.chain([10**9], itertools.repeat(10**6))
    monkeypatch.setattr(timing.time, "perf_counter_ns", lambda: now[0])
    assert timing.affordable(lambda k: now.__setitem__(0, now[0] + next(lasts)), 1000, 0.1) == timing.LEAST
