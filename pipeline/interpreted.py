"""Predictors in plain Python to time the compiled ones beside: `baselines` below [bench], for no loop."""

import contextlib
import math
from abc import abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from npred import Predictor
from npred.base.errors import ConfigError
from npred.formulas import array_math
from npred.formulas.tape import names
from npred.formulas.trace import Trace, python
from npred.plants import Plant


class Interpreted(Predictor):
    """A predictor in plain Python, one sample after the other, for one delay. Raises ConfigError for other plants."""

    def __init__(self, plant: Plant, nx: int = 101):
        super().__init__(plant, nx)
        if not plant.one_delay or plant.declares_delay or plant.state_bounds:
            what = f"expected a plant with one constant delay and no state_bounds, plant {plant.name} is another"
            raise ConfigError(f"{self.name}: {what}; leave it out of bench.baselines")

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        return np.stack([self.one(*row) for row in zip(X, u, D_hat, np.broadcast_to(t, len(X)), strict=True)])

    @abstractmethod
    def one(self, X: np.ndarray, u: np.ndarray, D_hat: float, t: float) -> np.ndarray:
        """P (nx, n) of one X (n,), u (nx, m), D_hat."""


class Published(Interpreted):
    """The scheme that [DAPF, Table I] timed: at each node the whole integral so far is summed again, O(nx²).

    Written anew from that description, with the plant's f on NumPy numbers. Same values as Euler's method.
    """

    name = "published"

    def one(self, X: np.ndarray, u: np.ndarray, D_hat: float, t: float) -> np.ndarray:
        nx, dx, p = len(u), 1 / (len(u) - 1), self.plant.p
        P, F = np.empty((nx, self.plant.n)), np.empty((nx, self.plant.n))
        for j in range(nx):
            P[j] = X + D_hat * dx * np.sum(F[:j], axis=0)
            F[j] = self.plant.call("f", list(P[j]), list(u[j]), t + D_hat * dx * j, p, array_math.NUMPY)
        return P


class EulerPython(Interpreted):
    """Euler's method in plain Python on floats: the same values as `published` in linear time.

    Where Python's floats raise, the sine of infinity say, P is NaN from there on.
    """

    name = "euler_python"

    def one(self, X: np.ndarray, u: np.ndarray, D_hat: float, t: float) -> np.ndarray:
        f, p, h = self._f, self.plant.p.tolist(), float(D_hat) / (len(u) - 1)
        x = X.tolist()
        P = [x]
        with contextlib.suppress(ArithmeticError, ValueError):
            for j, inputs in enumerate(u[:-1].tolist()):
                x = [a + h * b for a, b in zip(x, f(*x, *inputs, t + h * j, *p), strict=True)]
                P.append(x)
        return np.array(P + [[np.nan] * self.plant.n] * (len(u) - len(P)))

    @cached_property
    def _f(self) -> Callable[..., list[float]]:
        n, m = self.plant.n, self.plant.m
        if not self.plant.traced:
            return lambda *values: self.plant.f(
                np.array(values[:n]), np.array(values[n : n + m]), values[n + m]
            ).tolist()
        trace = Trace(self.plant)
        values = trace.f(trace.vector("x", n), trace.vector("u", m), trace.input("t"))
        return python(values, [*names("x", n), *names("u", m), "t", *names("p", len(self.plant.p))], math)
