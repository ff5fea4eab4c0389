"""Functions of costly plants, compiled on their own and called by the kernels."""

import numpy as np
import pytest

from npred import plants
from npred.estimation.adaptation import DelayAdaptation
from npred.formulas import called_functions
from npred.loop.closed_loop import simulate
from npred.plants.base import Plant
from npred.plants.builtin.planar_arm import arm
from npred.prediction import methods as predictors


def test_functions_are_called_where_they_are_long():
    assert called_functions.called(plants.resolve("planar_arm5")) == ("f", "kappa")
    assert (
        called_functions.called(plants.resolve("planar_arm2"))
        == called_functions.called(plants.resolve("cart_pole"))
        == ()
    )


@pytest.mark.parametrize("method", ["rk4", "picard"])
def test_kernels_that_call_f_are_those_that_hold_it(method, monkeypatch):
    """The update law, the loop and the predictor, once with f written out and once with it called."""
    runs = []
    for length in (10, 10**6):
        monkeypatch.setattr(called_functions, "LONG", length)
        plant = Plant("chain", arm(2))
        loop = simulate(plant, predictors.numerical(method, plant, 11), D=0.2, D_hat=0.3, X0=plant.target(0.0) + 0.1,
                        t_end=1.0, dt=0.01, adaptation=DelayAdaptation(gamma=1.0, bounds=(0.1, 0.3)))  # fmt: skip
        runs.append(np.concatenate([loop.X, loop.U, loop.D_hat[:, None]], axis=1))
    np.testing.assert_allclose(runs[0], runs[1], rtol=1e-10, atol=1e-12)
    assert np.ptp(runs[0][:, -1]) > 1e-3
