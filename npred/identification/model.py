"""Rollouts of a plant from given states through the pieces of a log, with their derivatives.

The parameters theta are some of the plant's and, behind these, offsets that are added to the inputs. With `lag` each
input passes a first-order lag first, a' = (u - a) / tau, whose state at the begin of a segment is given.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from npred import plants
from npred.formulas import programs, tape
from npred.formulas.called_functions import LONG, operations
from npred.formulas.trace import Trace, python
from npred.identification.log import Pieces
from npred.kernels import formula, kernel
from npred.kernels.formula import vector
from npred.plants import Plant
from npred.prediction.methods.runge_kutta import RK4

ROLLOUT = "k, X, held, spans, moments, p, &P"
STEP = 1e-6  # relative step of a difference


@dataclass(frozen=True)
class RolloutModel:
    """The plant as it is fitted: theta are the parameters `free`, by their places in (p, offsets)."""

    plant: Plant
    free: tuple[int, ...]
    lag: bool = False
    steps: int = 1  # RK4's steps in a piece

    @property
    def _alike(self) -> "RolloutModel":
        """The same model whatever its steps are, which keeps the kernels."""
        return _alike(self.plant, self.free, self.lag)

    def parameters(self, theta: np.ndarray) -> np.ndarray:
        """The plant's parameters and the offsets, with theta in place."""
        p = np.append(self.plant.p, np.zeros(self.plant.m))
        p[list(self.free)] = theta
        return p

    def run(self, X: np.ndarray, theta: np.ndarray, pieces: Pieces, lag: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """The states (S, K, n) of the samples from X (S, n), and their derivatives (S, K, n, n + q) by X and theta.

        `lag` are the states of the lags at the begin of each segment (S, m), and tau (m,).
        """
        with np.errstate(all="ignore"):
            return (self._exact if self._alike._short else self._differences)(X, theta, pieces, lag)

    @cached_property
    def _short(self) -> bool:
        """True if f is a formula that is short enough for exact derivatives."""
        return self.plant.traced and operations(self.plant, "f") <= LONG

    def _exact(self, X: np.ndarray, theta: np.ndarray, pieces: Pieces, lag: Any) -> tuple[np.ndarray, np.ndarray]:
        n, columns = self.plant.n, self.plant.n + len(self.free)
        begin = np.zeros((n * (1 + columns) + self.plant.m * self.lag, len(X)))
        begin[:n] = X.T
        for k in range(n):
            begin[n + k * n + k] = 1.0
        p, begin = self._with_lag(self.parameters(theta), begin, lag)
        P = self._sampled(self._alike._sensitive, begin, p, pieces)
        return P[..., :n], P[..., n : n * (1 + columns)].reshape(*P.shape[:2], columns, n).swapaxes(-1, -2)

    def _differences(self, X: np.ndarray, theta: np.ndarray, pieces: Pieces, lag: Any) -> tuple[np.ndarray, np.ndarray]:
        """The same by forward differences, for formulas that are long and for functions that are called."""
        base = self.states(X, theta, pieces, lag)
        columns = []
        for k in range(self.plant.n):
            change = STEP * (1.0 + np.abs(X[:, k]))
            moved = X.copy()
            moved[:, k] += change
            columns.append((self.states(moved, theta, pieces, lag) - base) / change[:, None, None])
        for k in range(len(self.free)):
            change = STEP * (1.0 + abs(theta[k]))
            columns.append((self.states(X, theta + change * np.eye(len(theta))[k], pieces, lag) - base) / change)
        return base, np.stack(columns, axis=-1)

    def states(self, X: np.ndarray, theta: np.ndarray, pieces: Pieces, lag: Any = None) -> np.ndarray:
        """The states of the samples alone."""
        p, begin = self._with_lag(self.parameters(theta), np.ascontiguousarray(X.T), lag)
        run = self._alike._plain if self.plant.traced else self._called
        return self._sampled(run, begin, p, pieces)[..., : self.plant.n]

    def _with_lag(self, p: np.ndarray, begin: np.ndarray, lag: Any) -> tuple[np.ndarray, np.ndarray]:
        """The parameters with tau behind them, and the begin with the lags' states as its last rows."""
        if not self.lag:
            return p, begin
        states, tau = lag
        rows = len(begin) if len(begin) == self.plant.n else len(begin) - self.plant.m
        return np.append(p, tau), np.concatenate([begin[:rows], states.T])

    def _sampled(self, run: Any, begin: np.ndarray, p: np.ndarray, pieces: Pieces) -> np.ndarray:
        P = np.empty((len(pieces.spans), *begin.shape))
        run(self.steps, np.ascontiguousarray(begin), pieces.held, pieces.spans, pieces.moments, p, P)
        every = np.concatenate([begin[None], P])
        return every[pieces.rows, :, np.arange(begin.shape[1])[:, None]]

    @cached_property
    def _sensitive(self) -> Any:
        trace, step = self._step(self.plant.n * (1 + self.plant.n + len(self.free)))
        x, n = trace.vector("x", self.plant.n), self.plant.n
        y, a = step(x)
        theta = [trace.input(f"p{k}") for k in self.free]
        S = trace.vector("x", n * (1 + n + len(theta)))[n:].reshape(-1, n)
        units = [*np.zeros((n, len(theta))), *np.eye(len(theta))]
        columns = [programs.derivative(y, [*x, *theta], [*s, *e]) for s, e in zip(S, units, strict=True)]
        return self._kernel([*y, *(v for column in columns for v in column), *a])

    @cached_property
    def _plain(self) -> Any:
        trace, step = self._step(self.plant.n)
        y, a = step(trace.vector("x", self.plant.n))
        return self._kernel([*y, *a])

    def _step(self, before: int) -> tuple[Trace, Any]:
        """A trace, and RK4's step on it; the states of the lags are those behind `before`."""
        trace, plant = Trace(self.plant), self.plant
        u, t, h = trace.vector("u", plant.m), trace.input("t"), trace.input("h")
        d = np.array([trace.input(f"p{len(plant.p) + k}") for k in range(plant.m)], dtype=object)
        if not self.lag:
            return trace, lambda x: (plant.stopped(RK4.step(trace.f, x, u + d, u + d, u + d, t, h), tape.M), [])
        behind = len(plant.p) + plant.m
        tau = np.array([trace.input(f"p{behind + k}") for k in range(plant.m)], dtype=object)
        a = trace.vector("x", before + plant.m)[before:]
        half = np.array([tape.M.exp(-0.5 * h / each) for each in tau], dtype=object)
        am, a1 = u + (a - u) * half, u + (a - u) * (half * half)
        return trace, lambda x: (plant.stopped(RK4.step(trace.f, x, a + d, am + d, a1 + d, t, h), tape.M), a1)

    def _kernel(self, outputs: Sequence[Any]) -> kernel.Kernel:
        size, count = len(outputs), len(self.plant.p) + self.plant.m * (1 + self.lag)
        arguments = [vector("x", size, "wide"), vector("u", self.plant.m), "t", "h"]
        text = formula.function("{name}", outputs, arguments, {"y": size}, count, "wide")
        sizes = {"N": size, "M": self.plant.m}
        return kernel.made("rollout", ROLLOUT, kernel.skeleton("rollout.h"), {"STEP": text}, sizes)

    def _called(
        self, k: int, X: np.ndarray, held: np.ndarray, spans: np.ndarray, moments: np.ndarray, p: np.ndarray,
        P: np.ndarray,
    ) -> None:  # fmt: skip
        """The same rollouts by a plant's functions of arrays, lanes first."""
        n, m, count = self.plant.n, self.plant.m, len(self.plant.p)
        named = tuple(zip(self.plant.parameters, p[:count].tolist(), strict=True))
        plant, d = plants.varied(self.plant, named), p[count : count + m]
        x, a = X[:n].T, X[n:].T

        def f(x: np.ndarray, u: np.ndarray, t: np.ndarray) -> np.ndarray:
            return plant.f(x, u, np.ravel(t))

        for row, (u, span, begin) in enumerate(zip(held, spans, moments, strict=True)):
            h = span / k
            half = np.exp(-0.5 * h[:, None] / p[count + m :]) if self.lag else 0.0
            for s in range(k):
                ends = [u.T + (a - u.T) * share if self.lag else u.T for share in (1.0, half, half * half)]
                first, middle, last = (end + d for end in ends)
                x = RK4.step(f, x, first, middle, last, (begin + s * h)[:, None], h[:, None])
                a = ends[-1] if self.lag else a
            P[row] = np.concatenate([x, a], axis=1).T

    def outputs(self, x: np.ndarray, J: np.ndarray, t: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The outputs of states (..., n): these, or output(x, t, p, M) of the plant; with the derivatives.

        Outputs (..., q), and their derivatives (..., q, n + theta) from those of the states.
        """
        plant = self.plant
        if not plant.declares_output:
            return x, J
        q, n, count = len(plant.outputs), plant.n, len(plant.p)
        with np.errstate(all="ignore"):
            values = self._alike._measuring(*np.moveaxis(x, -1, 0), t, *p[:count])
        values = np.stack([np.broadcast_to(value, t.shape) for value in values], axis=-1)
        y, by_x = values[..., :q], values[..., q : q + q * n].reshape(*t.shape, n, q).swapaxes(-1, -2)
        G, theta = by_x @ J, [k for k, place in enumerate(self.free) if place < count]
        G[..., [n + k for k in theta]] += values[..., q + q * n :].reshape(*t.shape, -1, q).swapaxes(-1, -2)
        return y, G

    def measured_states(self, Y: np.ndarray) -> np.ndarray:
        """States (..., n) to begin with: the measured ones, and the plant's guess for the rest."""
        plant, X = self.plant, np.tile(self.plant.guess, (*Y.shape[:-1], 1))
        for k, name in enumerate(plant.outputs):
            if name in plant.states:
                j = plant.states.index(name)
                X[..., j] = np.where(np.isfinite(Y[..., k]), Y[..., k], X[..., j])
        return X

    @cached_property
    def _measuring(self) -> Any:
        """The outputs, and their derivatives by the states and by the parameters that are fitted."""
        trace, plant = Trace(self.plant), self.plant
        x, _, t = trace.symbols()
        y, by = trace.output(x, t), [*x, *(trace.parameters[k] for k in self.free if k < len(plant.p))]
        columns = [programs.derivative(y, by, unit) for unit in np.eye(len(by))]
        inputs = [*tape.names("x", plant.n), "t", *tape.names("p", len(plant.p))]
        return python([*y, *(v for column in columns for v in column)], inputs)


@lru_cache(maxsize=32)
def _alike(plant: Plant, free: tuple[int, ...], lag: bool) -> RolloutModel:
    return RolloutModel(plant, free, lag)
