"""The unicycle of IEEE TAC 62 (2017): first commands, and how far a held law leaves its prediction from the state."""

import numpy as np
import plant_claims
import pytest

import npred
from npred import plants

PLANT = plants.resolve("slow_unicycle")
D, EARLY, START = 1.0, 0.5, (0.5, 0.5, 0.5)


def test_the_law_is_that_of_the_article():
    for X, t in zip(plant_claims.box(PLANT, 20), np.linspace(0, 7, 20), strict=True):
        x, y, theta = X
        p, q = x * np.cos(theta) + y * np.sin(theta), x * np.sin(theta) - y * np.cos(theta)
        omega = -(p**2) * np.cos(t) - p * q * (1 + np.cos(t) ** 2) - theta
        v = -p + q * (np.sin(t) - np.cos(t)) + q * omega
        np.testing.assert_allclose(PLANT.kappa(X, t), [omega, v], rtol=1e-13)
        np.testing.assert_allclose(PLANT.kappa(X, t + PLANT.period), [omega, v], rtol=1e-9)


def test_its_pipeline_fits():
    fits = plant_claims.Claims()
    fits.plant = PLANT  # type: ignore[misc]
    fits.test_its_pipeline_fits()


def test_derivatives_equal_differences():
    plant_claims.derivatives_equal_differences(PLANT)


@pytest.mark.parametrize(("dt", "expected"), [(0.04, 0.00541761), (0.02, 0.00271765)])
def test_predictions_are_as_far_from_the_state_as_a_public_reimplementation_prints(dt, expected):
    """The largest |P2(t) - X(t + D_2)| up to 100 s: P takes the law between its samples, the robot holds it."""
    loop = npred.simulate(PLANT, npred.predictor(PLANT, "rk4", nx=201), D=D, D_hat=D, X0=START, t_end=100.0, dt=dt)
    ahead = round(D / dt)
    assert np.abs(loop.P[:-ahead] - loop.X[ahead:]).max() == pytest.approx(expected, abs=6e-9)
    np.testing.assert_allclose(loop.U[0], [-0.664906519, -0.645494470], atol=6e-10)


def test_the_plant_in_the_loop_is_that_of_an_independent_solver():
    loop = npred.simulate(PLANT, npred.predictor(PLANT, "rk4", nx=51), D=D, D_hat=D, X0=START, t_end=5.0, dt=0.02)
    np.testing.assert_allclose(loop.X, plant_claims.replayed(PLANT, loop, (EARLY, D)), rtol=0, atol=1e-7)
