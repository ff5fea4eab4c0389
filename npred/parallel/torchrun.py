"""The processes that torchrun starts to train one network: rank 0 runs npred, the others only compute gradients."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from threading import Event, Lock
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

if TYPE_CHECKING:
    import torch

LAUNCHED = "TORCHELASTIC_RUN_ID"  # torchrun says so; a WORLD_SIZE alone may be anybody's
PATIENCE = timedelta(days=7)  # the helpers wait while rank 0 makes the data; torchrun ends them where it fails
Module = TypeVar("Module", bound="torch.nn.Module")
_TURN, _BUSY = Lock(), Event()  # one training after the other, whatever the threads of rank 0


def count() -> int:
    """The number of processes: torchrun's WORLD_SIZE, 1 without torchrun."""
    return int(os.environ["WORLD_SIZE"]) if LAUNCHED in os.environ else 1


def number() -> int:
    """The number of this process: torchrun's RANK."""
    return int(os.environ.get("RANK", "0")) if count() > 1 else 0


def device(asked: str) -> str:
    """The device of this process: each process takes another GPU of the machine."""
    return f"cuda:{os.environ.get('LOCAL_RANK', '0')}" if count() > 1 and asked.startswith("cuda") else asked


def join() -> None:
    """Meet the other processes, if there are any."""
    if count() > 1:
        import torch
        from torch import distributed

        distributed.init_process_group("cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo", timeout=PATIENCE)


@contextmanager
def together(order: Any) -> Iterator[None]:
    """The work that the helpers do at the same time, once they `receive` the order."""
    if count() == 1 or number() > 0:
        yield
        return
    with _TURN:
        _BUSY.set()
        _broadcast(order)
        yield
        _BUSY.clear()  # not after a failure: the helpers are in the middle of it then


def receive() -> Any:
    """The next order of rank 0, or None where it has no more."""
    return _broadcast(None)


def dismiss() -> None:
    """Tell the helpers that no order follows. Those of a work that failed are left to torchrun, which ends them."""
    if count() > 1 and not _BUSY.is_set():
        from torch import distributed

        _broadcast(None)
        distributed.destroy_process_group()


def leave(code: int) -> NoReturn:
    """End this process at once. gloo's threads outlive its group, and one that frees a tensor while the interpreter is
    taken down aborts the process, which torchrun takes for a failure of them all.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def shared(module: Module) -> Module:
    """The module with gradients averaged over all processes; alone, the module."""
    if count() == 1:
        return module
    from torch.nn.parallel import DistributedDataParallel

    return DistributedDataParallel(module)  # type: ignore[return-value]


def part(rows: int) -> tuple[slice, float]:
    """The rows of a batch that are this process's, and their weight: the mean over the processes of weight times
    the mean over a part is the mean over the batch. A process without a row takes one, of no weight.
    """
    mine = len(range(number(), rows, count()))
    return (slice(number(), None, count()) if mine else slice(0, 1)), mine * count() / rows


def mean(value: "torch.Tensor") -> float:
    """The mean of a number over all processes."""
    if count() > 1:
        from torch import distributed

        distributed.all_reduce(value)
    return float(value) / count()


def _broadcast(order: Any) -> Any:
    import torch
    from torch import distributed

    box = [order]
    distributed.broadcast_object_list(box, src=0, device=torch.device("cpu"))
    return box[0]
