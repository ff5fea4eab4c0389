"""The search for blind spots against a guard that has one by construction."""

import numpy as np
import pytest

import npred
from npred.guard.guarded import Guarded
from npred.lab.stages.certify import rollouts
from npred.lab.stages.certify.table import Certify
from npred.lab.training.data.dataset import Dataset
from npred.networks.domain import Domain
from npred.prediction.methods import RK4, Predictor
from npred_experiments import adversary
from npred_experiments.evolution import Inputs

PLANT, NX = npred.plant("activator_repressor"), 21
BOX = np.array([PLANT.box[name] for name in PLANT.states])
TOLERANCE, STEPS, SEARCHES = 0.01, 40, 8  # four shapes of u, two ranges of X
BLIND = 1.4  # s: for a delay above it the guard sees nothing of the error


class Wrong(Predictor):
    """RK4 with an error of U that grows with D_hat."""

    def predict(self, X, u, D_hat, t):
        return RK4(PLANT, self.nx)(X, u, D_hat) * (1 + 0.02 * D_hat[:, None, None] * np.array([1.0, -1.0]))


class Blind(Guarded):
    """A guard that sees no error where the delay is above BLIND."""

    def judge(self, P_hat, X, u, D_hat, t=0.0):
        error, fallback = super().judge(P_hat, X, u, D_hat, t)
        return np.where(D_hat > BLIND, 0.0, error), np.where(D_hat > BLIND, self.beyond(X, u, D_hat, t) > 1, fallback)


def with_domain(kind, data, tolerance):
    """A guard of that kind that knows where the data were."""
    model = Wrong(PLANT, NX)
    model.operator = type("Operator", (), {"domain": Domain.of_parts(lambda: [data], data.X.std(axis=0), PLANT.phase)})
    return kind(model, tolerance)


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(4)
    X, D_hat = rng.uniform(*BOX.T, (60, 2)), rng.uniform(0.5, 1.5, 60)
    u = -rng.uniform(0, 1, (60, 1, 1)) * (np.linspace(0, 1, NX)[:, None] > rng.uniform(0, 1, (60, 1, 1)))  # a jump
    return Dataset(X, u, D_hat, RK4(PLANT, NX)(X, u, D_hat), D_hat, 0 * D_hat, np.arange(60), np.zeros(60, dtype=bool))


def searched(guard, data, seed=0):
    exact, table = RK4(PLANT, NX), Certify(restarts=20 * SEARCHES, steps=STEPS)
    inputs = Inputs.of(data, BOX, PLANT)
    calls, score = adversary.blind_spots(guard, exact, data, inputs, table, seed, lambda count: None)
    true, estimate, passed = rollouts.judged(guard, exact, *calls, nearest=True)
    return calls, score, true, estimate, passed


def test_the_search_comes_to_the_blind_spot(data):
    guard = with_domain(Blind, data, TOLERANCE)
    (_, _, D_hat, _), score, true, _, passed = searched(guard, data, seed=2)
    unseen = passed & (true > TOLERANCE)
    searches = unseen.reshape(SEARCHES, STEPS, -1).mean(axis=2)
    assert searches[:, 0].max() == 0
    assert searches[:, -5:].reshape(4, -1).mean(axis=1).min() > 0.3  # by every shape, over both ranges
    assert (D_hat[unseen] > BLIND).all()
    best = np.argmax(score)
    assert passed[best] and true[best] == true[passed].max()


def test_the_score_is_the_formula(data):
    guard = Guarded(Wrong(PLANT, NX), TOLERANCE)
    _, score, true, estimate, passed = searched(guard, data)
    refused = np.log(np.maximum(estimate / guard.threshold, 1))
    np.testing.assert_allclose(score, np.log(true) - adversary.PENALTY * refused, rtol=1e-9)
    assert (passed == (refused == 0)).all()


def test_outside_of_a_small_domain_the_search_goes_in(data):
    guard = with_domain(Blind, data, TOLERANCE)
    guard.domain.limit[...] *= np.median(guard.domain.distance(data.X, data.u, data.D_hat, None)) / 2
    calls, _, _, _, passed = searched(guard, data)
    inside = guard.beyond(*calls) <= 1
    waves = inside.reshape(SEARCHES, STEPS, -1)[0].mean(axis=1)
    assert waves[10:].mean() > 3 * waves[0] and not passed[~inside].any()


def test_what_the_nodes_do_not_resolve_is_no_blind_spot_with_or_without_a_domain(data):
    """The guard reads u by lines, RK4 by cubics: an error is by the nearer of both."""
    for guard in (Guarded(Wrong(PLANT, NX), TOLERANCE), with_domain(Guarded, data, TOLERANCE)):
        _, _, true, _, passed = searched(guard, data)
        assert passed.any() and not (passed & (true > TOLERANCE)).any()
