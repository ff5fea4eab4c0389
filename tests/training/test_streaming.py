"""Streams: every training row once an epoch, in an order that the seed decides; the data file that they read."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch
from dataset_samples import dataset
from operator_samples import samples

from npred.base.errors import ConfigError, StoreError
from npred.lab.training.data import hdf5, shards
from npred.lab.training.data.dataset import MEANING, Dataset
from npred.lab.training.rows import Rows, Stream
from npred.plants import resolve

ROWS = [30, 30, 30, 30, 13]


@pytest.fixture
def data(tmp_path):
    """Five shards of ten rollouts or fewer, one row in five held out; D_hat numbers the rows."""
    arrays, start = samples(sum(ROWS)), 0
    for number, count in enumerate(ROWS):
        some, rows = slice(start, start + count), np.arange(start, start + count)
        test, ones = (rows % 5 == 0).astype(np.uint8), np.ones(count)
        shard = Dataset(arrays.X[some], arrays.u[some], rows + 1.0, arrays.P[some], ones, ones, rows // 3, test)
        shard.write(tmp_path / shards.name(number), {})
        start += count
    shards.join(tmp_path, ROWS, {})
    return tmp_path / "data.h5"


def epoch(stream: Stream, seed: int = 0, size: int = 16) -> list[Rows]:
    return list(stream.batches(torch.Generator().manual_seed(seed), size))


def numbers(batches: list[Rows]) -> list[float]:
    return [number for rows in batches for number in rows.D_hat.tolist()]


def test_each_training_row_comes_once_and_batches_are_full(data):
    stream = Stream(data)
    batches = epoch(stream)
    assert sorted(numbers(batches)) == [r + 1.0 for r in range(sum(ROWS)) if r % 5]
    assert len(stream) == len(numbers(batches)) and {len(rows) for rows in batches[:-1]} == {16}


def test_rows_stay_together(data):
    whole = Dataset.read(data)
    for rows in epoch(Stream(data, nodes=11)):
        k = rows.D_hat.long() - 1
        torch.testing.assert_close(rows.P, torch.as_tensor(whole.P[k][:, ::2], dtype=torch.float32))
        torch.testing.assert_close(rows.u, torch.as_tensor(whole.u[k], dtype=torch.float32))


def test_the_seed_decides_the_order(data):
    first, again, other = (numbers(epoch(Stream(data), seed)) for seed in (0, 0, 1))
    assert first == again != other and sorted(first) == sorted(other)
    assert first != sorted(first)


def test_a_buffer_holds_few_shards_and_mixes_them(data, monkeypatch):
    monkeypatch.setattr("npred.lab.training.rows.BUFFER", 2)
    read, most, real = [], [], Dataset.read
    monkeypatch.setattr(Dataset, "read", lambda path: (read.append(path), real(path))[1])
    batches = Stream(data).batches(torch.Generator().manual_seed(0), 8)
    for rows in batches:
        most.append(len(read))
        assert len(rows) <= 8
    assert most[0] == 2 and most[-1] == 5, "a shard is read when its turn comes"
    shard_of = np.repeat(np.arange(5), ROWS)[np.array(numbers(epoch(Stream(data), size=24))[:24], dtype=int) - 1]
    assert len(set(shard_of)) == 2


def test_parts_are_the_training_rows(data):
    parts = list(Stream(data).parts())
    assert [len(part) for part in parts] == [24, 24, 24, 24, 10] and not any(part.test.any() for part in parts)


NUMBERS = np.arange(12.0).reshape(4, 3)


def read(path: Path) -> np.ndarray:
    with hdf5.opened(path, {"X": 2}) as arrays:
        return arrays["X"][:]


def write(path: Path, **options: Any) -> Path:
    with h5py.File(path, "w") as file:
        file.create_dataset("X", **({"data": NUMBERS} | options))
    return path


def joined(path: Path, source: str, name: str = "X", shape: tuple[int, int] = (4, 3)) -> Path:
    layout = h5py.VirtualLayout(shape=shape, dtype="f8")
    layout[:4] = h5py.VirtualSource(source, name, shape=(4, 3))
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("X", layout)
    return path


@pytest.mark.parametrize(
    "options", [{}, {"chunks": (2, 3)}, {"compression": "gzip", "shuffle": True}, {"fletcher32": True}]
)
def test_plain_arrays_are_read(tmp_path: Path, options: dict[str, Any]):
    assert (read(write(tmp_path / "a.h5", **options)) == NUMBERS).all()


def test_shards_beside_the_file_are_joined(tmp_path: Path):
    write(tmp_path / "shard-0.h5")
    assert (read(joined(tmp_path / "a.h5", "shard-0.h5")) == NUMBERS).all()


@pytest.mark.parametrize(
    "source", ["../secret.h5", "sub/s.h5", "/etc/s.h5", ".", "a.h5", ".hidden.h5", "shard 1.h5", "none.h5"]
)
def test_shards_elsewhere_are_refused(tmp_path: Path, source: str):
    write(tmp_path / "secret.h5")
    folder = tmp_path / "here"
    (folder / "sub").mkdir(parents=True)
    write(folder / "sub" / "s.h5")
    write(folder / ".hidden.h5")
    with pytest.raises(StoreError, match=r"a\.h5: expected the arrays X, got: "):
        read(joined(folder / "a.h5", source))


def test_a_shard_behind_a_link_or_joined_itself_is_refused(tmp_path: Path):
    write(tmp_path / "x")
    (tmp_path / "link.h5").symlink_to(tmp_path / "x")
    write(tmp_path / "s.h5")
    joined(tmp_path / "chain.h5", "s.h5")
    for source, words in (("link.h5", "link.h5 is a link"), ("chain.h5", "itself joined")):
        with pytest.raises(StoreError, match=words):
            read(joined(tmp_path / "a.h5", source))


def test_links_out_of_the_file_are_refused(tmp_path: Path):
    write(tmp_path / "s.h5")
    for link in (h5py.ExternalLink("s.h5", "/X"), h5py.SoftLink("/Y")):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["Y"] = NUMBERS
            file["X"] = link
        with pytest.raises(StoreError, match="X is missing, or a link to elsewhere"):
            read(tmp_path / "a.h5")


def test_a_link_on_the_way_is_refused_also_behind_a_virtual_array(tmp_path: Path):
    (tmp_path / "other").mkdir()
    write(tmp_path / "other" / "secret.h5")
    with h5py.File(tmp_path / "s.h5", "w") as file:
        file["g"] = h5py.ExternalLink("other/secret.h5", "/")
        file["a/b"] = NUMBERS
    for name in ("g/X", "/g/X", "a/b"):
        with pytest.raises(StoreError, match=rf"X is joined from '{name}' of s\.h5"):
            read(joined(tmp_path / "a.h5", "s.h5", name))
    with hdf5.opened(tmp_path / "s.h5", {"a/b": 2}) as arrays:
        assert (arrays["a/b"][:] == NUMBERS).all()
    for name in ("g/X", "a/b/c", "none/X"):
        with (
            pytest.raises(StoreError, match=f"{name} is missing, or a link"),
            hdf5.opened(tmp_path / "s.h5", {name: 2}),
        ):
            pass


def test_numbers_kept_in_another_file_are_refused(tmp_path: Path):
    (tmp_path / "raw").write_bytes(NUMBERS.tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("X", shape=(4, 3), dtype="f8", external=[(str(tmp_path / "raw"), 0, 96)])
    with pytest.raises(StoreError, match="kept in another file"):
        read(tmp_path / "a.h5")


def test_a_filter_that_would_be_loaded_is_refused(tmp_path: Path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        layout.set_chunk((4, 3))
        layout.set_filter(32001, h5py.h5z.FLAG_OPTIONAL, ())  # blosc's number
        space, kind = h5py.h5s.create_simple((4, 3)), h5py.h5t.NATIVE_DOUBLE
        h5py.h5d.create(file.id, b"X", kind, space, layout)
    with pytest.raises(StoreError, match=r"filter \[32001\]"):
        read(tmp_path / "a.h5")


@pytest.mark.parametrize("options", [{}, {"chunks": (1000, 3)}, {"chunks": (1000, 3), "compression": "gzip"}])
def test_no_room_is_made_for_an_array_that_is_not_there(tmp_path: Path, options: dict[str, Any]):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("X", shape=(10**13, 3), dtype="f8", **options)
    with pytest.raises(StoreError, match="larger than what is stored of it"):
        read(tmp_path / "a.h5")
    write(tmp_path / "s.h5")
    with pytest.raises(StoreError, match="larger than what is stored of it"):
        read(joined(tmp_path / "b.h5", "s.h5", shape=(10**13, 3)))


@pytest.mark.parametrize("data", [np.arange(3.0), ["text"], np.zeros((4, 3), dtype="c16"), np.zeros(3, dtype="i4,f8")])
def test_what_is_no_table_of_numbers_is_refused(tmp_path: Path, data: Any):
    with pytest.raises(StoreError, match="X"):
        read(write(tmp_path / "a.h5", data=data))


def test_groups_and_other_files_are_refused(tmp_path: Path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_group("X")
    (tmp_path / "b.h5").write_bytes(b"no HDF5")
    for name, words in (("a.h5", "no array of numbers"), ("b.h5", "signature"), ("c.h5", "no regular file")):
        with pytest.raises(StoreError, match=words):
            read(tmp_path / name)


def test_round_trip_with_meaning_and_attributes(tmp_path):
    data = dataset()
    data.write(tmp_path / "data.h5", {"plant": "scalar"})
    back = Dataset.read(tmp_path / "data.h5")
    for name in MEANING:
        np.testing.assert_array_equal(getattr(back, name), getattr(data, name))
        assert getattr(back, name).dtype == getattr(data, name).dtype
    with h5py.File(tmp_path / "data.h5") as file:
        assert file.attrs["plant"] == "scalar"
        assert "delay estimate" in file["D_hat"].attrs["meaning"]


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
        ("D_hat", 4, -0.1, "D_hat: expected times from 0 on, got -0.1 in row 4"),
        ("D", 0, -1.0, "D: expected times from 0 on, got -1 in row 0"),
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
