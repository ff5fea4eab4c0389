"""A function on tensors that stay in their place as a CUDA graph: all its launches as one."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

WARM_UP = 3  # runs before a capture: caches, workspaces and handles are made in them
CAPTURING = Lock()  # networks train side by side in threads, and one capture at a time is enough
READS = {  # what waits for the GPU, or has a shape that its numbers decide
    "_local_scalar_dense", "equal", "nonzero", "masked_select", "_unique2", "unique_dim", "unique_consecutive",
    "bincount", "repeat_interleave",
}  # fmt: skip
Text = Callable[[], None]


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


def record(text: Text, device: torch.device, pool: Any = None) -> tuple[Text, Any]:
    """A function that does what `text` does, in one launch, and its memory pool, for graphs that take turns with it.

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
