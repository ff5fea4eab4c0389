"""The certify stage: the statistics by simulation, the adversary against numerics, the result of a tiny pipeline."""

from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from driven import driven
from fake_gpu import FakeGpu
from jobs import PLANT as NAME
from jobs import job, trained
from known_loops import NEVER, known_loops
from operator_samples import SMALL

import npred
from npred import operators
from npred.data.dataset import Dataset
from npred.loop import metrics
from npred.predictors import RK4, Predictor
from npred.predictors.guarded import Guarded
from npred.predictors.neural import Neural
from npred.results import PredictorId
from npred.stages.certify import adversary, certify, rollouts
from npred.stages.certify.evolution import Inputs
from npred.stages.certify.table import Certify
from npred.stages.generate import generate

PLANT = npred.plant(NAME)
TABLE = {"probability": 0.2, "confidence": 0.9, "samples": 6, "restarts": 8, "steps": 6, "loops": 5}


@pytest.mark.parametrize(
    ("probability", "confidence", "expected"), [(1e-3, 1 - 1e-6, 13809), (1e-3, 0.99, 4603), (0.5, 0.5, 1)]
)
def test_number_of_rollouts(probability, confidence, expected):
    assert rollouts.count(probability, confidence) == expected


@pytest.mark.parametrize(("probability", "confidence"), [(0.1, 0.9), (0.05, 0.95), (0.3, 0.8)])
def test_the_largest_of_N_bounds_as_often_as_stated(probability, confidence):
    """Errors with a heavy tail: a repeat holds where a share of at most `probability` is above its largest one."""
    rng, number = np.random.default_rng(7), rollouts.count(probability, confidence)
    largest = rng.pareto(1.5, (20_000, number)).max(axis=1)
    above = (1 + largest) ** -1.5
    held = (above <= probability).mean()
    assert held >= confidence - 3 * np.sqrt(confidence * (1 - confidence) / 20_000)
    assert held < confidence + (1 - confidence) / 2 + 0.02  # no more rollouts than are needed


@pytest.fixture(scope="module")
def certified(tmp_path_factory):
    root = tmp_path_factory.mktemp("certify")
    inputs = trained(root)
    tasks = [job(root, name, inputs=inputs, jobs=jobs, certify=TABLE) for name, jobs in (("one", 1), ("two", 2))]
    return tasks, [certify.run(task).json_object() for task in tasks], Dataset.read(inputs["generate"] / "data.h5")


def test_a_certificate_of_each_network(certified):
    _, (result, _), _ = certified
    assert set(result["models"]) == {"deeponet", "fno"} and result["loops"] == 5
    for row in result["models"].values():
        assert row["rollouts"] == rollouts.count(0.2, 0.9) and row["calls"] == 48
        assert 0 < row["median"] <= row["eps_kappa"]
        assert 0 <= row["unnoticed"] <= row["above"] <= row["calls"]
        assert 0 <= row["bounded"] <= 1 and (not row["bound"] or 1 - 1e-6 <= row["bound"][0] <= row["bound"][2])
        assert 0 <= row["lost_guarded"] <= 5 and 0 <= row["fallback"] <= 1


def test_the_same_twice(certified):
    (one, two), (first, second), _ = certified
    assert first == second
    for name in ("errors.h5", "worst.h5"):
        assert (one.folder / name).read_bytes() == (two.folder / name).read_bytes()


def test_the_rollouts_are_none_that_were_trained_on(certified):
    (task, _), (result, _), data = certified
    pipeline = rollouts.fresh(task.config, Certify(**TABLE), 4)
    rows = dict(generate.batches(task, pipeline))[0]
    assert not np.isin(rows["X"][:, 0], data.X[:, 0]).any()
    with h5py.File(task.folder / "errors.h5") as file:
        assert max(file["fno"]) == result["models"]["fno"]["eps_kappa"]


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
    coarse, table = npred.predictor("euler", plant, 21), Certify(restarts=8, steps=6)
    calls, error = adversary.search(plant, coarse, data, Inputs.of(data, box, plant), table, 0, lambda count: None)
    X, _, D, t = calls
    np.testing.assert_allclose(D, [plant.delay(*row) for row in zip(X, t, strict=True)], rtol=1e-12)
    assert np.ptp(t) > 2 if plant.clocked else (t == 0).all()
    np.testing.assert_allclose(rollouts.judged(Guarded(coarse, exact=exact), exact, *calls)[0], error, rtol=1e-9)


def test_the_gradient_climbs_through_a_network(certified):
    (task, _), _, data = certified
    from npred.stages.evaluate import networks

    network = networks.load(task, PredictorId("deeponet"))
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


def test_the_summary_says_what_holds(certified):
    _, (result, _), _ = certified
    from npred.results import Certified

    text = certify.summary(Certified.of(result, "a test"), 80)
    count, samples = rollouts.count(0.2, 0.9), Certify(**TABLE).samples
    assert {row["samples"] for row in result["models"].values()} == {samples}
    assert (
        f"{count} fresh rollouts, {samples} random samples of each: with a confidence of 90.0000% at most 20.00% of "
        "rollouts so sampled have an error of U, in its largest component, above ε κ"
    ) in " ".join(text.split())
    assert "DeepONet" in text and "FNO" in text


CALLS = (np.zeros((6, 1)), np.zeros((6, 3, 1)), np.zeros(6), np.zeros(6))
TRUE = np.array([0.1, 0.4, 0.8, 1.5, 2.0, 5.0])  # errors of known calls, for a tolerance of 1
ESTIMATES = TRUE * [9.0, 1.0, 2.0, 1.5, 3.0, 9.0]
PASSED = np.array([True, True, False, True, False, False])
GUARD = SimpleNamespace(tolerance=1.0, by="shadow", plant=PLANT, name="guarded", bound=lambda *calls: BOUNDS)
BOUNDS = np.array([2.0, np.inf, 6.0])


def test_what_a_guard_lets_pass_is_counted_by_call(tmp_path, monkeypatch):
    monkeypatch.setattr(rollouts, "judged", lambda *calls, **_: (TRUE, ESTIMATES, PASSED))
    found = certify._calls(GUARD, None, CALLS)
    assert (found["calls"], found["above"], found["unnoticed"]) == (6, 3, 1)
    assert (found["adversarial"], found["adversarial_median"]) == (5.0, pytest.approx(1.15))
    assert found["ratio"][1] == pytest.approx(1.75)  # of 1, 1.5, 2 and 3, those of errors from 0.3 to 3
    monkeypatch.setattr(certify.adversary, "blind_spots", lambda *arguments: (CALLS, None))
    monkeypatch.setattr(certify.Inputs, "of", lambda *arguments: None)
    blind = certify._blind(job(tmp_path, "certify"), None, GUARD, None)
    assert blind == {"blind_calls": 6, "blind": 1, "blind_error": 1.5}


def test_rollouts_and_bounds_of_known_errors(tmp_path):
    fresh = rollouts.Rollouts(np.array([1.0, 9.0, 2.0]), CALLS, 0.25)
    found = certify._rollouts(Certify(), fresh)
    assert (found["eps_kappa"], found["median"], found["rollouts"], found["fallback_rollouts"]) == (9.0, 2.0, 3, 0.25)
    bounds = certify._bounds(GUARD, fresh)
    assert bounds["bounded"] == pytest.approx(2 / 3) and bounds["bound"][1] == pytest.approx(2.5)  # of 2 / 1 and 6 / 2


def test_the_worst_call_of_each_rollout_and_the_samples_of_all_count():
    errors, rollout = np.array([3.0, 1.0, 2.0, 7.0, 5.0]), np.array([4, 4, 2, 2, 9])
    np.testing.assert_array_equal(rollouts._largest(errors, rollout), [3, 0, 4])
    parts = [rollouts.Rollouts(np.ones(count), CALLS, share) for count, share in ((3, 0.1), (1, 0.5))]
    assert rollouts._joined(parts).fallback == pytest.approx(0.2)


def test_an_error_is_the_largest_over_the_inputs_and_infinite_where_there_is_no_prediction():
    """U = -(q, r) at P(1), of a plant with two inputs: errors (3, -4) and none."""
    plant = SimpleNamespace(declares_delay=False, ratios=np.ones(2), kappa=lambda P, t: -P)
    P = np.zeros((2, 5, 2))
    P[:, -1] = [[3.0, -4.0], [np.nan, 1.0]]
    guard = SimpleNamespace(
        plant=plant, model=lambda *rows: P, judge=lambda *rows: (np.ones(2), np.array([True, False]))
    )
    true, estimates, passed = rollouts.judged(guard, lambda *rows: 0 * np.nan_to_num(P), *(np.zeros(2),) * 3)
    assert true.tolist() == [4.0, np.inf] and estimates.tolist() == [1.0, 1.0] and passed.tolist() == [False, True]


def test_loops_are_lost_beside_those_that_numerics_keep():
    """Of four loops numerics lose the third; the network the first and the third, the guarded one all but the first."""
    exact = known_loops([10, 10, NEVER, 10], [0.0] * 4)
    bare, guarded = known_loops([NEVER, 10, NEVER, 10], [0.0] * 4), known_loops([10, NEVER, NEVER, NEVER], [0.0] * 4)
    bare = replace(bare, X=3 * bare.X)
    guarded = replace(guarded, X=2 * guarded.X, fallbacks=np.array([0, 0, 0, guarded.steps]))
    assert certify._behaviour(npred.plant("scalar"), exact, bare, guarded) == {
        "lost": 1, "lost_guarded": 2, "peak": 3.0, "peak_guarded": 2.0, "fallback": 0.25
    }  # fmt: skip


def test_the_worst_calls_are_kept_the_worst_first(tmp_path):
    X = np.arange(6.0)[:, None]
    certify._write_worst(tmp_path, {PredictorId("fno"): ((X, *CALLS[1:]), np.array([1, 5, 2, np.nan, 4, 3.0]))})
    with h5py.File(tmp_path / "worst.h5") as file:
        assert file["fno/X"][:5, 0].tolist() == [1, 4, 5, 2, 0] and file["fno/error"][0] == 5.0
