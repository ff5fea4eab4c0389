"""Shards: one virtual file for others, read one at a time here, with the same rows whatever way."""

import math

import h5py
import numpy as np
import pytest
from dataset_samples import dataset

from npred.base.errors import StoreError
from npred.lab.training.data import shards
from npred.lab.training.data.dataset import MEANING, Dataset

ROWS = [5, 10, 3]


def part(whole: Dataset, rows: slice) -> Dataset:
    return Dataset(**{name: getattr(whole, name)[rows] for name in MEANING})


def same(a: Dataset, b: Dataset) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in MEANING)


@pytest.fixture
def sharded(tmp_path):
    """A folder with three shards, and their rows in memory."""
    whole, start = dataset(sum(ROWS)), 0
    folder = tmp_path / "made"
    folder.mkdir()
    for number, count in enumerate(ROWS):
        part(whole, slice(start, start + count)).write(folder / shards.name(number), {"plant": "scalar"})
        start += count
    shards.join(folder, ROWS, {"plant": "scalar"})
    return folder / "data.h5", whole


def test_the_joined_file_is_read_like_any_other_wherever_it_is_moved(sharded, tmp_path, monkeypatch):
    path, whole = sharded
    monkeypatch.chdir("/")
    moved = path.parent.rename(tmp_path / "moved") / "data.h5"
    assert same(Dataset.read(moved), whole)
    with h5py.File(moved) as file:
        assert file.attrs["plant"] == "scalar"
        assert "delay estimate" in file["D_hat"].attrs["meaning"]


def test_parts_and_columns_are_the_rows_in_their_order(sharded):
    path, whole = sharded
    found = list(shards.parts(path))
    assert [len(some) for some in found] == ROWS and same(found[1], part(whole, slice(5, 15)))
    np.testing.assert_array_equal(np.concatenate(list(shards.column(path, "D_hat"))), whole.D_hat)


def test_a_single_file_is_one_part_and_its_own_survey(tmp_path, monkeypatch):
    monkeypatch.setattr(shards, "SURVEY", 1)
    dataset().write(tmp_path / "data.h5", {})
    assert shards.files(tmp_path / "data.h5") == [tmp_path / "data.h5"]
    assert same(next(shards.parts(tmp_path / "data.h5")), dataset())
    assert same(shards.survey(tmp_path / "data.h5"), dataset())


@pytest.mark.parametrize("step", [1, 3, 5, 100])
def test_a_survey_takes_every_kth_row_across_shards(sharded, monkeypatch, step):
    path, whole = sharded
    bytes_ = sum(getattr(whole, name).nbytes for name in MEANING)
    monkeypatch.setattr(shards, "SURVEY", math.ceil(bytes_ / step))
    assert same(shards.survey(path), part(whole, slice(None, None, step)))


def test_width_is_what_a_row_takes():
    data = dataset()
    assert shards.width(2, 1, 5) * len(data) == sum(getattr(data, name).nbytes for name in MEANING)


def test_no_time_of_making_is_in_the_joined_file(sharded):
    path, _ = sharded
    with h5py.File(path) as file:
        assert {h5py.h5o.get_info(file[name].id).mtime for name in MEANING} == {0}
    before = path.read_bytes()
    shards.join(path.parent, ROWS, {"plant": "scalar"})
    assert path.read_bytes() == before


def test_a_lost_shard_is_told_here_and_reads_as_nan_elsewhere(sharded):
    path, _ = sharded
    (path.parent / shards.name(1)).unlink()
    with h5py.File(path) as file:
        assert np.isnan(file["X"][5:15]).all() and np.isfinite(file["X"][:5]).all() and file["test"][5] == 255
    with pytest.raises(StoreError, match=r"data\.h5: expected the arrays X, got: no regular file"):
        list(shards.parts(path))


def test_what_is_no_data_is_told(tmp_path):
    (tmp_path / "data.h5").write_bytes(b"no HDF5")
    with pytest.raises(StoreError, match=r"data\.h5: expected the arrays X, got: .*; generate it again"):
        shards.files(tmp_path / "data.h5")
