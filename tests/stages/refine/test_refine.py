"""The refine stage on tiny networks: what it writes, what it compares, what it leaves as it was."""

import numpy as np
import pytest
from jobs import PLANT, job, tables, trained

import npred
from npred import config, operators
from npred.data.dataset import Dataset
from npred.data.domain import Domain
from npred.predictors import RK4
from npred.results import Refined
from npred.stages.refine import failures, hostile, refine

CERTIFY = {"probability": 0.3, "confidence": 0.8, "samples": 5, "restarts": 8, "steps": 5, "loops": 3}
TABLE = {"adversary": 120, "fallbacks": 60, "epochs": 4, "loops": 3}
PLANT = npred.plant(PLANT)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    root = tmp_path_factory.mktemp("refine")
    return root, trained(root)


@pytest.fixture(scope="module")
def refined(inputs):
    root, folders = inputs
    tasks = [
        job(root, name, inputs=folders, model="deeponet", certify=CERTIFY, refine=TABLE | {"domain": domain})
        for name, domain in (("data", "data"), ("all", "all"))
    ]
    return tasks, [refine.run(task) for task in tasks]


def test_the_refined_network_loads_as_a_trained_one_and_is_another(inputs, refined):
    (task, _), (result, _) = refined
    before, after = (operators.load(folder, PLANT) for folder in (inputs[1]["deeponet"], task.folder))
    for name, tensor in before.state_dict().items():
        same = np.array_equal(tensor, after.state_dict()[name])
        assert same == ("network" not in name), name  # the scaling is the same, so that a row means what it did
    assert {p.name for p in task.folder.iterdir()} == {
        "model.safetensors", "model.json", "domain.safetensors", "metrics.jsonl",
    }  # fmt: skip
    assert len((task.folder / "metrics.jsonl").read_text().splitlines()) == TABLE["epochs"] == result.epochs


def test_the_rows_of_both_kinds_and_a_share_of_the_data(inputs, refined):
    _, (result, _) = refined
    data = Dataset.read(inputs[1]["generate"] / "data.h5")
    assert result.data == round(0.5 * (data.test == 0).sum())
    assert 0 < result.adversary <= 120 and 0 <= result.fallbacks <= 60


def test_the_adversary_of_a_plant_with_a_clock_draws_times(tmp_path):
    plant, rng, t = npred.plant("unicycle"), np.random.default_rng(4), np.linspace(0.0, 5.0, 20)
    X, u, D = rng.normal(size=(20, 3)), rng.normal(size=(20, 21, 2)), np.full(20, 0.6)
    data = Dataset(X, u, D, RK4(plant, 21)(X, u, D, t), D, t, np.arange(20), np.zeros(20, dtype=bool))
    task = job(tmp_path, "clocked", plant="unicycle", refine=TABLE)
    found = failures.adversarial(task, npred.guarded(npred.predictor("euler", plant, 21)), data)
    assert len(found.t) == 120 and np.ptp(found.t) > 1


def test_before_and_after_are_compared_on_the_same_inputs(refined):
    _, (result, _) = refined
    before, after = result.models.values()
    assert [c.name for c in result.models] == ["deeponet", "deeponet@refined"]
    assert before.certificate.rollouts == after.certificate.rollouts
    assert before.certificate.eps_kappa != after.certificate.eps_kappa and before.mse != after.mse
    assert before.hostile.keys() == after.hostile.keys() and result.loops == 3 * len(before.hostile) == 15
    for row in (before, after):
        assert row.lost == sum(kind.lost for kind in row.hostile.values())
        assert 0 <= row.fallback <= 1
    again = Refined.of(result.json_object(), "a test")
    assert again == result and "DeepONet, refined" in refine.summary(again, 200)


def test_the_domain_is_that_of_the_data_unless_it_is_to_be_wider(inputs, refined):
    tasks, _ = refined
    old, same, wider = (Domain.load(folder) for folder in (inputs[1]["deeponet"], *(task.folder for task in tasks)))
    for name in vars(old):
        np.testing.assert_array_equal(getattr(old, name), getattr(same, name))
        if name != "limit":
            np.testing.assert_array_equal(getattr(old, name), getattr(wider, name))
    assert wider.limit >= old.limit
    rows = failures.adversarial(
        tasks[1], refine._guard(tasks[1], "deeponet"), Dataset.read(inputs[1]["generate"] / "data.h5")
    )
    assert (wider.distance(rows.X, rows.u, rows.D_hat, None) <= wider.limit).all()
    weights = [operators.load(task.folder, PLANT).state_dict() for task in tasks]
    for name, tensor in weights[0].items():
        np.testing.assert_array_equal(tensor, weights[1][name])  # the same training twice, whatever the guard trusts


def test_labels_are_the_numerical_predictors_and_seeds_are_not_those_of_the_comparison(inputs, refined):
    (task, _), _ = refined
    data = Dataset.read(inputs[1]["generate"] / "data.h5")
    guard = refine._guard(task, "deeponet")
    rows = failures.adversarial(task, guard, data)
    nx = data.u.shape[1]
    np.testing.assert_allclose(rows.P, RK4(PLANT, nx)(rows.X, rows.u, rows.D_hat), rtol=1e-12)
    starts = [
        next(hostile.loops(task, guard.exact, data, purpose))[1].X[:, 0] for purpose in ("train", "test")
    ]  # fmt: skip
    assert not np.isin(*starts).any()
    refused = failures.refused(task, guard, data)
    assert guard.fallback(refused.X, refused.u, refused.D_hat).all() and refused.u.shape[1:] == data.u.shape[1:]


def test_a_pipeline_has_the_stage_where_it_has_the_table_and_a_node_for_each_network():
    from npred.pipeline import nodes, usual

    plain, asked = (config.parse(tables(**more), "tests") for more in ({}, {"refine": TABLE}))
    assert "refine" not in usual(plain) and usual(asked).index("refine") < usual(asked).index("report")
    steps = {node.name: node for node in nodes(asked, ["report"])}
    assert steps["deeponet@refined"].inputs == ("generate", "deeponet")
    assert {"deeponet@refined", "fno@refined"} <= set(steps["report"].inputs)
    assert [node.name for node in nodes(plain, ["refine"], only="fno")] == ["generate", "fno", "fno@refined"]
    assert not [node for node in nodes(plain, ["report"]) if node.stage == "refine"]
