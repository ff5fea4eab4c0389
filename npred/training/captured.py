"""The passes over the rows as CUDA graphs: forward, backward and optimiser of a batch are one launch.

Several networks of the same shapes, as of a sweep over seeds, train side by side in the same graphs.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from typing import Any

import torch
from torch import Tensor
from torch.func import functional_call, stack_module_state, vmap

from npred.parallel import torchrun
from npred.training.cuda_graph import Text, record
from npred.training.eager import rate, shuffled
from npred.training.rows import REST_NODES, Fit, Rows
from npred.training.stacked_optimisers import NetworkState, StackedAdam, StackedSOAP

CHUNK = 8192  # rows of a call without gradients, of all networks together
OPTIMISERS = {"soap": StackedSOAP, "adam": StackedAdam}
ALL = slice(None)


def serves(device: str) -> bool:
    """True where graphs are tried: on one GPU, in one process."""
    return device.startswith("cuda") and torchrun.count() == 1


def alike(task: Fit) -> tuple[object, ...] | None:
    """Equal for networks that one graph can train side by side; None for one that trains alone.

    Seeds, data and weights may differ. Trainings to a stated error end each at its own time.
    """
    if task.config.eps or not isinstance(task.train, Rows):
        return None
    tensors = [*task.operator.state_dict().values(), *_columns(task.train), *_columns(task.test)]
    return repr(task.config), type(task.operator.network), *(tuple(tensor.shape) for tensor in tensors)


class Captured:
    """The steps of one network, or of several side by side; `lr` is the rate of the last one.

    The rows of all lie behind each other; a batch is an index into them, (b,), or (networks, b). Rows that are
    streamed come through a buffer of one batch.
    """

    def __init__(self, tasks: Sequence[Fit]) -> None:
        self.tasks, self.config, self.lr = tasks, tasks[0].config, 0.0
        self.device = tasks[0].test.X.device
        self.operators, self.count = [task.operator for task in tasks], len(tasks[0].train)
        self.stacked = len(tasks) > 1
        self.parameters, self.buffers = stack_module_state(list(self.operators)) if self.stacked else ({}, {})
        leaves = list(self.parameters.values()) if self.stacked else list(self.operators[0].parameters())
        stacked = len(tasks) if self.stacked else None
        self.optimiser = OPTIMISERS[self.config.optimiser](leaves, self.config.weight_decay, stacked)
        self.loss = tasks[0].loss
        if self.stacked:
            self.loss = replace(self.loss, weights=torch.stack([task.loss.weights for task in tasks])[:, None, None])
        self.leaves, self.texts = leaves, dict[int, Text]()
        self.total, self.most = (torch.zeros(len(tasks), device=self.device) for _ in range(2))
        self.squares = torch.zeros(len(tasks), dtype=torch.float64, device=self.device)
        tests = [task.test for task in tasks]
        self.test = Rows(*map(torch.stack, zip(*map(_columns, tests), strict=True))) if self.stacked else tests[0]

    def state(self, network: int) -> NetworkState:
        """What a checkpoint saves and restores beside the network."""
        return self.optimiser.of(network)

    def begin(self) -> None:
        """Be ready, the checkpoints being restored. Raises what `record` raises; all is as it was then."""
        self._copy(into_stack=True)
        self.step = int(self.optimiser.steps)
        sizes = {min(self.config.batch, self.count), self.count % self.config.batch} - {0}
        self._make_room(max(sizes))
        with self._as_it_was():
            pool = None
            for size in sorted(sizes, reverse=True):
                self.texts[size], pool = record(lambda index=self.index[size]: self._step(index), self.device, pool)
            self.measure, _ = record(self._measure, self.device, pool)

    def epoch(self, number: int, bar: Any) -> list[float]:
        """The mean loss of one pass over the rows in a random order, by network."""
        self.total.zero_()
        for step, size in enumerate(self._put(number)):
            self.lr = rate(self.config, number - 1 + step * self.config.batch / self.count)
            self.optimiser.set_rate(self.lr)
            self.texts[size]()
            self.step += 1
            self.optimiser.turn(self.step)
            bar.advance(0)  # Ctrl-C in another thread ends this one here
        self._copy(into_stack=False)
        return [total / self.count for total in self.total.tolist()]

    def errors(self) -> list[dict[str, float]]:
        """By network npred.training.eager.errors, to rounding."""
        self.measure()
        of_one = self.tasks[0].test.P.numel()
        pairs = zip(self.squares.tolist(), self.most.tolist(), strict=True)
        return [{"mse": squares / of_one, "eps_sup": math.sqrt(most)} for squares, most in pairs]

    def _make_room(self, size: int) -> None:
        """The rows, and by size of a batch the tensor that its index is put into."""
        rows = [task.train for task in self.tasks if isinstance(task.train, Rows)]
        if rows:
            self.source = Rows.joined(rows) if self.stacked else rows[0]
        else:
            first = next(self.tasks[0].train.batches(shuffled(self.tasks[0], 1), size))
            self.source = Rows(*(column.clone() for column in _columns(first)))
        self.streams = not rows
        lead = (len(self.tasks),) if self.stacked else ()
        sizes = {size, self.count % self.config.batch} - {0}
        self.index = {n: torch.arange(n, device=self.device).expand(*lead, n).contiguous() for n in sizes}

    def _put(self, epoch: int) -> Iterator[int]:
        """The sizes of the batches of an epoch, each being in its place."""
        if self.streams:
            for rows in self.tasks[0].train.batches(shuffled(self.tasks[0], epoch), self.config.batch):
                for place, column in zip(_columns(self.source), _columns(rows), strict=True):
                    place[: len(rows)].copy_(column)
                yield len(rows)
            return
        orders = [
            torch.randperm(self.count, generator=shuffled(task, epoch)) + number * self.count
            for number, task in enumerate(self.tasks)
        ]
        whole = (torch.stack(orders) if self.stacked else orders[0]).to(self.device)
        for index in whole.split(self.config.batch, dim=-1):
            size = index.shape[-1]
            self.index[size].copy_(index)
            yield size

    def _step(self, index: Tensor) -> None:
        """The text of a step: the loss of the batch, its gradients, the optimiser."""
        part = self.source[index]
        losses = self.loss(self._answer(part, REST_NODES, self.source.stride), part.P)
        self.optimiser.update(torch.autograd.grad(losses.sum(), self.leaves))
        self.total += losses.detach() * index.shape[-1]

    @torch.no_grad()
    def _measure(self) -> None:
        """The text of the errors: sum |P_hat - P|^2, and its largest over rows and nodes, by network."""
        self.squares.zero_()
        self.most.zero_()
        share = max(CHUNK // len(self.tasks), 1)
        for start in range(0, len(self.tasks[0].test), share):
            rows = slice(start, start + share)
            part = self.test[(ALL, rows)] if self.stacked else self.test[rows]
            square = (self._answer(part) - part.P).square()
            self.squares += square.sum((-3, -2, -1), dtype=torch.float64)
            self.most.copy_(torch.maximum(self.most, square.sum(-1).amax((-2, -1))))

    def _answer(self, rows: Rows, rest_nodes: int | None = None, stride: int = 1) -> Tensor:
        """P_hat of the rows, (b, nodes, n), or of each network (networks, b, nodes, n)."""
        inputs = rows.X, rows.u, rows.D_hat, *(() if rows.phase is None else (rows.phase,))
        if not self.stacked:
            return self.operators[0](*inputs, rest_nodes=rest_nodes, stride=stride)

        def one(parameters: dict[str, Tensor], buffers: dict[str, Tensor], *inputs: Tensor) -> Tensor:
            keywords = {"rest_nodes": rest_nodes, "stride": stride}
            return functional_call(self.operators[0], (parameters, buffers), inputs, keywords)

        return vmap(one, randomness="different")(self.parameters, self.buffers, *inputs)

    @torch.no_grad()
    def _copy(self, into_stack: bool) -> None:
        """The weights and buffers of each network into the stack, or out of it."""
        for network, operator in enumerate(self.operators if self.stacked else []):
            of_one = dict(operator.named_parameters()) | dict(operator.named_buffers())
            for name, stack in (self.parameters | self.buffers).items():
                (stack[network] if into_stack else of_one[name]).copy_(of_one[name] if into_stack else stack[network])

    @contextmanager
    def _as_it_was(self) -> Iterator[None]:
        """Weights, buffers, the optimiser and the generator of random numbers after the block as before it."""
        buffers = self.buffers.values() if self.stacked else self.operators[0].buffers()
        tensors = [*self.leaves, *buffers, *self.optimiser.tensors()]
        with torch.no_grad():
            kept = [tensor.detach().clone() for tensor in tensors]
        drawn = torch.cuda.get_rng_state(self.device) if self.device.type == "cuda" else torch.get_rng_state()
        try:
            yield
        finally:
            with torch.no_grad():
                for tensor, before in zip(tensors, kept, strict=True):
                    tensor.copy_(before)
            if self.device.type == "cuda":
                torch.cuda.set_rng_state(drawn, self.device)
            else:
                torch.set_rng_state(drawn)


def _columns(rows: Rows) -> list[Tensor]:
    return [column for field in fields(rows) if (column := getattr(rows, field.name)) is not None]
