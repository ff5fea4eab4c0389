"""The passes over the rows by eager operations: on the CPU, with torchrun, and where a graph fails."""

import math
from typing import Any

import torch

from npred import randomness
from npred.config import Training
from npred.operators import Operator
from npred.parallel import torchrun
from npred.training.rows import REST_NODES, Fit, Rows
from npred.training.schedule import rate
from npred.training.soap import SOAP

CHUNK = 1024  # rows of a call without gradients


class Eager:
    """The steps of one network; `lr` is the rate of the last one."""

    def __init__(self, task: Fit) -> None:
        self.task, self.lr = task, 0.0
        self.optimiser = _optimiser(task.operator, task.config)

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
        """Those of `errors` on the held-out rows."""
        return [errors(self.task.operator, self.task.test)]


def shuffled(task: Fit, epoch: int) -> torch.Generator:
    """The generator of the order of the rows in an epoch."""
    return torch.Generator().manual_seed(randomness.integer(task.seed, "order", epoch))


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


def _optimiser(operator: Operator, config: Training) -> torch.optim.Optimizer:
    """SOAP, or Adam [Kingma and Ba 2015]."""
    if config.optimiser == "soap":
        return SOAP(operator.parameters(), config.lr, config.weight_decay)
    return torch.optim.Adam(operator.parameters(), lr=config.lr, weight_decay=config.weight_decay, fused=True)
