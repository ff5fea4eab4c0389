"""The Baxter arm: the law's linear errors, its reference, and its loop from a law that held it before."""

import numpy as np
import plant_claims
import pytest

from npred import plants
from npred.diagnosis import equilibrium
from npred.loop import metrics
from npred.loop.closed_loop import simulate
from npred.prediction.methods import RK4
from npred_experiments import manipulator

FIVE = plants.resolve("baxter_arm5")
D = 0.5


@pytest.mark.parametrize("joints", [5, 7])
def test_the_law_makes_the_errors_linear(joints):
    plant, t = plants.resolve(f"baxter_arm{joints}"), np.linspace(0, 6, 7)
    X = plant_claims.box(plant, 7)
    e = X - plant.target(t)
    wave = -0.1 * np.sin(t)[:, None]
    accelerations = plant.f(X, plant.kappa(X, t))[:, joints:]
    np.testing.assert_allclose(accelerations - wave, -e[:, :joints] - 2 * e[:, joints:], atol=1e-10)
    assert equilibrium.slip(plant, 20.0)[0] < 1e-9


def test_law_and_plant_are_those_that_the_article_means():
    """The sum over links of traces, which shares the table alone."""
    arm = manipulator.right()
    X, t = plant_claims.box(FIVE, 10), 1.3
    np.testing.assert_allclose(FIVE.target(t), np.concatenate(manipulator.reference(t)[:2]), atol=1e-15)
    torques = arm.law(X, manipulator.reference(t))
    np.testing.assert_allclose(FIVE.kappa(X, t), torques, atol=1e-11)
    np.testing.assert_allclose(FIVE.f(X, torques), arm.rate(X, torques), atol=1e-10)


def test_its_pipeline_fits():
    fits = plant_claims.Claims()
    fits.plant = FIVE  # type: ignore[misc]
    fits.test_its_pipeline_fits()


@pytest.mark.slow
def test_it_tracks_from_its_box_with_the_predictor_and_only_with_it():
    """With it up to what torques that are held over a step, and read by lines between nodes, are off."""
    X0 = plant_claims.box(FIVE, 8)
    for D_hat, low, high in ((D, 0.0, 2e-2), (0.0, 1.0, np.inf)):
        loops = simulate(FIVE, RK4(FIVE, 26), D=D, D_hat=D_hat, X0=X0, t_end=20.0, dt=0.01, every=20, u0="law")
        radii = metrics.radius(loops, FIVE.target(loops.t))
        assert (radii >= low).all() and (radii <= high).all()
