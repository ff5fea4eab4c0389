"""Rows for training that do not fit in memory: read from shards in every epoch, shuffled by shards and in a buffer."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from npred.data import shards
from npred.data.dataset import Dataset
from npred.training.rows import Rows

BUFFER = 4  # shards in memory, whose rows are shuffled together


@dataclass(frozen=True)
class Stream:
    """The rows of sharded data that are not held out; on a device, P on `nodes` nodes, as in Rows.

    `phase` gives those of the rows' times to an operator that sees the clock; see Plant.phase.
    """

    path: Path
    device: str = "cpu"
    nodes: int | None = None
    phase: Callable[[np.ndarray], np.ndarray | None] = lambda t: None

    @cached_property
    def _count(self) -> int:
        return sum(int(np.count_nonzero(test == 0)) for test in shards.column(self.path, "test"))

    def __len__(self) -> int:
        return self._count

    def parts(self) -> Iterator[Dataset]:
        """The rows in the order and precision of the file, one shard at a time."""
        return (part.subset(test=False) for part in shards.parts(self.path))

    def batches(self, shuffle: torch.Generator, size: int) -> Iterator[Rows]:
        """Each row once: the shards in random order, BUFFER at a time, the rows of those in random order.

        What is left of a buffer goes to the next, so that only the last batch is smaller.
        """
        files, left = shards.files(self.path), []
        for group in torch.randperm(len(files), generator=shuffle).split(BUFFER):
            rows = Rows.joined([*left, *(self._read(files[k]) for k in group.tolist())])
            order = torch.randperm(len(rows), generator=shuffle).to(rows.X.device)
            whole = len(rows) // size * size
            if whole:  # an empty order would be split into one empty batch
                yield from rows.split(order[:whole], size)
            left = [rows[order[whole:]]]
        yield from (rows for rows in left if len(rows))

    def _read(self, path: Path) -> Rows:
        data = Dataset.read(path).subset(test=False)
        return Rows.of(data, self.device, self.nodes, self.phase(data.t))
