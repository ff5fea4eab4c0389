"""One training loop for every network: seeded by epoch, resumable to the bit, readable from top to bottom."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor

from npred import randomness
from npred.config import Training
from npred.errors import ConfigError, DivergedError
from npred.operators import Operator, io
from npred.operators.scaling import SampleArrays
from npred.parallel import torchrun
from npred.training import checkpoint
from npred.training.checkpoint import Metrics
from npred.training.soap import SOAP

WARM_UP = 0.05  # share of the steps in which the one-cycle rate climbs
CYCLES = 4  # of that rate in a training that may end before its last epoch, each twice as long as the one before
REST_NODES = 16  # points in D_hat through which a batch interpolates the anchor's term at rest
CHUNK = 1024  # rows of a call without gradients
Loss = Callable[[Tensor, Tensor], Tensor]  # (P_hat, P) -> ()


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
        """The rows in this order, in batches."""
        return (self[index] for index in order.split(size))


class RowSource(Protocol):
    """The source of an epoch's rows."""

    def __len__(self) -> int: ...

    def batches(self, shuffle: torch.Generator, size: int) -> Iterator[Rows]:
        """Each row once, in an order that the generator draws, `size` at a time."""
        ...


@dataclass(frozen=True)
class Fit:
    """The operator to train (in place), its rows, test and loss; `title` names it in progress and errors."""

    title: str
    operator: Operator
    config: Training
    train: RowSource
    test: Rows
    loss: Loss
    seed: int


def fit(task: Fit, scratch: Path, progress: Any) -> Metrics:
    """Train, one dictionary of metrics per epoch; continues from the checkpoint in `scratch`, if there is one.

    The order of the rows depends on the seed and the epoch alone, the rate on the step. With config.eps it ends with
    the first cycle of the rate that leaves the held-out error as small, and says so where none does.
    Weights after the epochs of config.snapshots stay in `scratch`. Raises DivergedError for a loss that is not finite.
    """
    operator, config = task.operator, task.config
    optimiser = _optimiser(operator, config)
    metrics = checkpoint.restore(scratch, operator, optimiser)
    network = torchrun.shared(operator)
    if metrics:
        progress.note(f"{task.title}: resuming at epoch {len(metrics) + 1} of {config.epochs}")
    with progress.bar(task.title, config.epochs, "epochs", done=len(metrics)) as bar:
        for row in metrics:
            progress.measured(task.title, row)
        for epoch in range(len(metrics) + 1, config.epochs + 1):
            if _reached(config, metrics):
                break
            loss = _epoch(task, network, optimiser, epoch, bar)
            lr = optimiser.param_groups[0]["lr"]
            metrics.append({"epoch": epoch, "lr": lr, "loss": loss, **errors(operator, task.test)})
            if config.eps:  # all processes end in the same epoch
                eps = torch.tensor(metrics[-1]["eps_sup"], dtype=torch.float64, device=task.test.X.device)
                metrics[-1]["eps_sup"] = torchrun.mean(eps)
            if torchrun.number() == 0:
                _keep(task, scratch, optimiser, metrics)
            progress.measured(task.title, metrics[-1])
            bar.advance(1, f"loss {loss:.2e}, ε sup {metrics[-1]['eps_sup']:.2e}")
    if config.eps and not _reached(config, metrics):
        got = f"{metrics[-1]['eps_sup']:.2g} after {config.epochs} epochs"
        progress.note(f"{task.title}: expected ε sup {config.eps:g}, got {got}; raise epochs, the sizes or eps")
    return metrics


def _reached(config: Training, metrics: Metrics) -> bool:
    """Whether the stated error is reached at the end of a cycle: within one the rate is high, and the error is not the
    network's best.
    """
    return bool(config.eps) and len(metrics) in cycle_ends(config) and metrics[-1]["eps_sup"] <= config.eps


def _keep(task: Fit, scratch: Path, optimiser: torch.optim.Optimizer, metrics: Metrics) -> None:
    """The snapshot and the checkpoint after an epoch, if they are due."""
    if len(metrics) in task.config.snapshots:
        io.save_weights(scratch / io.weights(len(metrics)), task.operator)
    if len(metrics) % task.config.checkpoint_every == 0:
        checkpoint.save(scratch, task.operator, optimiser, metrics)


def _optimiser(operator: Operator, config: Training) -> torch.optim.Optimizer:
    """SOAP, or Adam [Kingma and Ba 2015]."""
    if config.optimiser == "soap":
        return SOAP(operator.parameters(), config.lr, config.weight_decay)
    return torch.optim.Adam(operator.parameters(), lr=config.lr, weight_decay=config.weight_decay, fused=True)


def _epoch(task: Fit, network: Operator, optimiser: torch.optim.Optimizer, epoch: int, bar: Any) -> float:
    """The mean loss of one pass over the rows in a random order, each batch shared by the processes, if several."""
    config, count = task.config, len(task.train)
    shuffle = torch.Generator().manual_seed(randomness.integer(task.seed, "order", epoch))
    total = torch.zeros((), device=task.test.X.device)
    for step, rows in enumerate(task.train.batches(shuffle, config.batch)):
        for group in optimiser.param_groups:
            group["lr"] = rate(config, epoch - 1 + step * config.batch / count)
        rows_here, weight = torchrun.part(len(rows))
        part = rows[rows_here]
        loss = weight * task.loss(network(part.X, part.u, part.D_hat, part.phase, REST_NODES, part.stride), part.P)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        total += loss.detach() * len(rows)
        bar.advance(0)  # Ctrl-C in another thread ends this one here
    mean = torchrun.mean(total) / count
    if not math.isfinite(mean):
        raise DivergedError(
            f"{task.title}: expected a finite loss, got {mean} in epoch {epoch}; lower lr={config.lr:g}"
        )
    return mean


def rate(config: Training, epochs: float) -> float:
    """The learning rate after so many epochs, a fraction allowed.

    one-cycle [Smith and Topin 2018]: up in a straight line, down along a cosine; with config.eps several times, each
    twice as long [warm restarts, Loshchilov and Hutter 2017]. step: halved every 50 epochs [DAPF].
    """
    if config.schedule == "step":
        return config.lr * 0.5 ** (int(epochs) // 50)
    ends = [0, *cycle_ends(config)]
    start, end = next(pair for pair in pairwise(ends) if epochs < pair[1] or pair[1] == ends[-1])
    done = (epochs - start) / (end - start)
    if done < WARM_UP:
        return config.lr * (0.04 + 0.96 * done / WARM_UP)
    return config.lr * (1e-4 + 0.5 * (1 + math.cos(math.pi * (done - WARM_UP) / (1 - WARM_UP))))


def cycle_ends(config: Training) -> list[int]:
    """The epochs after which the one-cycle rate has come down: the last one, or with config.eps also some before."""
    count = CYCLES if config.eps else 1
    return sorted({math.ceil(config.epochs * (2**k - 1) / (2**count - 1)) for k in range(1, count + 1)})


@torch.no_grad()
def errors(operator: Operator, rows: Rows) -> dict[str, float]:
    """mse, the mean square of P_hat - P in raw units, and eps_sup = sup |P_hat - P| (Euclid), over rows and nodes."""
    squares, sup = 0.0, 0.0
    for start in range(0, len(rows), CHUNK):
        part = rows[start : start + CHUNK]
        square = (operator(part.X, part.u, part.D_hat, part.phase) - part.P).square()
        squares += float(square.sum(dtype=torch.float64))
        sup = max(sup, float(square.sum(-1).max()))
    return {"mse": squares / rows.P.numel(), "eps_sup": math.sqrt(sup)}
