"""f as the formulas of implicit methods take it: with its derivatives, and with a plant's mechanics, on one tape."""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred.symbolic import programs
from npred.symbolic.tape import Symbol
from npred.symbolic.trace import Mechanics, Trace


class Flow:
    """f(x, u, t) of a trace, which implicit steps read more of than its values."""

    def __init__(self, trace: Trace) -> None:
        self.trace = trace

    def __call__(self, x: np.ndarray, u: np.ndarray, t: Any) -> np.ndarray:
        return self.trace.f(x, u, t)

    def mechanics(self, x: np.ndarray, u: np.ndarray, t: Any) -> Mechanics:
        """The plant's mechanics there."""
        return self.trace.mechanics(x, u, t)


def linearised(
    f: Callable[..., Any], x: np.ndarray, u: np.ndarray, t: Any, du: np.ndarray | None, dt: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """f (n,), f_X (n, n) and its change f_U du + f_t dt (n,) at symbols x, u, t; without du the inputs are constant.

    What vanishes by structure is the number 0, so that programs leave it out.
    """
    y = f(x, u, t)
    units = np.eye(len(x)).tolist()
    columns = [programs.derivative(y, x, unit) for unit in units]
    moving = [] if du is None else list(zip(u, du, strict=True))
    moving += [(t, dt)] if isinstance(t, Symbol) else []
    change = programs.derivative(y, *zip(*moving, strict=True)) if moving else [0.0] * len(y)
    return np.asarray(y), np.array(columns, dtype=object).T, np.array(change, dtype=object)
