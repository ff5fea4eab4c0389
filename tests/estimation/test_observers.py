"""What every observer of the state promises: it stays at the truth, and knows no units."""

import numpy as np
import pytest
from observed import Tide, correct, follow, plant_of, swing_in
from scipy.integrate import solve_ivp

from npred.estimation.observers import EKF, Luenberger

KINDS = pytest.mark.parametrize("kind", [EKF, Luenberger])


@KINDS
def test_from_the_truth_it_stays_there(kind):
    """Of a plant and an output that depend on time, with an input that switches within the steps."""
    plant, h, every = plant_of(Tide), 0.05, 6
    observer = kind(plant, X0=[0.4, -0.3])
    memory, X, worst = observer.start(), np.array([0.4, -0.3]), 0.0
    for k in range(60):
        t = 0.7 + k * h
        if k % every == 0:
            correct(observer, memory, plant.output(X, t), t)
        follow(observer, memory, 1.0, h, t, after=-0.5, share=0.4)
        for begin, end, U in ((t, t + 0.4 * h, 1.0), (t + 0.4 * h, t + h, -0.5)):
            f = lambda s, x, U=U: plant.f(x, np.array([U]), s)
            X = solve_ivp(f, (begin, end), X, rtol=1e-10, atol=1e-12).y[:, -1]
        worst = max(worst, np.abs(memory[:2] - X).max())
    assert worst < 1e-5


@KINDS
def test_its_defaults_do_not_depend_on_units(kind):
    """A pendulum in picoseconds, milliradians and other units: the same estimates, and the same offset."""
    found = []
    for units in ({}, {"time": 1e12, "angle": 1e3, "rate": 7.0, "input": 0.01, "outputs": (50.0, 0.02)}):
        of = {"time": 1.0, "angle": 1.0, "rate": 1.0, "input": 1.0, "outputs": (1.0, 1.0)} | units
        observer = kind(swing_in(**units), offset=True)
        memory, rng = observer.start(), np.random.default_rng(0)
        sizes = np.array([of["angle"], of["rate"], of["input"]])
        for _ in range(12):
            correct(observer, memory, rng.uniform(-0.5, 0.5, 2) * of["outputs"])
            follow(observer, memory, rng.uniform(-1, 1) * of["input"], 0.05 * of["time"])
            found.append(memory[:3] / sizes)
    np.testing.assert_allclose(found[12:], found[:12], rtol=1e-6, atol=1e-8)
    assert np.ptp(found, axis=0).min() > 0.01
