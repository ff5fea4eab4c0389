"""A network as a predictor, and calls of one sample: any grid, the numbers of a batch, every failure as in a batch."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from operator_samples import PLANT, SMALL, operator

import npred
from npred.base.errors import ConfigError
from npred.estimation.adaptation import DelayAdaptation
from npred.lab.training.neural import Neural
from npred.loop.closed_loop import simulate
from npred.prediction.methods import RK4


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


UNICYCLE, NX = npred.plant("unicycle"), 21
RNG = np.random.default_rng(0)
X, U = RNG.uniform(-1, 1, (8, 3)), RNG.uniform(-0.2, 0.2, (8, NX, 2))
D_HAT, T = RNG.uniform(0.1, 0.5, 8), RNG.uniform(0, 3, 8)


def guarded():
    return npred.guarded(npred.predictor(npred.plant("van_der_pol"), "heun", nx=NX), tolerance=1e-4)


def test_one_sample_gets_what_it_gets_in_a_batch():
    predictor = RK4(UNICYCLE, NX)
    batch = predictor(X, U, D_HAT, T)
    single = [predictor(x, u, d, float(t)) for x, u, d, t in zip(X, U, D_HAT, T, strict=True)]
    np.testing.assert_array_equal(single, batch)
    np.testing.assert_array_equal(predictor(X[0].tolist(), U[0], D_HAT[0], T[0]), batch[0])


def test_a_guard_answers_alike():
    predictor, x, u = guarded(), 2 * X[:, :2], 3 * U[..., :1]
    batch = predictor(x, u, D_HAT)
    np.testing.assert_array_equal([predictor(*row) for row in zip(x, u, D_HAT, strict=True)], batch)
    assert {bool(b) for b in predictor.fallback(x, u, D_HAT)} == {True, False}


def test_an_answer_stays_what_it_was():
    predictor = RK4(UNICYCLE, NX)
    first = predictor(X[0], U[0], 0.3)
    kept = first.copy()
    predictor(X[1], U[1], 0.4)
    np.testing.assert_array_equal(first, kept)


@pytest.mark.parametrize("d", [0.3, np.float64(0.3), np.array(0.3)])
def test_a_delay_may_be_any_number(d):
    predictor = RK4(UNICYCLE, NX)
    np.testing.assert_array_equal(predictor(X[0], U[0], d), predictor(X[:1], U[:1], [0.3])[0])


def test_u_of_one_input_may_be_flat_and_on_other_nodes():
    predictor = npred.predictor(npred.plant("scalar"), "rk4", nx=NX)
    for nx in (5, NX):
        u = np.linspace(0, 1, nx)
        np.testing.assert_array_equal(predictor(np.ones(1), u, 0.3), predictor(np.ones(1), u[:, None], 0.3))


@pytest.mark.parametrize("make", [lambda: RK4(UNICYCLE, NX), guarded])
def test_what_is_wrong_is_refused_as_in_a_batch(make):
    predictor = make()
    n, m = predictor.plant.n, predictor.plant.m
    x, u = np.ones(n), np.zeros((NX, m))
    for bad, words in (
        ((np.full(n, np.nan), u, 0.3), "X: expected finite numbers"),
        ((x, np.full((NX, m), np.inf), 0.3), "u: expected finite numbers"),
        ((x, u, -0.1), "D_hat: expected a delay of at least 0"),
        ((x, u, np.nan), "D_hat: expected a delay"),
        ((np.ones(n + 1), u, 0.3), "X: expected shape"),
        ((x, np.zeros((NX, m + 1)), 0.3), "u: expected shape"),
    ):
        predictor(x, u, 0.3)
        with pytest.raises(ConfigError, match=words):
            predictor(*bad)


def test_threads_have_memory_apart():
    predictor = RK4(UNICYCLE, NX)
    rows = [(X[k % 8], U[k % 8], float(D_HAT[k % 8])) for k in range(400)]
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda row: predictor(*row), rows))
    np.testing.assert_array_equal(answers, [predictor(*row) for row in rows])


def test_a_predictor_that_was_called_can_be_pickled():
    predictor = RK4(npred.plant("scalar"), NX)
    before = predictor(np.ones(1), np.zeros(NX), 0.3)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(predictor))(np.ones(1), np.zeros(NX), 0.3), before)


def test_a_predictor_of_ones_own_is_asked_itself():
    class Twice(RK4):
        def predict(self, X, u, D_hat, t):
            return 2 * super().predict(X, u, D_hat, t)

    np.testing.assert_array_equal(Twice(UNICYCLE, NX)(X[0], U[0], 0.3), 2 * RK4(UNICYCLE, NX)(X[0], U[0], 0.3))
