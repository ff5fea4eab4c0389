"""The adversary of the safety filter, benchmarks/safety_adversary.py."""

import dataclasses

import numpy as np
import pytest
import safety_adversary as adversary

import npred


@pytest.fixture
def cases():
    return adversary.cases()


def states(plant, rng):
    low, high = np.array([plant.box[name] for name in plant.states]).T
    return rng.uniform(low, high)


@pytest.mark.parametrize("name", ["cart", "arm", "tank", "aircraft", "pole", "clock", "pendulum", "cubic"])
def test_its_plants_are_those_of_the_filters(cases, name):
    plant, system, rng = cases[name].plant, adversary.SYSTEMS[name], np.random.default_rng(0)
    for _ in range(20):
        X, u = states(plant, rng), rng.uniform(*np.array(system.before).T)
        np.testing.assert_allclose(system.f(X, u), plant.f(X, u), rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(system.h(X), plant.safe(X), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("name", ["cart", "arm"])
def test_its_integration_is_that_of_the_loop(cases, name):
    case, system, rng = dataclasses.replace(cases[name], dt=0.0025), adversary.SYSTEMS[name], np.random.default_rng(1)
    low, high = np.array(system.before).T
    X0, before = states(case.plant, rng), rng.uniform(low, high, (adversary.PIECES, case.plant.m))
    delay = case.D + case.dt
    loop = npred.simulate(
        case.plant, npred.predictor(case.plant, "rk4", 31), D=delay, D_hat=case.D, X0=X0, t_end=1.0, dt=case.dt,
        u0=lambda t: adversary.past(case, before, t), actuator="history",
        safety=npred.SafetyFilter(delay=case.delay), progress=False,
    )  # fmt: skip
    X = adversary.replayed(case, system, X0, delay, before, loop.U)[::2]
    begun = round(delay / case.dt)
    np.testing.assert_allclose(X[: len(loop.X) - begun], loop.X[begun:], atol=1e-3)  # hard braking, by RK4
    assert np.ptp(before, axis=0).min() > 0.1


def test_it_tells_a_filter_that_expects_the_error_of_the_delay(cases, monkeypatch):
    """From the same points a filter that takes D_hat for true breaks the limit, and one that does not keeps it."""
    case, points = dataclasses.replace(cases["cart"], delay=0.2), np.random.default_rng(0).uniform(size=(30, 7))

    def least():
        values = [adversary.score(case, adversary.SYSTEMS["cart"], z) for z in points]
        inside = [value for value, counts in values if counts]
        assert len(inside) > 20
        return min(inside)

    assert least() > 0
    monkeypatch.setattr(npred, "SafetyFilter", lambda delay, real=npred.SafetyFilter: real())
    assert least() < -0.1
