"""Who is compared: names that results use, and what people call them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from npred.lab.config.results import NO_ADAPTATION, NUMERICAL, PredictorId

NETWORKS = st.from_regex(r"[a-z][a-z_0-9]{0,20}", fullmatch=True)


@given(NETWORKS, st.none() | st.integers(1, 10**9))
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
    assert [c.is_network for c in (NUMERICAL, NO_ADAPTATION, PredictorId("fno"), PredictorId("fno", 3))] == [
        False, False, True, True,
    ]  # fmt: skip
    assert NUMERICAL.adapts and PredictorId("fno").adapts and not NO_ADAPTATION.adapts


@pytest.mark.parametrize("name", ["fno@", "fno@last", "fno@-1", "fno@²"])
def test_what_is_no_epoch_is_refused(name: str):
    with pytest.raises(ValueError, match="expected an epoch after @, got"):
        PredictorId.parse(name)
