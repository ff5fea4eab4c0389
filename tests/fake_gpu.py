"""A device `cuda` for machines without one: its tensors lie in the CPU's memory, and torch treats them as a GPU's.

    with fake_gpu.FakeGpu(): ...

As with a GPU, what is computed from such a tensor is one too, it does not become a NumPy array until it is moved to the
CPU, and it does not meet the CPU's tensors, but numbers, indices and copies. A module's parameters are not told apart.
"""

from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves, tree_map

CUDA = torch.device("cuda")
MEET = {Tensor.__getitem__, Tensor.__setitem__, Tensor.copy_, Tensor.to}


class Away(Tensor):
    """A tensor on the device."""

    __module__ = "torch"  # as of any tensor
    __torch_function__ = torch._C._disabled_torch_function_impl


class FakeGpu(TorchFunctionMode):
    """The device, for a block."""

    def __torch_function__(self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        tensors = [a for a in tree_leaves((args, kwargs)) if isinstance(a, Tensor)]
        away = any(isinstance(a, Away) for a in tensors)
        if func == Tensor.device.__get__ and away:
            return CUDA
        if func in (Tensor.numpy, Tensor.__array__) and away:
            if not kwargs.pop("force", False):
                raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu() first")
            away = False
        here = [a for a in tensors if not isinstance(a, Away | torch.nn.Parameter) and a.ndim]
        if away and here and func not in MEET and func.__name__ not in ("__set__", "__get__"):
            raise RuntimeError(f"{func}: expected all tensors to be on the same device, found cuda:0 and cpu")
        if func.__name__ in ("device", "_parse_to"):  # of words, not of tensors
            return func(*args, **kwargs)
        args, kwargs, asked = _on_cpu(args, kwargs)
        if func is Tensor.to and len(tensors) == 2:  # to the device of the other
            asked = "cuda" if isinstance(tensors[1], Away) else "cpu"
        away = asked == "cuda" if asked else away and func is not Tensor.cpu
        result = func(*args, **kwargs)
        kind = Away if away else Tensor
        return tree_map(lambda a: a.as_subclass(kind) if {type(a), kind} == {Tensor, Away} else a, result)


def _on_cpu(args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[tuple[Any, ...], dict[str, Any], str]:
    """The arguments with the CPU for a device, and the type of the one that was asked for."""
    asked: list[str] = []

    def here(a: Any) -> Any:
        if isinstance(a, torch.device) or (isinstance(a, str) and a in ("cpu", "cuda")):
            asked.append(torch.device(a).type)
            return torch.device("cpu")
        return a

    return tuple(map(here, args)), {name: here(a) for name, a in kwargs.items()}, asked[0] if asked else ""
