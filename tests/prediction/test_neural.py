"""A network as a predictor: the call of every predictor, any grid, and the same loop."""

import numpy as np
import pytest
from operator_samples import PLANT, SMALL, operator

from npred.base.errors import ConfigError
from npred.estimation.adaptation import DelayAdaptation
from npred.lab.training.neural import Neural
from npred.loop.closed_loop import simulate


@pytest.fixture(params=SMALL, ids=lambda config: type(config).__name__)
def neural(request):
    return Neural(PLANT, operator(request.param), 31)


def test_call_like_any_predictor(neural):
    random = np.random.default_rng(0)
    X, u, D_hat = (
        random.uniform(0.1, 2, (2, 3, 2)),
        random.uniform(0, 0.1, (2, 3, 31, 1)),
        random.uniform(0.5, 2, (2, 3)),
    )
    P = neural(X, u, D_hat)
    assert P.shape == (2, 3, 31, 2) and P.dtype == np.float64
    np.testing.assert_allclose(P[..., 0, :], X, rtol=1e-6)
    np.testing.assert_allclose(P[1, 2], neural(X[1, 2], u[1, 2], D_hat[1, 2]), rtol=1e-4, atol=1e-5)
    with pytest.raises(ConfigError, match="X: expected shape"):
        neural(X[..., :1], u, D_hat)


def test_any_grid(neural):
    """The same functions on two grids: P at common nodes agrees to the error of the quadratures."""
    coarse, fine = (np.linspace(0, 1, nx) for nx in (101, 201))
    P = [neural([0.5, 5.0], 0.05 * np.cos(3 * x)[:, None], 1.0) for x in (coarse, fine)]
    np.testing.assert_allclose(P[1][::2], P[0], rtol=1e-3, atol=1e-3)


def test_rests_at_rest_for_every_delay(neural):
    u = np.full((4, 31, 1), PLANT.u_equilibrium)
    P = neural(PLANT.equilibrium, u, np.array([0.2, 0.9, 1.7, 3.0]))
    np.testing.assert_allclose(P, np.broadcast_to(PLANT.equilibrium, P.shape), rtol=1e-6)


def test_lanes_write_what_the_call_returns(neural):
    random = np.random.default_rng(1)
    X, u, D_hat = random.uniform(0.1, 2, (2, 5)), random.uniform(0, 0.1, (31, 1, 5)), random.uniform(0.5, 2, 5)
    P = np.empty((31, 2, 5))
    neural.lanes()(X, u, D_hat, 0.0, PLANT.p, P)
    np.testing.assert_allclose(P.transpose(2, 0, 1), neural(X.T, u.transpose(2, 0, 1), D_hat), rtol=1e-6)


def test_closes_the_loop(neural):
    """The first input of the loop is kappa of the network's own prediction."""
    law = DelayAdaptation(1000.0, 1.0, (0.1, 4.0))
    loop = simulate(PLANT, neural, D=1.0, D_hat=2.0, X0=[0.03, 30.0], t_end=0.5, dt=0.01, adaptation=law)
    P = neural([0.03, 30.0], np.zeros((31, 1)), 2.0)
    np.testing.assert_allclose(loop.U[0], PLANT.kappa(P[-1]), rtol=1e-5)
    phi = law.phi(PLANT, [0.03, 30.0], np.zeros((31, 1)), P, 2.0)
    np.testing.assert_allclose(loop.D_hat[1], np.clip(2.0 + 0.01 * 1000 * phi, 0.1, 4.0), rtol=1e-6)
