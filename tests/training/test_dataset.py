"""The data file: the arrays come back, the same samples give the same bytes, a broken file is told."""

import h5py
import numpy as np
import pytest
from dataset_samples import dataset

from npred.base.errors import ConfigError, StoreError
from npred.lab.training.data.dataset import MEANING, Dataset
from npred.plants import resolve


def test_round_trip_with_meaning_and_attributes(tmp_path):
    data = dataset()
    data.write(tmp_path / "data.h5", {"plant": "scalar"})
    back = Dataset.read(tmp_path / "data.h5")
    for name in MEANING:
        np.testing.assert_array_equal(getattr(back, name), getattr(data, name))
        assert getattr(back, name).dtype == getattr(data, name).dtype
    with h5py.File(tmp_path / "data.h5") as file:
        assert file.attrs["plant"] == "scalar"
        assert "seconds" in file["D_hat"].attrs["meaning"]


def test_same_samples_same_bytes(tmp_path):
    for name in ("a.h5", "b.h5"):
        dataset().write(tmp_path / name, {"plant": "scalar"})
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_subsets_part_the_rows():
    data = dataset()
    train, test = data.subset(test=False), data.subset(test=True)
    assert len(train) == 4 and len(test) == 2
    np.testing.assert_array_equal(test.X, data.X[:2])
    assert not set(train.rollout) & set(test.rollout)


def test_broken_files_are_told(tmp_path):
    path = tmp_path / "data.h5"
    with pytest.raises(StoreError, match=r"data.h5: expected the arrays X, u"):
        Dataset.read(path)
    path.write_bytes(b"no HDF5")
    with pytest.raises(StoreError, match="generate it again"):
        Dataset.read(path)
    with h5py.File(path, "w") as file:
        file["X"] = np.zeros(3)
    with pytest.raises(StoreError, match="generate it again"):
        Dataset.read(path)


@pytest.mark.parametrize(
    ("name", "at", "value", "message"),
    [
        ("P", (3, 2, 1), np.nan, "P: expected finite numbers, got nan in row 3; leave that row out"),
        ("X", (2, 0), np.inf, "X: expected finite numbers, got inf in row 2"),
        ("u", (5, 0, 0), -np.inf, "u: expected finite numbers, got -inf in row 5"),
        ("D_hat", 1, np.nan, "D_hat: expected finite numbers, got nan in row 1"),
        ("D_hat", 4, -0.1, "D_hat: expected seconds from 0 on, got -0.1 in row 4"),
        ("D", 0, -1.0, "D: expected seconds from 0 on, got -1 in row 0"),
        ("test", 3, 2, "test: expected 1 where a row is held out, else 0, got 2 in row 3"),
    ],
)
def test_a_value_that_no_sample_has_is_told_with_its_row(name, at, value, message):
    data = dataset()
    data.fit(resolve("activator_repressor"))
    getattr(data, name)[at] = value
    with pytest.raises(ConfigError, match=message):
        data.fit(resolve("activator_repressor"))


def test_true_delays_and_times_may_be_unknown():
    data = dataset()
    data.D[:], data.t[:] = np.nan, np.nan
    data.fit(resolve("activator_repressor"))
