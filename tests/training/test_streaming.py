"""Streams: every training row once an epoch, in an order that the seed decides, never more than a buffer of them."""

import numpy as np
import pytest
import torch
from operator_samples import samples

from npred.lab.training.data import shards
from npred.lab.training.data.dataset import Dataset
from npred.lab.training.rows import Rows, Stream

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
