"""The mathematics M that plant functions use, on NumPy arrays and on torch tensors."""

import math
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

NUMPY = SimpleNamespace(
    pi=math.pi, sin=np.sin, cos=np.cos, tan=np.tan, exp=np.exp, log=np.log, sqrt=np.sqrt, tanh=np.tanh, abs=np.abs,
    sign=np.sign, where=np.where, maximum=np.maximum, minimum=np.minimum,
)  # fmt: skip


def of(array: Any) -> SimpleNamespace:
    """The mathematics of an array's kind; torch is not imported unless the array is a tensor."""
    return _torch() if type(array).__module__.split(".")[0] == "torch" else NUMPY


def stack(components: list[Any], like: Any) -> Any:
    """Components broadcast to the shape of `like` and stacked as the last axis."""
    if of(like) is NUMPY:
        return np.stack([np.broadcast_to(c, like.shape) for c in components], axis=-1)
    import torch

    return torch.stack(
        [torch.as_tensor(c, dtype=like.dtype, device=like.device).expand_as(like) for c in components], -1
    )


@cache
def _torch() -> SimpleNamespace:
    import torch

    def pair(function: Any) -> Any:
        """torch.maximum and minimum want two tensors; plant functions also give numbers."""
        return lambda a, b: function(*torch.broadcast_tensors(_tensor(a, b), _tensor(b, a)))

    def _tensor(a: Any, like: Any) -> Any:
        return a if isinstance(a, torch.Tensor) else torch.as_tensor(a, dtype=like.dtype, device=like.device)

    return SimpleNamespace(
        pi=math.pi, sin=torch.sin, cos=torch.cos, tan=torch.tan, exp=torch.exp, log=torch.log, sqrt=torch.sqrt,
        tanh=torch.tanh, abs=torch.abs, sign=torch.sign, where=torch.where, maximum=pair(torch.maximum),
        minimum=pair(torch.minimum),
    )  # fmt: skip
