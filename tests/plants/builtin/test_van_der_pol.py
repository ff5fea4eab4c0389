"""Van der Pol's oscillator: its cycle without control, its law's poles, V, and what every plant must show."""

import numpy as np
import plant_claims
import pytest
from scipy.linalg import solve_continuous_lyapunov
from scipy.signal import place_poles

from npred import plants
from npred.loop.closed_loop import simulate

PLANT = plants.resolve("van_der_pol")


class TestClaims(plant_claims.Claims):
    plant, D, X0, t_end = PLANT, 1.0, (1.5, -1.0), 20.0


def test_without_control_it_ends_on_the_cycle_of_the_literature():
    """For mu = 1 the amplitude is 2.00862 and the period 6.66329 (Andersen, Geer, SIAM J. Appl. Math. 42, 1982)."""
    loop = simulate(PLANT, None, D=1.0, D_hat=0.0, X0=[0.1, 0.0], t_end=60.0, dt=0.005)
    t, x = loop.t[6000:], loop.X[6000:, 0]
    up = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    crossings = t[up] - x[up] * 0.005 / (x[up + 1] - x[up])
    assert np.diff(crossings).mean() == pytest.approx(6.66329, abs=1e-4)
    assert x.max() == pytest.approx(2.00862, abs=1e-4)


def test_the_gains_and_the_poles_are_those_of_the_docstring():
    gains = place_poles(np.array([[0, 1], [0, -1]]), np.array([[0], [1]]), [-2, -3]).gain_matrix
    np.testing.assert_allclose(PLANT.kappa_jacobian(np.zeros(2)), -gains, atol=1e-12)
    f_X, f_U = PLANT.jacobians(np.zeros(2), np.zeros(1))
    assert np.linalg.eigvals(f_X).real.max() == pytest.approx(0.5)
    loop = f_X - f_U @ gains
    np.testing.assert_allclose(np.linalg.eigvals(loop).real, -1.5)
    S = solve_continuous_lyapunov(loop.T, -np.eye(2))
    X = plant_claims.box(PLANT, 50)
    np.testing.assert_allclose(PLANT.V(X), np.einsum("bi,ij,bj->b", X, S, X), rtol=1e-12)


def test_V_falls_along_the_law_as_far_as_it_says():
    X = np.random.default_rng(0).uniform([-8.5, -100], [8.5, 100], (20000, 2))
    velocity, h = PLANT.f(X, PLANT.kappa(X)), 1e-7
    slope = (PLANT.V(X + h * velocity) - PLANT.V(X - h * velocity)) / (2 * h)
    assert (slope < 0).all()
