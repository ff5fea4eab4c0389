"""The mathematics M that plant functions use, on NumPy arrays and on torch tensors."""

import math
from collections.abc import Callable, Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from npred.formulas import Array, Value, ldl, tables
from npred.formulas.tape import FUNCTIONS

NUMPY = SimpleNamespace(
    pi=math.pi, interp=tables.interp, solve=ldl.solve,
    **{name: getattr(np, name) for name in (*FUNCTIONS, "clip", "where")},
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

    def interp(
        x: Value, xp: Sequence[float], fp: Sequence[float], kind: str = "linear", derivative: int = 0
    ) -> torch.Tensor:
        x = _tensor(x, None)
        rows = _tensor(tables.table(xp, fp, kind, derivative).rows, x)
        starts = rows[:, 0]
        k = (x.detach()[..., None] >= starts[1:]).sum(-1)  # ONNX has no search
        return tables.polynomial(x.clip(starts[0], starts[-1]) - starts[k], rows[k, 1:])

    functions = {name: getattr(torch, name) for name in (*FUNCTIONS, "clip", "where") if name != "mod"}
    functions |= {"mod": torch.remainder}  # which has the sign of the divisor, as NumPy's
    return SimpleNamespace(
        pi=math.pi, interp=interp, solve=ldl.solve, **{name: on(function) for name, function in functions.items()}
    )
