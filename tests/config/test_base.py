"""Results as models: the JSON that the stages write, key for key, and one line for any other."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from result_samples import BENCHED, CROSSOVER, MAP, SCORES, TRAINED, evaluated, timing

from npred.base.errors import StoreError
from npred.lab.config.results import (
    NO_ADAPTATION,
    NUMERICAL,
    Benched,
    Evaluated,
    Generated,
    PredictorId,
    Result,
    Trained,
)
from npred.lab.config.results.evaluate import Errors, Scores
from npred.lab.scheduler.plan import STAGES

EVALUATED = evaluated({"numerical": SCORES, "deeponet@7": SCORES | {"map": None}})


def test_every_result_of_a_pipeline_is_its_models_dump(reported: tuple[Path, dict[str, Any]]):
    for outcome in reported[1].values():
        text = (outcome.artifact.folder / "result.json").read_text()
        typed = STAGES[outcome.node.stage].result.read(outcome.artifact.folder)
        assert json.dumps(typed.json_object(), indent=1, allow_nan=False) + "\n" == text


@pytest.mark.parametrize(
    ("model", "document"),
    [
        (Trained, TRAINED | {"loss": None}),
        (Generated, {"samples": 3, "rollouts": 1, "held_out": [0], "nx": 5}),
        (Generated, {"samples": 3, "rollouts": 1, "held_out": [0], "nx": 5, "shards": 2}),
        (Evaluated, EVALUATED),
        (Benched, BENCHED | {"rows": [timing("rk4").json_object()], "crossover": [CROSSOVER]}),
    ],
)
def test_a_document_goes_through_its_model_unchanged(model: type[Result], document: dict[str, Any]):
    typed = model.of(document, "a test")
    assert json.dumps(typed.json_object()) == json.dumps(document)
    assert model.of(typed.json_object(), "a test") == typed


def test_null_is_infinite_where_a_number_is_not_finite_and_nothing_where_there_is_none():
    scores = Scores.of(SCORES | {"mse": None, "map": None, "in_loop": math.nan}, "a test")
    assert (scores.mse, scores.in_loop, scores.map, scores.decay_rate) == (math.inf, math.inf, None, None)
    assert scores.radius.predicted == math.inf and scores.json_object()["radius"]["predicted"] is None
    assert scores.set_values.keys() == SCORES.keys() != Scores.model_fields.keys()


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"foreign": 1}, " no foreign, got 1; "),
        ({"models": {"fno": SCORES | {"novel": 1}}}, " no models.fno.novel, got 1"),
        ({"models": {"fno@late": SCORES}}, r" at models.fno@late.\[key\] an epoch after @, got 'fno@late'"),
        ({"models": {"fno": SCORES | {"map": MAP | {"share": "all"}}}}, " at models.fno.map.share a number, got 'all'"),
        ({"gain": [1.0]}, " at gain "),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(tmp_path: Path, change: dict[str, Any], place: str):
    (tmp_path / "result.json").write_text(json.dumps(EVALUATED | change))
    with pytest.raises(StoreError, match=rf"result.json: expected a result as this npred writes it,{place}"):
        Evaluated.read(tmp_path)


@pytest.mark.parametrize("text", ["[]", "{", None])
def test_what_is_no_json_object_is_refused(tmp_path: Path, text: str | None):
    if text is not None:
        (tmp_path / "result.json").write_text(text)
    with pytest.raises(StoreError, match=r"result.json: expected a result as JSON, got: .*; remove .*, run again"):
        Trained.read(tmp_path)


def test_a_missing_key_is_named():
    with pytest.raises(StoreError, match=r"a test: expected .* at rel_l2 a value, got none"):
        Errors.of({"mse": 0, "eps_sup": 0, "eps_kappa": 0}, "a test")


def test_the_networks_of_an_evaluation_that_are_not_built_in_are_counted_by_name():
    names = ("numerical", "yours", "fno", "mine@3", "mine")
    typed = Evaluated.of(evaluated(dict.fromkeys(names, SCORES)), "a test")
    assert [c.name for c in typed.models] == [*names] and [c.rank for c in typed.models] == [0, 1, 0, 0, 0]


NETWORK_NAMES = st.from_regex(r"[a-z][a-z_0-9]{0,20}", fullmatch=True)


@given(NETWORK_NAMES, st.none() | st.integers(1, 10**9))
def test_a_name_is_read_back(model: str, epoch: int | None):
    predictor = PredictorId(model, epoch)
    assert PredictorId.parse(predictor.name) == predictor == PredictorId.parse(predictor)


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("numerical", "numerical"),
        ("no_adaptation", "no adaptation"),
        ("deeponet", "DeepONet"),
        ("fno@20", "FNO, epoch 20"),
        ("my_net@3", "my_net, epoch 3"),
    ],
)
def test_labels_are_the_registrys_and_a_networks_own_name_elsewhere(name: str, label: str):
    assert PredictorId.parse(name).label == label


def test_networks_are_all_but_the_two():
    assert PredictorId("fno").is_network and PredictorId("fno", 3).is_network
    assert not NUMERICAL.is_network and not NO_ADAPTATION.is_network
    assert NUMERICAL.adapts and PredictorId("fno").adapts and not NO_ADAPTATION.adapts


@pytest.mark.parametrize("name", ["fno@", "fno@last", "fno@-1", "fno@²"])
def test_what_is_no_epoch_is_refused(name: str):
    with pytest.raises(ValueError, match="expected an epoch after @, got"):
        PredictorId.parse(name)
