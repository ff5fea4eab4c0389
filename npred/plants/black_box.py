"""A plant that cannot be traced, a rigid-body library say: NumPy callables in the same loop, slower."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from npred.base import json_files, registry
from npred.base.errors import ConfigError
from npred.formulas import Array, Parameters, Value
from npred.formulas.declared import RETURNS, Components, failure, parameters
from npred.formulas.tape import Functions
from npred.plants.base import Plant

STEP = 6e-6  # step of a central difference: the cube root of the machine epsilon balances its two errors
UNDEFINED = (ArithmeticError, ValueError)  # where arrays give NaN Python's floats raise these: overflow, a domain
Map = Callable[[np.ndarray], np.ndarray]
Argument = Any  # an argument of a declared function: rows, a time, or the parameters
TIMES = (0.0, 0.37, 1.93)  # at which functions are compared to see whether they depend on time


class BlackBox(Plant):
    """X' = f(X, U(t - D)) with f, kappa and V given as functions of arrays, which are called and never looked into.

    The declaration says `traced = False` and gives f(X, u, t, p) -> (B, n), kappa(X, t, p) -> (B, m) and V(X, t, p) ->
    (B,) for X (B, n), u (B, m), t a number or (B,), and p with the parameters' names; `reference(t, p)` takes t (B,)
    and gives (B, n). Optional are df(X, u, t, p, v) -> (B, n) and dkappa(X, t, p, v) -> (B, m), the derivatives by X
    along v (B, n), else taken by central differences, good to about 1e-9 of the function's size, as those by t are;
    rollout(X, u, D_hat, t, p) -> (B, nx, n), a simulator's own steps from X over u (B, nx, m) and D_hat (B,);
    `rests = False` for a law that comes to no rest, as one that walks; and `files`, paths whose content is part of the
    identity, as is that of the plant's file. All else is as for any Plant.
    Where a function overflows or leaves a domain by an exception, as math.pow does, that row is NaN.
    Raises ConfigError, in one line, for a function that fails or returns another shape, and for several delays.
    """

    traced: ClassVar[bool] = False

    def __init__(self, name: str, *parts: Any, **named_parts: Any):
        super().__init__(name, *parts, **named_parts)
        if self.source is None:
            raise ConfigError(f"plant {name}: traced = False expected a class in a file, as tank.py:Tank; write one")
        if not self.one_delay:
            what = f"expected one delay, plant {name} has delays {self.delays}"
            raise ConfigError(f"traced = False: {what}; trace the plant, or drop delays")

    def call(self, name: str, x: Components, u: Components, t: Value, p: Sequence[Value], M: Functions) -> list[Value]:
        return [*(self.f(np.array(x), np.array(u), t) if name == "f" else self.kappa(np.array(x), t))]

    def f(self, X: Array, u: Array, t: Value = 0.0) -> np.ndarray:
        return self._rows("f", self.n, t, X, u)

    def kappa(self, X: Array, t: Value = 0.0) -> np.ndarray:
        return self._rows("kappa", self.m, t, X)

    def V(self, X: Array, t: Value = 0.0) -> np.ndarray:
        return self._rows("V", None, t, X)

    def df(self, X: np.ndarray, u: np.ndarray, t: Value, v: np.ndarray, dt: float = 0.0) -> np.ndarray:
        """f_X v + f_t dt, (..., n): the change of f as X moves along v and t by dt, per unit."""
        by_time = dt * _rate(lambda at: self.f(X, u, at), t) if dt and not self.autonomous else 0.0
        if hasattr(self.declaration, "df"):
            return self._rows("df", self.n, t, X, u, last=v) + by_time
        return difference(lambda moved: self.f(moved, u, t), X, v) + by_time

    def dkappa(self, X: np.ndarray, t: Value, v: np.ndarray, dt: float = 0.0) -> np.ndarray:
        """kappa_X v + kappa_t dt, (..., m), likewise."""
        by_time = dt * _rate(lambda at: self.kappa(X, at), t) if dt and self._law_timed else 0.0
        if hasattr(self.declaration, "dkappa"):
            return self._rows("dkappa", self.m, t, X, last=v) + by_time
        return difference(lambda moved: self.kappa(moved, t), X, v) + by_time

    def rollout(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Value) -> np.ndarray:
        return self._declared("rollout", [X, u, D_hat, t, parameters(self)])

    def jacobians(self, X: np.ndarray, u: np.ndarray, t: Value = 0.0) -> tuple[np.ndarray, np.ndarray]:
        X, u = np.asarray(X, dtype=float), np.asarray(u, dtype=float)
        by_X = self.df(X, u, t, units(X))
        by_u = difference(lambda at: self.f(X, at, t), u, units(u))
        return np.moveaxis(by_X, 0, -1), np.moveaxis(by_u, 0, -1)

    def kappa_jacobian(self, X: np.ndarray, t: Value = 0.0) -> np.ndarray:
        X = np.asarray(X, dtype=float)
        return np.moveaxis(self.dkappa(X, t, units(X)), 0, -1)

    def _reference(self, t: np.ndarray) -> np.ndarray:
        return self._rows("reference", self.n, t)

    def _rows(
        self, name: str, size: int | None, t: Value, *arrays: ArrayLike, last: ArrayLike | None = None
    ) -> np.ndarray:
        """The declared function on arrays (..., k), seen by it as rows: (..., size), or (...) where size is None."""
        t, points = np.asarray(t, dtype=float), [np.asarray(a, dtype=float) for a in arrays]
        if any(a.shape[-1:] != (k,) for a, k in zip(points, (self.n, self.m), strict=False)):
            self._fits(*arrays)
        points += [] if last is None else [np.asarray(last, dtype=float)]
        shape = points[0].shape[:-1] if points else t.shape
        if len(shape) == 1 and t.shape in ((), shape) and all(a.shape[:-1] == shape for a in points):
            rows = [a.view() for a in points]  # loops call this often: no copies
        else:
            shape = np.broadcast_shapes(t.shape, *(a.shape[:-1] for a in points))
            rows = [np.broadcast_to(a, (*shape, a.shape[-1])).reshape(-1, a.shape[-1]) for a in points]
            t = np.broadcast_to(t, shape).reshape(-1) if t.ndim or not arrays else t
        for a in rows:
            a.flags.writeable = False
        arguments = [*rows[: len(arrays)], t, self._named_parameters, *rows[len(arrays) :]]
        count = len(rows[0]) if rows else t.size
        expected = (count,) if size is None else (count, size)
        try:
            values = self._declared(name, arguments)
        except UNDEFINED as error:
            values = self._one_by_one(name, arguments, expected, error)
        if values.shape != expected:
            what = f"expected to return shape {expected}, one row per loop, got {values.shape}"
            raise ConfigError(f"{self.location(name)} {what}; return {RETURNS.get(name, 'one value per component')}")
        return values.reshape(shape if size is None else (*shape, size))

    @cached_property
    def _named_parameters(self) -> Parameters:
        return parameters(self)

    @np.errstate(all="ignore")  # where it is not finite is for the caller to say, in words
    def _declared(self, name: str, arguments: list[Argument]) -> np.ndarray:
        """The declared function's values. Raises UNDEFINED as they come, and ConfigError for another failure."""
        try:
            return np.asarray(getattr(self.declaration, name)(*arguments), dtype=float)
        except (ConfigError, *UNDEFINED):
            raise
        except Exception as error:
            raise failure(self, name, error) from None

    def _one_by_one(self, name: str, arguments: list[Argument], shape: tuple[int, ...], error: Exception) -> np.ndarray:
        """The values row by row, NaN in those in which the function is undefined: one loop must not end the others.

        Raises ConfigError where it fails in every row and at the guess too, for that is no matter of the state.
        """
        values, defined = np.full(shape, np.nan), False
        batched = [isinstance(a, np.ndarray) and a.ndim > 0 for a in arguments]  # neither numbers nor the parameters
        for k in range(shape[0]):
            row = slice(k, k + 1)
            try:
                values[row] = self._declared(
                    name, [a[row] if b else a for a, b in zip(arguments, batched, strict=True)]
                )
                defined = True
            except UNDEFINED:
                continue
        if not defined:  # X at the guess, all else zero
            harmless = [np.zeros_like(a[:1]) if b else a for a, b in zip(arguments, batched, strict=True)]
            if batched[0] and arguments[0].ndim == 2:
                harmless[0] = self.guess[None]
            for a in (a for a, b in zip(harmless, batched, strict=True) if b):
                a.flags.writeable = False  # as in a loop: a function that writes to its arguments fails here already
            try:
                self._declared(name, harmless)
            except UNDEFINED:
                raise failure(self, name, error) from None
        return values

    @property
    def clocked(self) -> bool:
        return not self.autonomous

    @cached_property
    def rests(self) -> bool:
        return getattr(self.declaration, "rests", True) and Plant.rests.func(self)

    @property
    def rest(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The equilibrium; None where a reference is declared, for nobody can see whether it moves."""
        return (self.equilibrium, self.u_equilibrium) if self.rests else None

    @cached_property
    def _law_timed(self) -> bool:
        return self._timed("kappa")

    def _timed(self, name: str) -> bool:
        """True if f or kappa gives other values at other times, at a few states."""
        random = np.random.default_rng(0)
        X = self.guess + random.uniform(-0.5, 0.5, (4, self.n))
        u = random.uniform(-0.5, 0.5, (4, self.m))
        values = [self.f(X, u, t) if name == "f" else self.kappa(X, t) for t in TIMES]
        return not all(np.array_equal(values[0], later, equal_nan=True) for later in values[1:])

    @cached_property
    def program(self) -> Mapping[str, str]:
        """In place of formulas the digest of the plant's file, and of those that it reads, by name."""
        assert self.source is not None
        contents: dict[str, Any] = {}
        for path in map(Path, getattr(self.declaration, "files", ())):
            try:
                content = json_files.regular(path).read_bytes()
                read = registry.meaning(content) if path.suffix == ".py" else content
                contents.setdefault(f"files.{path.name}", hashlib.sha256()).update(read)
            except OSError as error:
                what = f"expected a file to read at {path}, got: {error.strerror}"
                raise ConfigError(f"plant {self.name}: files {what}; fix the path") from None
        return {"source": self.source.sha256} | {name: content.hexdigest() for name, content in contents.items()}


@np.errstate(all="ignore")
def difference(function: Map, X: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Central difference of the function of X (..., n) along v (..., n)."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    h = STEP * (1.0 + np.linalg.norm(X, axis=-1, keepdims=True)) / np.where(length > 0, length, 1.0)
    ahead, behind = function(np.stack([X + h * v, X - h * v]))  # one call: half as long, where a call is most of it
    return (ahead - behind) / (2 * h)


def units(X: np.ndarray) -> np.ndarray:
    """The unit directions (k, ..., k) of points X (..., k), in turn."""
    size = X.shape[-1]
    return np.eye(size).reshape(size, *(1,) * (X.ndim - 1), size)


def _rate(function: Map, t: Value) -> np.ndarray:
    """Central difference of the function of the time t, by the time between the two as they are rounded."""
    later, earlier = np.asarray(t) + STEP, np.asarray(t) - STEP
    return (function(later) - function(earlier)) / (later - earlier)[..., None]
