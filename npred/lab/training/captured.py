"""A step of training as CUDA graphs: forward, backward and optimiser of a batch are one launch."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from npred.lab.training.rows import Fit, Rows
from npred.lab.training.soap import EVERY, GraphSOAP

WARM_UP = 3  # runs before a capture: caches, workspaces and handles are made in them
CAPTURING = Lock()  # networks train side by side in threads, and one capture at a time is enough
READS = {  # operations that wait for the GPU, or whose shape its numbers decide
    "_local_scalar_dense", "equal", "nonzero", "masked_select", "_unique2", "unique_dim", "unique_consecutive",
    "bincount", "repeat_interleave",
}  # fmt: skip
Text = Callable[[], None]


def serves(device: str) -> bool:
    """True where graphs are tried: on a GPU."""
    return device.startswith("cuda")


class CapturedStep:
    """`step`, which takes a batch and returns its loss, as one CUDA graph for each size that a batch has.

    The graphs find the rows in their place: a batch is copied into a buffer. Raises what `record` raises where a graph
    cannot hold the step; weights, optimiser and random numbers are as before then.
    """

    def __init__(self, task: Fit, optimiser: torch.optim.Optimizer, step: Callable[[Rows], Tensor]) -> None:
        count, batch, device = len(task.train), task.config.batch, task.test.X.device
        sizes = sorted({min(batch, count), count % batch} - {0}, reverse=True)
        self.optimiser, self.step = optimiser, step
        self.buffer = next(task.train.batches(torch.Generator().manual_seed(0), sizes[0]))
        self.loss = torch.zeros((), device=device)
        self.done = int(optimiser.steps) if isinstance(optimiser, GraphSOAP) else 0
        self.graphs: dict[int, Text] = {}
        with _as_it_was(task.operator, optimiser, device):
            pool = None
            for size in sizes:
                self.graphs[size], pool = record(lambda size=size: self.text(size), device, pool)

    def __call__(self, rows: Rows) -> Tensor:
        """The loss of the batch, after a step along it."""
        for place, column in zip(self.buffer.columns, rows.columns, strict=True):
            place[: len(rows)].copy_(column)
        self.graphs[len(rows)]()
        self.done += 1
        if isinstance(self.optimiser, GraphSOAP) and self.done % EVERY == 0:
            self.optimiser.turn()
        return self.loss

    def text(self, size: int) -> None:
        """The graph's work: a step along the first rows of the buffer."""
        self.loss.copy_(self.step(self.buffer[:size]))


def record(text: Text, device: torch.device, pool: Any = None) -> tuple[Text, Any]:
    """A function with the effect of `text`, in one launch, and its memory pool, for graphs that take turns with it.

    The text is run to warm up, so that its tensors change. Raises NotCapturable, and what CUDA raises, where a graph
    cannot hold it. On the CPU it is the text itself.
    """
    with CAPTURING:
        text()  # fills the caches of constants, from the host's memory
        with OnDevice():
            text()
        if device.type != "cuda":
            return text, None
        side = torch.cuda.Stream(device)
        side.wait_stream(torch.cuda.current_stream(device))
        with torch.cuda.stream(side):
            for _ in range(WARM_UP):
                text()
        torch.cuda.current_stream(device).wait_stream(side)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, pool=pool, capture_error_mode="thread_local"):
            text()
        return graph.replay, graph.pool()


class NotCapturable(RuntimeError):
    """An operation that a CUDA graph cannot hold."""


class OnDevice(TorchDispatchMode):
    """In a block NotCapturable where the host reads a tensor, a shape hangs on numbers, or data change device."""

    def __torch_dispatch__(self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None) -> Any:
        name = func._schema.name.removeprefix("aten::")
        indices = [index for index in args[1] if index is not None] if name == "index" else []
        if name in READS or any(index.dtype in (torch.bool, torch.uint8) for index in indices):  # a mask's shape
            raise NotCapturable(f"{name} reads numbers of the GPU on the host")
        result = func(*args, **(kwargs or {}))
        if name in ("_to_copy", "copy_"):
            kinds = {a.device.type for a in tree_leaves((args, result)) if isinstance(a, torch.Tensor)}
            if len(kinds) > 1:
                raise NotCapturable(f"{name} takes data from {' to '.join(sorted(kinds))}")
        return result


@contextmanager
def _as_it_was(operator: torch.nn.Module, optimiser: torch.optim.Optimizer, device: torch.device) -> Iterator[None]:
    """Weights, buffers, the optimiser's state and the generator of random numbers after the block as before it."""
    drawn = torch.cuda.get_rng_state(device) if device.type == "cuda" else torch.get_rng_state()
    moments = [tensor for state in optimiser.state.values() for tensor in state.values()]
    kept = [(tensor, tensor.detach().clone()) for tensor in [*operator.parameters(), *operator.buffers(), *moments]]
    try:
        yield
    finally:
        with torch.no_grad():
            for state in optimiser.state.values():
                for tensor in state.values():  # those that Adam makes in its first step begin at zero
                    tensor.zero_()
            for tensor, before in kept:
                tensor.copy_(before)
        if device.type == "cuda":
            torch.cuda.set_rng_state(drawn, device)
        else:
            torch.set_rng_state(drawn)


@contextmanager
def own_stream(device: torch.device) -> Iterator[None]:
    """The launches of a block in a stream that nobody else waits in: networks that train in threads share the GPU."""
    if device.type != "cuda" or not torch.cuda.is_available():
        yield
        return
    before, stream = torch.cuda.current_stream(device), torch.cuda.Stream(device)
    stream.wait_stream(before)
    with torch.cuda.stream(stream):
        yield
    before.wait_stream(stream)
