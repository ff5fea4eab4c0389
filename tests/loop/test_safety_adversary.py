"""The safety filter's limits: the adversary of benchmarks/safety_adversary.py, and a cart with a pole on a track."""

import dataclasses
import importlib
import importlib.util
import sys

import numpy as np
import pytest
from conftest import HERE
from scipy.integrate import solve_ivp

import npred
from npred.plants import Plant
from npred.prediction.methods import RK4


@pytest.fixture(scope="module")
def adversary():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(HERE.parent / "benchmarks"))
        yield importlib.import_module("safety_adversary")


@pytest.fixture
def cases(adversary):
    return {case.plant.name: case for case in adversary.CASES}


def states(plant, rng):
    low, high = np.array([plant.box[name] for name in plant.states]).T
    return rng.uniform(low, high)


@pytest.mark.parametrize("name", ["cart", "arm", "tank", "aircraft", "pole", "clock"])
def test_its_plants_are_those_of_the_filters(adversary, cases, name):
    plant, system, rng, step = cases[name].plant, adversary.SYSTEMS[name], np.random.default_rng(0), 1e-6
    for _ in range(20):
        X, u = states(plant, rng), rng.uniform(*np.array(system.before).T)
        rate = plant.f(X, u)
        np.testing.assert_allclose(system.f(X, u), rate, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(system.h(X), plant.safe(X), rtol=1e-12, atol=1e-14)
        if system.rates is not None:
            moved = (plant.safe(X + step * rate) - plant.safe(X - step * rate)) / (2 * step)
            np.testing.assert_allclose(system.rates(X), moved, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("name", ["cart", "arm"])
def test_its_integration_is_that_of_the_loop(adversary, cases, name):
    case, system, rng = dataclasses.replace(cases[name], dt=0.005), adversary.SYSTEMS[name], np.random.default_rng(1)
    low, high = np.array(system.before).T
    X0, before = states(case.plant, rng), rng.uniform(low, high, (adversary.PIECES, case.plant.m))
    delay = case.D + case.dt
    loop = npred.simulate(
        case.plant, npred.predictor("rk4", case.plant, 31), D=delay, D_hat=case.D, X0=X0, t_end=1.0, dt=case.dt,
        u0=lambda t: adversary.past(case, before, t), actuator="history",
        safety=npred.SafetyFilter(case.alpha, delay=case.delay), progress=False,
    )  # fmt: skip
    X = adversary.replayed(case, system, X0, delay, before, loop.U)[::2]
    begun = round(delay / case.dt)
    np.testing.assert_allclose(X[: len(loop.X) - begun], loop.X[begun:], atol=1e-6)
    assert np.ptp(before, axis=0).min() > 0.1


def test_it_tells_a_filter_that_expects_the_error_of_the_delay(adversary, cases, monkeypatch):
    """From the same points a filter that takes D_hat for true breaks the limit, and one that does not keeps it."""
    case, points = dataclasses.replace(cases["cart"], delay=0.2), np.random.default_rng(0).uniform(size=(30, 7))

    def least():
        values = [adversary.score(case, adversary.SYSTEMS["cart"], z) for z in points]
        inside = [value for value, counts in values if counts]
        assert len(inside) > 20
        return min(inside)

    assert least() > 0
    monkeypatch.setattr(npred, "SafetyFilter", lambda alpha, delay, real=npred.SafetyFilter: real(alpha))
    assert least() < -0.1


SPEC = importlib.util.spec_from_file_location("limits", HERE.parent / "benchmarks" / "limits.py")
assert SPEC and SPEC.loader
limits = importlib.util.module_from_spec(SPEC)
sys.modules["limits"] = limits
SPEC.loader.exec_module(limits)
POLE = Plant("pole", limits.Pole)


@pytest.mark.parametrize("state", [[0.0, 0.1, 0.03, 0.1], [0.1, 0.6, 0.0, -0.1], [-0.2, -0.1, 0.08, 0.2]])
def test_the_farthest_point_is_the_least_of_what_pushes_and_braking_reach(state):
    """By the linearised plant in SciPy, over the time t1 for which the cart is pushed before it brakes."""
    mass, force, g, length = 0.1, 2.9, 9.81, 1.0

    def f(t, x, F):
        acceleration = F - mass * g * x[2]
        return [x[1], acceleration, x[3], (g * x[2] - acceleration) / length]

    def stops(t1):
        """Where the cart's centre of mass is at rest after t1 of +F and braking, and the unstable part of the pole."""
        x = solve_ivp(lambda t, x: f(t, x, force), (0, max(t1, 1e-9)), state, rtol=1e-10, atol=1e-12).y[:, -1]
        speed = x[1] + mass * length / 1.1 * x[3]
        if speed < 0:
            return -np.inf, np.inf
        braking = max(speed * 1.1 / force, 1e-9)
        x = solve_ivp(lambda t, x: f(t, x, -force), (0, braking), x, rtol=1e-10, atol=1e-12).y[:, -1]
        return x[0], x[2] + x[3] / np.sqrt(g * 1.1)

    low, high = 0.0, 1.5  # t1 that catches the pole: its unstable part falls with t1
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if stops(middle)[1] > 0 else (low, middle)
    farthest = stops(high)[0]
    assert high > 1e-6
    h = POLE.safe(np.array([state]))[0]
    assert np.log(1 - h[0]) * 0.1 + 0.6 == pytest.approx(farthest, abs=1e-5)


def test_loops_from_the_promised_set_stay_on_the_track_and_keep_the_pole():
    rng, (low, high) = np.random.default_rng(2), np.array([POLE.box[name] for name in POLE.states]).T
    named = {"D": 0.3, "D_hat": 0.3, "X0": rng.uniform(low, high, (400, 4)), "t_end": 6.0, "dt": 0.02, "u0": [0.0]}
    named |= {"actuator": "history", "progress": False}
    free = npred.simulate(POLE, RK4(POLE, 16), **named)
    loop = npred.simulate(POLE, RK4(POLE, 16), safety=npred.SafetyFilter(3.0), **named)
    inside = loop.safety[:, 15].min(axis=-1) >= 0
    assert inside.sum() > 200
    assert np.abs(free.X[inside, :, 0]).max() > 0.7
    assert np.abs(loop.X[inside, :, 0]).max() < 0.605 and np.abs(loop.X[inside, :, 2]).max() < 0.5
    assert np.linalg.norm(loop.X[inside, -1], axis=-1).max() < 0.1
