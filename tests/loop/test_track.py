"""A cart with a pole on a short track: the limit of benchmarks/limits.py, its formulas and its loops."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import npred
from npred.plants import Plant
from npred.prediction.methods import RK4

HERE = Path(__file__).resolve().parent.parent
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
