"""Calls of one sample at a time, as loops in Python make them: memory and pointers are prepared once per shape of u."""

import ctypes
import math
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from npred.kernels.kernel import Kernel, address

NUMBERS = (float, int, np.float64)
Chain = Callable[[int], Sequence[tuple[Any, Sequence[np.ndarray], int]] | None]


class Prepared:
    """Kernels one after the other on prepared memory, each of X, u, D_hat, t, p and `before`, P and scratch behind.

    X, u, D_hat and t stand side by side in `inputs`, so that one sum, a product with 1, tells whether all are finite.
    """

    def __init__(
        self, n: int, m: int, shape: tuple[int, ...], p: np.ndarray, chain: Sequence[tuple[Kernel, Any, int]]
    ) -> None:
        nx = shape[0]
        self.inputs = np.zeros(n + nx * m + 2)
        self.ones, self.P = np.ones_like(self.inputs), np.empty((nx, n, 1))
        self.X, u = self.inputs[:n], self.inputs[n:-2].reshape(nx, m)
        D_hat, t = self.inputs[-2:-1], ctypes.c_double.from_address(address(self.inputs[-1:]))
        head = self.X[:, None], u[:, :, None], D_hat, t, p
        self.u, self.answer = u.reshape(shape), self.P[:, :, 0]
        self.calls = [run.bound(*head, *before, self.P, *np.empty((count, 1))) for run, before, count in chain]

    def __call__(self, X: np.ndarray, u: np.ndarray, D_hat: float, t: float) -> np.ndarray | None:
        """P (nx, n); None for inputs that are not finite, or a negative delay."""
        self.X[:], self.u[:] = X, u
        self.inputs[-2], self.inputs[-1] = D_hat, t
        if not (D_hat >= 0.0 and math.isfinite(self.ones.dot(self.inputs))):
            return None
        for call in self.calls:
            call()
        return self.answer.copy()


class SingleCalls(threading.local):
    """The prepared calls of a predictor, others in each thread.

    `chain` gives the kernels for so many nodes with the arrays they take after p, and how many numbers they write
    after P; None where there are none. What is not one sample of float64 is not answered: the predictor's own path
    checks it, and says what is wrong with it.
    """

    def __init__(self, plant: Any, reads_time: bool, chain: Chain) -> None:
        self.shape, self.m, self.p, self.reads_time, self.chain = (plant.n,), plant.m, plant.p, reads_time, chain
        self.prepared: dict[tuple[int, ...], Prepared | None] = {}

    def __call__(self, X: Any, u: Any, D_hat: Any, t: Any) -> np.ndarray | None:
        if type(X) is not np.ndarray or type(u) is not np.ndarray or X.shape != self.shape:
            return None
        flat = type(D_hat) is np.ndarray and D_hat.ndim == 0 and D_hat.dtype.char == "d"
        delay: Any = D_hat.item() if flat else D_hat
        if type(delay) not in NUMBERS or type(t) not in NUMBERS or not X.dtype.char == u.dtype.char == "d":
            return None
        shape = u.shape
        if shape not in self.prepared:
            self.prepared[shape] = self._made(shape)
        call = self.prepared[shape]
        return call(X, u, delay, t if self.reads_time else 0.0) if call else None

    def _made(self, shape: tuple[int, ...]) -> Prepared | None:
        nx, m = (*shape, 1) if len(shape) == 1 else shape if len(shape) == 2 else (0, 0)
        chain = self.chain(nx) if m == self.m and nx > 1 else None
        if chain is None or not all(isinstance(run, Kernel) for run, *_ in chain):
            return None
        return Prepared(*self.shape, m, shape, self.p, chain)
