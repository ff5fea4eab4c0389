"""The passes over the rows by eager operations: on the CPU, with torchrun, and where a graph fails.

The order of the rows and the learning rate are those of every training.
"""

import math
from itertools import pairwise
from typing import Any

import torch

from npred import randomness
from npred.config import Training
from npred.operators import Operator
from npred.parallel import torchrun
from npred.training.rows import REST_NODES, Fit, Rows
from npred.training.soap import SOAP

CHUNK = 1024  # rows of a call without gradients
WARM_UP = 0.05  # share of the steps in which the one-cycle rate climbs
CYCLES = 4  # of that rate in a training that may end before its last epoch, each twice as long as the one before


class Eager:
    """The steps of one network; `lr` is the rate of the last one."""

    def __init__(self, task: Fit) -> None:
        self.task, self.lr = task, 0.0
        parameters, config = task.operator.parameters(), task.config
        if config.optimiser == "soap":
            self.optimiser = SOAP(parameters, config.lr, config.weight_decay)
        else:  # [Kingma and Ba 2015]
            self.optimiser = torch.optim.Adam(parameters, config.lr, weight_decay=config.weight_decay, fused=True)

    def state(self, network: int) -> torch.optim.Optimizer:
        """What a checkpoint saves and restores beside the network."""
        return self.optimiser

    def begin(self) -> None:
        """Be ready, the checkpoint being restored."""
        self.network = torchrun.shared(self.task.operator)

    def epoch(self, number: int, bar: Any) -> list[float]:
        """The mean loss of one pass over the rows in a random order, each batch shared by the processes, if several."""
        task, config, count = self.task, self.task.config, len(self.task.train)
        total = torch.zeros((), device=task.test.X.device)
        for step, rows in enumerate(task.train.batches(shuffled(task, number), config.batch)):
            self.lr = rate(config, number - 1 + step * config.batch / count)
            for group in self.optimiser.param_groups:
                group["lr"] = self.lr
            rows_here, weight = torchrun.part(len(rows))
            part = rows[rows_here]
            P_hat = self.network(part.X, part.u, part.D_hat, part.phase, REST_NODES, part.stride)
            loss = weight * task.loss(P_hat, part.P)
            self.optimiser.zero_grad()
            loss.backward()
            self.optimiser.step()
            total += loss.detach() * len(rows)
            bar.advance(0)  # Ctrl-C in another thread ends this one here
        return [torchrun.mean(total) / count]

    def errors(self) -> list[dict[str, float]]:
        return [errors(self.task.operator, self.task.test)]


def shuffled(task: Fit, epoch: int) -> torch.Generator:
    """The generator of the order of the rows in an epoch."""
    return torch.Generator().manual_seed(randomness.integer(task.seed, "order", epoch))


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
