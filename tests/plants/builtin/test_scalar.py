"""The scalar unstable plant: its closed forms, and what every plant must show."""

import numpy as np
import plant_claims
from input_histories import means
from scipy.optimize import brentq

from npred import plants
from npred.loop.closed_loop import simulate
from npred.prediction.methods import RK4

PLANT = plants.resolve("scalar")


class TestClaims(plant_claims.Claims):
    plant, D, X0, t_end = PLANT, 1.2, (1.0,), 30.0


def test_the_prediction_is_the_closed_form():
    """u = sin(2 x): D_hat ∫₀¹ exp(a D_hat (1 - y)) sin(2 y) dy, a D_hat = r."""
    r = 0.5 * 1.2
    integral = (2 * np.exp(r) - r * np.sin(2) - 2 * np.cos(2)) / (r**2 + 4)
    P = RK4(PLANT, 201)(np.array([0.7]), means(lambda x: np.sin(2 * x)[..., None], 201), 1.2)
    np.testing.assert_allclose(P[-1], 0.7 * np.exp(r) + 1.2 * integral, rtol=1e-7)


def test_after_the_delay_the_loop_decays_at_the_rate_of_the_law():
    """X = exp(a D) X(0) exp(-c (t - D)), but for holding U over dt."""
    loop = simulate(PLANT, RK4(PLANT, 1001), D=1.0, D_hat=1.0, X0=[1.0], t_end=5.0, dt=0.001)
    np.testing.assert_allclose(loop.X[1000:, 0], np.exp(0.5 - (loop.t[1000:] - 1.0)), rtol=0, atol=1e-3)


def test_without_a_predictor_it_bears_the_delay_of_the_characteristic_equation():
    """s = a - (a + c) exp(-s D) crosses s = i w where w² = (a + c)² - a²: D = arccos(a / (a + c)) / w, 0.87 s."""
    w = brentq(lambda w: w**2 - (1.5**2 - 0.5**2), 0.1, 2.0)
    limit = np.arccos(0.5 / 1.5) / w
    delays, free = [0.95 * limit, 1.05 * limit], [(-1e9, 1e9)]  # linear, so without the clip of free inputs
    loops = simulate(PLANT, RK4(PLANT, 51), D=delays, D_hat=0.0, X0=[1.0], t_end=100.0, input_bounds=free)
    first, last = (
        np.abs(loops.X[:, some, 0]).max(axis=1) for some in ((loops.t >= 20) & (loops.t <= 40), loops.t >= 80)
    )
    assert last[0] < 0.5 * first[0] and last[1] > 2 * first[1]
