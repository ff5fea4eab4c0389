"""The mathematics M that plant functions use, on NumPy arrays and on torch tensors."""

import math
from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from npred.formulas import Array, Value, ldl

NUMPY = SimpleNamespace(
    pi=math.pi, sin=np.sin, cos=np.cos, tan=np.tan, exp=np.exp, log=np.log, sqrt=np.sqrt, tanh=np.tanh, abs=np.abs,
    sign=np.sign, where=np.where, maximum=np.maximum, minimum=np.minimum, solve=ldl.solve,
)  # fmt: skip


def of(array: Array) -> SimpleNamespace:
    """The mathematics of an array's kind; torch is not imported unless the array is a tensor."""
    return _torch() if type(array).__module__.split(".")[0] == "torch" else NUMPY


def taken(value: Any) -> Any:
    """A list or tuple of numbers as an array, anything else as it is."""
    return np.asarray(value, dtype=float) if isinstance(value, list | tuple) else value


def stack(components: list[Value], like: Array) -> Array:
    """Components broadcast to the shape of `like` and stacked as the last axis."""
    if of(like) is NUMPY:
        stacked = np.empty((*like.shape, len(components)))
        for k, component in enumerate(components):  # np.stack of broadcast ones takes four times as long
            stacked[..., k] = component
        return stacked
    import torch

    return torch.stack(
        [torch.as_tensor(c, dtype=like.dtype, device=like.device).expand_as(like) for c in components], -1
    )


@cache
def _torch() -> SimpleNamespace:
    import torch

    def on(function: Callable[..., torch.Tensor]) -> Callable[..., torch.Tensor]:
        """torch's functions want tensors; plant functions also give numbers: a parameter, the time, a constant."""

        def call(*args: Value) -> torch.Tensor:
            like = next((a for a in args if isinstance(a, torch.Tensor) and a.dtype != torch.bool), None)
            return function(*(_tensor(a, like) for a in args))

        return call

    def _tensor(a: Value, like: torch.Tensor | None) -> torch.Tensor:
        match a:
            case torch.Tensor():
                return a
            case bool() | np.bool_():
                return torch.as_tensor(a, dtype=torch.bool)
        dtype, device = (torch.float64, None) if like is None else (like.dtype, like.device)
        return torch.as_tensor(a, dtype=dtype, device=device)

    names = [name for name in vars(NUMPY) if name not in ("pi", "solve")]
    return SimpleNamespace(pi=math.pi, solve=ldl.solve, **{name: on(getattr(torch, name)) for name in names})
