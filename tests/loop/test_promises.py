"""The attack on promises of the safety filter, benchmarks/promises.py."""

from dataclasses import replace
from types import SimpleNamespace

import limited
import numpy as np
import promises
import pytest
from harness import starts
from scipy.integrate import solve_ivp

CASES = limited.cases()


@pytest.mark.parametrize("name", promises.SYSTEMS)
def test_its_systems_are_those_of_the_plants(name):
    case, rng = CASES[name], np.random.default_rng(0)
    X, u = starts(case.plant, 20, rng), rng.uniform(*np.array(case.plant.input_bounds).T, (20, case.plant.m))
    f, safe = promises.rates(case)
    np.testing.assert_allclose(f(X, u, 0.0), case.plant.f(X, u), rtol=1e-11, atol=1e-12)
    for t in (0.0, 3.9, 4.1):
        np.testing.assert_allclose(safe(X, t), case.plant.safe(X, t), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("name", ["jerked", "elbow", "bend"])
def test_what_it_integrates_is_what_scipy_does(name):
    case, rng = CASES[name], np.random.default_rng(1)
    X, u, t = starts(case.plant, 1, rng)[0], rng.uniform(*np.array(case.plant.input_bounds).T), 1.7
    Z, least = promises.onward(case, np.append(X, t), u, 5 * case.dt, 5)
    path = solve_ivp(
        lambda t, x: case.plant.f(x, u, t), (t, t + 5 * case.dt), X, method="DOP853", rtol=1e-11, atol=1e-13,
        t_eval=np.linspace(t, t + 5 * case.dt, 5 * promises.FINE + 1),
    )  # fmt: skip
    np.testing.assert_allclose(Z[:-1], path.y[:, -1], rtol=1e-8, atol=1e-10)
    rooms = [case.plant.safe(x, t).min() for x, t in zip(path.y.T, path.t, strict=True)]
    assert least == pytest.approx(min(rooms) / case.size, abs=1e-8)


def test_a_loop_is_replayed_with_each_delay_and_any_earlier_input():
    case, before = CASES["wall"], np.array([[0.5], [-1.0], [0.2], [0.9]])
    X0, D = np.array([[0.0, 0.5], [1.0, 0.0]]), np.array([0.28, 0.34])
    loop = promises.loops(case, X0, None, 3.0, D=D, u0=lambda t: promises.past(case, before, t))
    least = promises.replayed(case, loop, D, before)
    for k, late in enumerate((28, 34)):
        np.testing.assert_allclose(least[k, 0], loop.safety[k, late:].min(), atol=1e-4)
    assert (np.diff(least[:, :-34], axis=1) >= 0).all() and np.isinf(least[:, -28:]).all()
    other = replace(loop, U=loop.U + 0.1)
    assert (promises.replayed(case, other, D, before)[:, 0] == -np.inf).all()


def test_a_promise_that_is_made_to_all_is_broken(monkeypatch):
    monkeypatch.setattr(promises, "promised", lambda loop, first: np.ones(loop.filtered.shape, dtype=bool))
    names, line = promises.random({"near": CASES["near"]}, SimpleNamespace(starts=40, seed=0))
    found = dict(zip(names, line, strict=True))
    assert found["promised"] == 40 and found["broken"] > 5 and float(found["least h"]) < -0.1
    assert found["well"] > 3 and found["other U"] == 0
    size, promised, broken, *_ = promises.search(replace(CASES["near"], t_end=3.0), 0.1, 0)
    assert promised == size > broken > 0


def test_its_brake_finds_what_can_be_braked():
    """From v > 0 a mass stops after v² / 2, and half a control step later where the first input is held."""
    keeps = promises.brake(CASES["wall"])
    for v, room in ((1.0, 0.02), (2.0, 0.05), (1.0, -0.02), (2.0, -0.05), (-1.0, 0.1)):
        assert keeps(np.array([5.5 - max(v, 0.0) ** 2 / 2 - room, v])) == (room > 0)
