"""The base classes of predictors: maps from (X, u, D_hat) to P on the nodes of [0, 1]."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from npred.base import array_checks, source_lines
from npred.base.errors import ConfigError
from npred.base.notebook import InNotebook
from npred.formulas import Array, Value, called_functions
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.delays.problem import Step, rows
from npred.prediction.methods.single import SingleCalls

Flow: TypeAlias = Callable[..., Array]  # f(x, u, t); of an implicit step a Trace, which knows derivatives too


class Predictor(InNotebook, ABC):
    """P(x) = X + D_hat ∫₀ˣ f(P(y), u(y)) dy on nx uniform nodes, both ends in [DAPF, eq. 10].

    Call it with X (..., n), u (..., nx, m) and D_hat (...); P is (..., nx, n). The u of one sample with one
    input may be (nx,). `t` (...) is the time at x = 0, of use to plants that depend on time. A predictor that you write
    is a subclass with `predict`.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    nx : int, default 101
        Nodes on [0, 1], both ends included.

    Raises
    ------
    ConfigError
        Where the shapes do not fit the plant, nx is below 2, a number is not finite or a delay is negative.
    """

    name: ClassVar[str] = "predictor"
    guard: Any = None  # npred.prediction.delays.problem.GUARD, called after `lanes`, where a predictor is checked
    settings: Any = None  # numbers that `guard` reads

    def __init__(self, plant: Plant, nx: int = 101):
        if not isinstance(nx, int | np.integer) or nx < 2:
            raise ConfigError(f"nx: expected at least 2 nodes, both ends of [0, 1], got {nx!r}; dx = 0.01 is nx = 101")
        self.plant, self.nx = plant, int(nx)

    def __call__(self, X: ArrayLike, u: ArrayLike, D_hat: ArrayLike, t: ArrayLike = 0.0) -> np.ndarray:
        if (single := self._single) and (P := single(X, u, D_hat, t)) is not None:
            return P
        shape, rows = self._rows(X, u, D_hat, t)
        P = self._predicted(*rows)
        return P.reshape(*shape, *P.shape[1:])

    @cached_property
    def _single(self) -> SingleCalls | None:
        """The prepared calls of one sample, where the map is compiled."""
        return None

    def _rows(
        self, X: ArrayLike, u: ArrayLike, D_hat: ArrayLike, t: ArrayLike
    ) -> tuple[tuple[int, ...], tuple[np.ndarray, ...]]:
        """The shape of a batch, and X (B, n), u (B, nx, m), D_hat and t (B,) of it. Raises as a call does."""
        X, D_hat, t = (array_checks.floats(name, a) for name, a in (("X", X), ("D_hat", D_hat), ("t", t)))
        u = array_checks.nodes("u", u, self.plant.m)
        n, m = self.plant.n, self.plant.m
        if X.ndim < 1 or X.shape[-1] != n:
            raise ConfigError(f"X: expected shape (..., {n}) for plant {self.plant.name}, got {X.shape}; add the axis")
        if u.ndim < 2 or u.shape[-1] != m or u.shape[-2] < 2:
            cure = "one row per node, both ends in"
            raise ConfigError(f"u: expected shape (..., nx, {m}) with nx >= 2, got {u.shape}; {cure}")
        # the time of samples from elsewhere may be unknown, where nothing needs it
        for name, array in (("X", X), ("u", u), *([("t", t)] if self.plant.clocked else [])):
            array_checks.finite(name, array)
        array_checks.delays("D_hat", D_hat)
        shape = array_checks.batch(X=X.shape[:-1], u=u.shape[:-2], D_hat=D_hat.shape, t=t.shape)
        X = np.broadcast_to(X, (*shape, n)).reshape(-1, n)
        u = np.broadcast_to(u, (*shape, *u.shape[-2:])).reshape(-1, *u.shape[-2:])
        return shape, (X, u, *(np.broadcast_to(a, shape).reshape(-1) for a in (D_hat, t)))

    @property
    def compiled(self) -> bool:
        """True if the map, and its check, are compiled kernels."""
        return False

    @property
    def drifts(self) -> bool:
        """True if it may predict a plant of other parameters, as a network in Python: a kernel takes the loop's."""
        return not (self.compiled or self.guard is not None)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name!r} of plant {self.plant.name}, nx = {self.nx}>"

    def __getstate__(self) -> dict[str, Any]:
        """The state that pickle keeps: all but compiled and derived parts, which are made again on use."""
        return {k: v for k, v in vars(self).items() if not isinstance(getattr(type(self), k, None), cached_property)}

    @abstractmethod
    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray | float) -> np.ndarray:
        """P (B, nx, n) of X (B, n), u (B, nx, m), D_hat (B,), t (B,) or ()."""

    def lanes(self) -> Callable[..., None]:
        """The same map on the loop's memory, lanes innermost: problem.PREDICT of npred.prediction.delays."""

        def predict(X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: float, p: np.ndarray, P: np.ndarray) -> None:
            X, u, D_hat = rows(X, u, D_hat)
            P[:] = self._predicted(X, u, D_hat, t).transpose(1, 2, 0)

        return predict

    def _predicted(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray | float) -> np.ndarray:
        """P of `predict`. Raises ConfigError where its shape is another, which a loop would broadcast."""
        P, shape = self.predict(X, u, D_hat, t), (*u.shape[:2], self.plant.n)
        if not (isinstance(P, np.ndarray) and P.shape == shape):
            came = f"shape {P.shape}" if hasattr(P, "shape") else f"a {type(P).__name__}"
            raise ConfigError(f"{type(self).__name__}.predict: expected to return P {shape}, (B, nx, n), got {came}")
        return P


class Compiled(Predictor):
    """A predictor whose map is one compiled kernel."""

    order: ClassVar[int]

    @property
    def compiled(self) -> bool:
        return True

    @cached_property
    def kernel(self) -> Callable[..., None]:
        """The compiled map, from the disk where it was compiled before."""
        return self.compile()

    @abstractmethod
    def compile(self) -> Callable[..., None]:
        """Trace the formula and compile its kernel."""

    def on(self, nx: int) -> Callable[..., None]:
        """The compiled map for nx nodes: one for all of them, unless a subclass says otherwise."""
        return self.kernel

    def lanes(self) -> Callable[..., None]:
        return self.kernel

    @cached_property
    def _single(self) -> SingleCalls | None:
        if type(self).predict is not Compiled.predict:
            return None
        return SingleCalls(self.plant, self.plant.clocked, lambda nx: [(self.on(nx), (), 0)])

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray | float) -> np.ndarray:
        if not self.plant.clocked:
            return self._at(0.0, X, u, D_hat)
        if np.ndim(t) == 0:
            return self._at(float(t), X, u, D_hat)
        P = np.full((*u.shape[:2], self.plant.n), np.nan)  # that of a time that is NaN
        for moment in np.unique(t):  # the kernel takes one time per call
            rows = t == moment
            P[rows] = self._at(float(moment), X[rows], u[rows], D_hat[rows])
        return P

    def _at(self, t: float, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray) -> np.ndarray:
        P = np.empty((u.shape[1], self.plant.n, len(X)))
        X, u, D_hat = (np.array(a, order="C") for a in (X.T, u.transpose(1, 2, 0), D_hat))  # broadcasts are read-only
        self.on(len(u))(X, u, D_hat, t, self.plant.p, P)
        return P.transpose(2, 0, 1)


class OneStep(Compiled):
    """x_{j+1} = step(x_j): `step` is the method's formula on arrays, of the declared order for smooth u.

    `pair` tells the local error too, by `steps_of_pair` times the operations, unless the method is not `paired`.
    Raises ConfigError for a plant that the method does not serve.
    """

    steps_of_pair: ClassVar[int] = 3
    paired: ClassVar[bool] = True

    def __init__(self, plant: Plant, nx: int = 101):
        super().__init__(plant, nx)
        problem_of(plant).needs(self.name)

    @staticmethod
    @abstractmethod
    def step(f: Flow, x: Array, u0: Array, um: Array, u1: Array, t: Value, h: Value) -> Array:
        """x(t + h) from x(t), the input being u0, um, u1 at t, t + h/2, t + h."""

    @classmethod
    def pair(cls, f: Flow, x: Array, u0: Array, um: Array, u1: Array, t: Value, h: Value) -> tuple[Array, Array]:
        """x(t + h) by two steps of h / 2, and how far one of h is from it, of the order of a step's error."""
        halves = (u0, 0.5 * (u0 + um), um), (um, 0.5 * (um + u1), u1)
        middle = called_functions.stepped(f, cls.step, x, halves[0], t, 0.5 * h)
        end = called_functions.stepped(f, cls.step, middle, halves[1], t + 0.5 * h, 0.5 * h)
        return end, called_functions.stepped(f, cls.step, x, (u0, um, u1), t, h) - end

    @classmethod
    def shadow(cls) -> Step:
        """A step of `pair` plus its error times the last of the inputs, which the plant does not read."""

        @called_functions.composed
        def step(f: Flow, x: Array, u0: Array, um: Array, u1: Array, t: Value, h: Value) -> Array:
            y, error = cls.pair(f, x, u0[:-1], um[:-1], u1[:-1], t, h)
            return y + u0[-1] * error

        return step

    @classmethod
    def evaluations(cls) -> int:
        """Evaluations of f per step. Raises ConfigError, with the line, for a formula that fails or is no step."""
        times = []

        def f(x: Array, u: Array, t: Value) -> Array:
            times.append(t)
            return -x

        x, u, step = np.ones(2), np.zeros(1), f"predictor {cls.__name__}: step ({source_lines.line(cls.step)})"
        try:
            y = np.asarray(cls.step(f, x, u, u, u, 0.0, 0.1), dtype=float)
        except Exception as error:
            where, reason = source_lines.where(error, cls.step), source_lines.one_line(error)
            raise ConfigError(f"{step} failed{where}: {reason}; use array arithmetic alone") from None
        if y.shape != x.shape or not times:
            returned = f"{y.shape} after {len(times)} evaluations of f"
            expected = "expected to evaluate f and to return the state, shape (n,)"
            raise ConfigError(f"{step} {expected}, got {returned}; return x + h * f(x, u0, t), say")
        return len(times)

    def compile(self) -> Callable[..., None]:
        return problem_of(self.plant).sweep(self.step)

    def cells(self) -> Callable[..., None]:
        """The compiled map for inputs that are a straight line on each cell: problem.PREDICT with `cells`."""
        return problem_of(self.plant).sweep(self.step, cells=True)

    @classmethod
    def operations(cls, plant: Plant) -> int:
        """The operations of a step, counted in its program."""
        return called_functions.operations(plant, "step", cls.step)

    def call_operations(self, steps: int) -> int:
        """The operations of a call of so many steps."""
        return steps * self.operations(self.plant)
