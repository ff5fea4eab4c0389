"""The certify stage: the statistics by simulation, the result of a tiny pipeline without the searches of packages."""

from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from jobs import PLANT as NAME
from jobs import job, trained
from known_loops import NEVER, known_loops

import npred
from npred.base import registry
from npred.lab.stages.certify import certify, rollouts
from npred.lab.stages.certify.table import Certify
from npred.lab.stages.generate import generate
from npred.lab.training.data.dataset import Dataset

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
    monkeypatch = pytest.MonkeyPatch()
    monkeypatch.setattr(registry.CERTIFICATES, "group", "npred.nobody")
    tasks = [job(root, name, inputs=inputs, jobs=jobs, certify=TABLE) for name, jobs in (("one", 1), ("two", 2))]
    yield tasks, [certify.run(task).json_object() for task in tasks], Dataset.read(inputs["generate"] / "data.h5")
    monkeypatch.undo()


def test_a_certificate_of_each_network(certified):
    _, (result, _), _ = certified
    assert set(result["models"]) == {"deeponet", "fno"} and result["loops"] == 5
    for row in result["models"].values():
        assert row["rollouts"] == rollouts.count(0.2, 0.9)
        assert 0 < row["median"] <= row["eps_kappa"]
        assert not {"adversarial", "calls", "bound"} & row.keys()
        assert 0 <= row["far_guarded"] <= 5 and 0 <= row["fallback"] <= 1


def test_the_same_twice(certified):
    (one, two), (first, second), _ = certified
    assert first == second
    assert (one.folder / "errors.h5").read_bytes() == (two.folder / "errors.h5").read_bytes()


def test_the_rollouts_are_none_that_were_trained_on(certified):
    (task, _), (result, _), data = certified
    pipeline = rollouts.fresh(task.config, Certify(**TABLE), 4)
    rows = dict(generate.batches(task, pipeline))[0]
    assert not np.isin(rows["X"][:, 0], data.X[:, 0]).any()
    with h5py.File(task.folder / "errors.h5") as file:
        assert max(file["fno"]) == result["models"]["fno"]["eps_kappa"]


def test_the_summary_says_what_holds(certified):
    _, (result, _), _ = certified
    from npred.lab.config.results import Certified

    text = certify.summary(Certified.of(result, "a test"), 80)
    count, samples = rollouts.count(0.2, 0.9), Certify(**TABLE).samples
    assert {row["samples"] for row in result["models"].values()} == {samples}
    assert (
        f"{count} fresh rollouts, {samples} random samples of each: with a confidence of 90.0000% at most 20.00% of "
        "rollouts so sampled have an error of U, in its largest component, above ε_κ"
    ) in " ".join(text.split())
    assert "DeepONet" in text and "FNO" in text


WORST = (np.zeros((6, 1)), np.zeros((6, 3, 1)), np.zeros(6), np.zeros(6))


def test_rollouts_of_known_errors():
    row = certify._rollouts(Certify(), rollouts.Rollouts(np.array([1.0, 9.0, 2.0]), WORST, 0.25))
    assert (row["eps_kappa"], row["median"], row["rollouts"], row["fallback_rollouts"]) == (9.0, 2.0, 3, 0.25)


def test_the_worst_call_of_each_rollout_and_the_samples_of_all_count():
    errors, rollout = np.array([3.0, 1.0, 2.0, 7.0, 5.0]), np.array([4, 4, 2, 2, 9])
    np.testing.assert_array_equal(rollouts._largest(errors, rollout), [3, 0, 4])
    parts = [rollouts.Rollouts(np.ones(count), WORST, share) for count, share in ((3, 0.1), (1, 0.5))]
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
        "far": 1, "far_guarded": 2, "peak": 3.0, "peak_guarded": 2.0, "fallback": 0.25
    }  # fmt: skip
