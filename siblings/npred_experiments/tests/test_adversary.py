"""The adversary against numerics, and what it adds to the certificate of a tiny pipeline."""

from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from driven import driven
from fake_gpu import FakeGpu
from jobs import PLANT as NAME
from jobs import job, trained
from operator_samples import SMALL

import npred
from npred.guard.guarded import Guarded
from npred.lab.config.results import Certified, PredictorId
from npred.lab.stages.certify import certify, rollouts
from npred.lab.stages.certify.table import Certify
from npred.lab.training import operators
from npred.lab.training.data.dataset import Dataset
from npred.lab.training.neural import Neural
from npred.loop import metrics
from npred.prediction.methods import RK4, Predictor
from npred_experiments import adversary, certificates
from npred_experiments.evolution import Inputs

PLANT = npred.plant(NAME)
TABLE = {"probability": 0.2, "confidence": 0.9, "samples": 6, "restarts": 8, "steps": 6, "loops": 5}


@pytest.fixture(scope="module")
def certified(tmp_path_factory):
    root = tmp_path_factory.mktemp("certify")
    inputs = trained(root)
    tasks = [job(root, name, inputs=inputs, jobs=jobs, certify=TABLE) for name, jobs in (("one", 1), ("two", 2))]
    return tasks, [certify.run(task).json_object() for task in tasks], Dataset.read(inputs["generate"] / "data.h5")


def test_a_certificate_says_what_the_searches_found(certified):
    _, (result, _), _ = certified
    for row in result["models"].values():
        assert row["calls"] == 48
        assert 0 <= row["unnoticed"] <= row["above"] <= row["calls"]
        assert 0 <= row["bounded"] <= 1 and (not row["bound"] or 1 - 1e-6 <= row["bound"][0] <= row["bound"][2])
    assert "adversary" in certify.summary(Certified.of(result, "a test"))


def test_the_same_twice_with_searches(certified):
    (one, two), (first, second), _ = certified
    assert first == second
    assert (one.folder / "worst.h5").read_bytes() == (two.folder / "worst.h5").read_bytes()


class Wrong(Predictor):
    """RK4 with an error that grows with the distance of u from zero."""

    def predict(self, X, u, D_hat, t):
        P = RK4(PLANT, self.nx)(X, u, D_hat)
        return P * (1 + 0.1 * np.abs(u).max(axis=(1, 2))[:, None, None] * np.array([1.0, -1.0]))


def searched(data, steps, seed=0):
    table = Certify(restarts=16, steps=steps)
    inputs = Inputs.of(data, np.array([PLANT.box[name] for name in PLANT.states]))
    (X, u, D_hat, _), error = adversary.search(PLANT, Wrong(PLANT, 21), data, inputs, table, seed, lambda n: None)
    return inputs, X, u, D_hat, error


def test_evolution_finds_larger_errors_than_the_starts_had_and_stays_inside(certified):
    inputs, X, u, D_hat, error = searched(certified[2], 40)
    by_step = error.reshape(40, 16)
    assert by_step.max() > 1.5 * by_step[0].max()
    for values, name in ((X, "X"), (u, "u"), (D_hat, "D_hat")):
        low, high = getattr(inputs, name)
        assert ((values >= low - 1e-12) & (values <= high + 1e-12)).all()
    exact, wrong = RK4(PLANT, 21), Wrong(PLANT, 21)
    U, U_exact = (metrics.law(PLANT, p(X, u, D_hat), 0.0, D_hat) for p in (wrong, exact))
    np.testing.assert_allclose(error, np.abs(U - U_exact).max(axis=1))


@pytest.mark.parametrize("name", ["transport_tank", "unicycle_time_delay"])
def test_calls_have_the_delay_that_the_plant_declares_at_their_states_and_times(name):
    plant, rng, t = npred.plant(name), np.random.default_rng(2), np.linspace(0.0, 8.0, 30)
    box = np.array([plant.box[state] for state in plant.states])
    X = rng.uniform(*box.T, (30, plant.n))
    u, D, exact = np.repeat(plant.kappa(X, t)[:, None], 21, axis=1), plant.delay(X, t), RK4(plant, 21)
    data = Dataset(X, u, D, exact(X, u, D, t), D, t, np.arange(30), np.zeros(30, dtype=bool))
    coarse, table = npred.predictor(plant, "euler", 21), Certify(restarts=8, steps=6)
    calls, error = adversary.search(plant, coarse, data, Inputs.of(data, box, plant), table, 0, lambda count: None)
    X, _, D, t = calls
    np.testing.assert_allclose(D, [plant.delay(*row) for row in zip(X, t, strict=True)], rtol=1e-12)
    assert np.ptp(t) > 2 if plant.clocked else (t == 0).all()
    np.testing.assert_allclose(rollouts.judged(Guarded(coarse, exact=exact), exact, *calls)[0], error, rtol=1e-9)


def test_the_gradient_climbs_through_a_network(certified):
    (task, _), _, data = certified
    from npred.lab.stages.evaluate.evaluate import load_network

    network = load_network(task, PredictorId("deeponet"))
    inputs = Inputs.of(data, np.array([PLANT.box[name] for name in PLANT.states]))
    table = Certify(restarts=12, steps=40)
    calls, error = adversary.search(PLANT, network, data, inputs, table, 0, lambda n: None)
    by_step = error.reshape(40, 12)
    assert np.median(by_step[-1]) > 2 * np.median(by_step[0])
    true, _, _ = rollouts.judged(Guarded(network, exact=RK4(PLANT, 21)), RK4(PLANT, 21), *calls)
    np.testing.assert_allclose(error, true, rtol=0.2, atol=2e-3)  # torch's P(1) is that of the kernels, u read linearly


def test_the_gradient_climbs_through_a_network_on_a_gpu():
    rng = np.random.default_rng(3)
    data = Dataset(
        rng.uniform(size=(8, 2)), rng.normal(size=(8, 21, 1)), *(np.full(s, 0.5) for s in (8, (8, 21, 2), 8, 8)),
        np.arange(8), np.zeros(8, dtype=bool),
    )  # fmt: skip
    inputs, table = Inputs.of(data, np.array([PLANT.box[name] for name in PLANT.states])), Certify(restarts=4, steps=2)
    operator = operators.build(SMALL[0], PLANT, operators.Scaling(2, 1)).requires_grad_(False)
    here = adversary.search(PLANT, Neural(PLANT, operator, 21), data, inputs, table, 0, lambda n: None)[1]
    with FakeGpu():
        network = Neural(PLANT, operator, 21, "cuda")
        there = adversary.search(PLANT, network, data, inputs, table, 0, lambda n: None)[1]
    np.testing.assert_array_equal(there, here)


def test_a_network_that_sees_the_phase_is_asked_at_the_times_of_the_calls():
    plant, rng, t = driven(period=np.pi), np.random.default_rng(3), np.linspace(0.0, 3.0, 30)
    X, u, D = rng.uniform(size=(30, 1)), rng.normal(size=(30, 21, 1)), rng.uniform(0.4, 0.8, 30)
    data = Dataset(X, u, D, RK4(plant, 21)(X, u, D, t), D, t, np.arange(30), np.zeros(30, dtype=bool))
    network = Neural(
        plant, operators.build(SMALL[0].model_copy(update={"anchor": "initial"}), plant, operators.Scaling(1, 1)), 21
    )
    inputs, table = Inputs.of(data, np.array([[0.0, 1.0]]), plant), Certify(restarts=8, steps=6)
    calls, error = adversary.search(plant, network, data, inputs, table, 0, lambda count: None)
    assert np.ptp(calls[3]) > 0.5
    exact = RK4(plant, 21)
    np.testing.assert_allclose(rollouts.judged(Guarded(network, exact=exact), exact, *calls)[0], error, rtol=1e-9)


def test_judged_calls_pass_where_the_tolerance_is_wide_and_none_does_where_it_is_narrow(certified):
    _, X, u, D_hat, _ = searched(certified[2], 3)
    exact, wrong = RK4(PLANT, 21), Wrong(PLANT, 21)
    assert rollouts.judged(Guarded(wrong, 1e9), exact, X, u, D_hat)[2].all()
    assert not rollouts.judged(Guarded(wrong, 1e-12), exact, X, u, D_hat)[2].any()


CALLS = (np.zeros((6, 1)), np.zeros((6, 3, 1)), np.zeros(6), np.zeros(6))
TRUE = np.array([0.1, 0.4, 0.8, 1.5, 2.0, 5.0])  # errors of known calls, for a tolerance of 1
ESTIMATES = TRUE * [9.0, 1.0, 2.0, 1.5, 3.0, 9.0]
PASSED = np.array([True, True, False, True, False, False])
GUARD = SimpleNamespace(tolerance=1.0, plant=PLANT, name="guarded", model=lambda *calls: None)
BOUNDS = np.array([2.0, np.inf, 6.0])


def test_what_a_guard_lets_pass_is_counted_by_call(tmp_path, monkeypatch):
    monkeypatch.setattr(rollouts, "judged", lambda *calls, **_: (TRUE, ESTIMATES, PASSED))
    fields = certificates.judged(GUARD, None, CALLS)
    assert (fields["calls"], fields["above"], fields["unnoticed"]) == (6, 3, 1)
    assert (fields["adversarial"], fields["adversarial_median"]) == (5.0, pytest.approx(1.15))
    assert fields["ratio"][1] == pytest.approx(1.75)  # of 1, 1.5, 2 and 3, those of errors from 0.3 to 3
    monkeypatch.setattr(adversary, "blind_spots", lambda *arguments: (CALLS, None))
    monkeypatch.setattr(certificates.Inputs, "of", lambda *arguments: None)
    blind = certificates.blind_spots(job(tmp_path, "certify"), None, GUARD, None)
    assert blind == {"blind_calls": 6, "blind": 1, "blind_error": 1.5}


def test_bounds_of_known_errors(monkeypatch):
    fresh = rollouts.Rollouts(np.array([1.0, 9.0, 2.0]), CALLS, 0.25)
    monkeypatch.setattr(certificates.ErrorBound, "of", lambda guard: lambda *calls: BOUNDS)
    fields = certificates.bounded(GUARD, fresh)
    assert fields["bounded"] == pytest.approx(2 / 3) and fields["bound"][1] == pytest.approx(2.5)  # of 2 / 1 and 6 / 2


def test_the_worst_calls_are_kept_the_worst_first(tmp_path):
    X = np.arange(6.0)[:, None]
    calls = {PredictorId("fno"): ((X, *CALLS[1:]), np.array([1, 5, 2, np.nan, 4, 3.0]))}
    certificates.write_worst(tmp_path / "worst.h5", calls)
    with h5py.File(tmp_path / "worst.h5") as file:
        assert file["fno/X"][:5, 0].tolist() == [1, 4, 5, 2, 0] and file["fno/error"][0] == 5.0
