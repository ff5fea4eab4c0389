"""The input of a training: the rows, in memory or read in every epoch, and all that is fitted to them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from npred.base.errors import ConfigError
from npred.lab.config import Training
from npred.lab.training.data import shards
from npred.lab.training.data.dataset import Dataset
from npred.lab.training.loss import Criterion
from npred.lab.training.operators import Operator
from npred.lab.training.operators.scaling import SampleArrays

BUFFER = 4  # shards in memory, whose rows are shuffled together
REST_NODES = 16  # points in D_hat through which a batch interpolates the anchor's term at rest


@dataclass(frozen=True)
class Rows:
    """Samples in memory as float32 tensors: X (N, n), u (N, nx, m), D_hat (N,), P (N, nodes, n), phase (N,) or None."""

    X: Tensor
    u: Tensor
    D_hat: Tensor
    P: Tensor
    phase: Tensor | None = None

    @classmethod
    def of(cls, data: SampleArrays, device: str = "cpu", nodes: int | None = None, phase: Any = None) -> "Rows":
        """The samples on a device; P on every s-th node where `nodes` of them are asked for, u on all.

        `phase` (N,) is for an operator that sees the clock. Raises ConfigError where `nodes` does not divide the grid.
        """
        intervals = data.u.shape[1] - 1
        stride, rest = divmod(intervals, (nodes or intervals + 1) - 1)
        if rest or not stride:
            raise ConfigError(f"nodes: expected nodes - 1 to divide the data's {intervals} intervals, got {nodes}")
        arrays = data.X, data.u, data.D_hat, data.P[:, ::stride], *(() if phase is None else (phase,))
        return cls(*(torch.as_tensor(a).to(device, torch.float32).contiguous() for a in arrays))

    @property
    def stride(self) -> int:
        """The number of intervals of u in one of P."""
        return (self.u.shape[1] - 1) // (self.P.shape[1] - 1)

    @property
    def columns(self) -> list[Tensor]:
        """All tensors that there are."""
        return [self.X, self.u, self.D_hat, self.P, *(() if self.phase is None else (self.phase,))]

    def __len__(self) -> int:
        return len(self.D_hat)

    def __getitem__(self, index: Tensor | slice) -> "Rows":
        phase = None if self.phase is None else self.phase[index]
        return Rows(self.X[index], self.u[index], self.D_hat[index], self.P[index], phase)

    @classmethod
    def joined(cls, parts: Sequence["Rows"]) -> "Rows":
        """Rows one after the other."""
        phases = [p.phase for p in parts if p.phase is not None]
        X, u, D_hat, P = map(torch.cat, zip(*((p.X, p.u, p.D_hat, p.P) for p in parts), strict=True))
        return cls(X, u, D_hat, P, torch.cat(phases) if phases else None)

    def batches(self, shuffle: torch.Generator, size: int) -> Iterator["Rows"]:
        """Each row once, in random order."""
        return self.split(torch.randperm(len(self), generator=shuffle).to(self.X.device), size)

    def split(self, order: Tensor, size: int) -> Iterator["Rows"]:
        return (self[index] for index in order.split(size))


@dataclass(frozen=True)
class Stream:
    """Rows that do not fit in memory: of shards, those not held out; on a device, P on `nodes` nodes, as in Rows.

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
            parts = (Dataset.read(files[k]).subset(test=False) for k in group.tolist())
            read = (Rows.of(part, self.device, self.nodes, self.phase(part.t)) for part in parts)
            rows = Rows.joined([*left, *read])
            order = torch.randperm(len(rows), generator=shuffle).to(rows.X.device)
            whole = len(rows) // size * size
            if whole:  # an empty order would be split into one empty batch
                yield from rows.split(order[:whole], size)
            left = [rows[order[whole:]]]
        yield from (rows for rows in left if len(rows))


@dataclass(frozen=True)
class Fit:
    """The operator to train (in place), its rows, test and loss; `title` names it in progress and errors."""

    title: str
    operator: Operator
    config: Training
    train: Rows | Stream
    test: Rows
    loss: Criterion
    seed: int
