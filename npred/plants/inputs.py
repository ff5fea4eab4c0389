"""The inputs of a plant: the range of each, and their values before t = 0."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import TypeAlias, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from npred.base import array_checks, source_lines
from npred.base.errors import ConfigError, unlisted
from npred.plants.base import Plant
from npred.plants.speed import long

EQUILIBRIUM, LAW = "equilibrium", "law"  # the inputs before t = 0 that have a name
ROUNDING = 1e-9  # share of an input: this close to a bound it is on it
SPARE = 10.0  # times the largest |kappa| on the box, which loops leave in their transients
DRAWN, MOMENTS = 1024, 16  # states of the box, and times of a law that depends on time


def bounds(plant: Plant, bounds: ArrayLike | None) -> np.ndarray:
    """The range of each input, (m, 2): those given, else the plant's, else none. One input's pair may stand alone."""
    pairs = plant.input_bounds if bounds is None else bounds
    if pairs is None:
        pairs = [(-np.inf, np.inf)] * plant.m
    array = array_checks.floats("input_bounds", pairs)
    array = array[None] if array.shape == (2,) else array
    if array.shape != (plant.m, 2):
        names = ", ".join(plant.inputs)
        raise ConfigError(f"input_bounds: expected a pair (low, high) for each of {names}, got {pairs}; give {plant.m}")
    for name, (low, high) in zip(plant.inputs, array.tolist(), strict=True):
        if not low <= high:
            raise ConfigError(f"input_bounds: expected low <= high for {name}, got ({low:g}, {high:g}); swap them")
    return array


def widest(plant: Plant, limits: np.ndarray) -> np.ndarray:
    """The limits (m, 2); where they leave a controller's input free, SPARE times the largest |kappa| on the box.

    One wrong sample can make kappa larger than any actuator, or any model of the plant, is made for. Infinite still for
    a plant without a box.
    """
    if np.isfinite(limits).all() or set(plant.box) != set(plant.states):
        return limits
    return np.where(np.isfinite(limits), limits, np.outer(_largest(plant), [-1.0, 1.0]))


@cache
def _largest(plant: Plant) -> np.ndarray:
    X = plant.drawn("largest kappa", DRAWN)
    moments = [0.0] if plant.rests else np.linspace(0.0, long(plant), MOMENTS)
    with np.errstate(all="ignore"):
        U = np.abs([plant.kappa(X, t) for t in moments])
    largest = np.where(np.isfinite(U), U, 0.0).max(axis=(0, 1))
    return np.array([float(f"{SPARE * u:.2g}") if u > 0 else np.inf for u in largest])


Given: TypeAlias = ArrayLike | Callable[[float], ArrayLike] | None  # u0 as it was given; None is the default
Start: TypeAlias = np.ndarray | str | Callable[[float], ArrayLike]  # numbers (m,), a table (k, m), a word, a function


@dataclass(frozen=True)
class Past:
    """The input of each loop before t = 0: constant, `held` (B, m), or a course over the last `span` (B,).

    A course is a table (k, m), its rows held for span / k each, the oldest first and before all of them too, or a
    function of t < 0.
    """

    held: np.ndarray
    span: np.ndarray = field(default_factory=lambda: np.zeros(1))
    course: np.ndarray | Callable[[float], ArrayLike] | None = None
    limits: np.ndarray | None = None

    def of(self, loops: slice) -> "Past":
        """The inputs of some of the loops."""
        return Past(self.held[loops], self.span[loops], self.course, self.limits)

    def steps(self, count: int, dt: float) -> np.ndarray:
        """The mean input of the last `count` control steps before t = 0, the oldest first: (count, m, B)."""
        constant = np.broadcast_to(self.held.T, (count, *self.held.T.shape))
        if self.course is None:
            return constant
        if callable(self.course):
            return np.stack([self._at((k + 0.5) * dt) for k in range(-count, 0)])[:, :, None] + 0.0 * constant
        edges = np.arange(-count, 1)[:, None] * dt  # ends of the control steps
        position = len(self.course) * (1.0 + edges / np.maximum(self.span, np.finfo(float).tiny))  # in rows, (., B)
        row = np.clip(np.floor(position).astype(int), 0, len(self.course) - 1)
        sums = np.concatenate([np.zeros((1, self.course.shape[1])), np.cumsum(self.course, axis=0)])
        # the rows' sum up to a position, whole and parts, (., B, m); below 0 the first row goes on
        total = sums[row] + (position - row)[..., None] * self.course[row]
        means = (total[1:] - total[:-1]) / np.diff(position, axis=0)[..., None]
        return np.moveaxis(means, -1, 1)

    def _at(self, t: float) -> np.ndarray:
        """The function's input at t. Raises ConfigError for another shape, or a value outside the limits."""
        assert callable(self.course) and self.limits is not None
        value = array_checks.floats(f"u0({t:g})", self.course(t))
        m, got, expected = len(self.limits), f"got {value.tolist()}", f"u0({t:g}): expected"
        if not array_checks.fits(value.shape, (m,)) or not np.isfinite(value).all():
            raise ConfigError(f"{expected} {m} finite numbers, one per input, {got}; return them")
        value = np.broadcast_to(value, (m,))
        if not _inside(value, self.limits):
            raise ConfigError(f"{expected} within input_bounds {self.limits.tolist()}, {got}; stay")
        return value


def start(plant: Plant, u0: Given, limits: np.ndarray) -> Start:
    """u0, the input before t = 0, with its default filled in: numbers (m,), a table (k, m), a function, "equilibrium"
    or "law".

    By default it is that of the plant's rest, which the first commands then do not disturb; of a plant without one, or
    whose rest needs an input outside the limits (m, 2), it is 0. Where these do not allow 0 for every input, it is that
    of the law at its target at t = 0, as for "equilibrium".
    Raises ConfigError for other words, a wrong count, values that are not finite or that lie outside the limits.
    """
    if callable(u0):
        return u0
    if u0 is None:
        zero, held = np.zeros(plant.m), _held(plant)
        u0 = zero if _inside(zero, limits) and (held is None or not _inside(held, limits)) else EQUILIBRIUM
    if isinstance(u0, str):
        if u0 not in (EQUILIBRIUM, LAW):
            raise ConfigError(unlisted("u0", u0, (EQUILIBRIUM, LAW), "numbers or one of"))
        return u0
    array = array_checks.floats("u0", u0)
    is_table = array.ndim == 2 and array.shape[0] > 0 and array.shape[1] == plant.m
    if not (is_table or array_checks.fits(array.shape, (plant.m,))) or not np.isfinite(array).all():
        raise ConfigError(f"u0: expected a finite number per input ({', '.join(plant.inputs)}), got {u0}; give as many")
    if is_table:
        return np.stack([_accepted(plant, row, limits, "") for row in array])
    return _accepted(plant, np.broadcast_to(array, (plant.m,)), limits, "")


def configured(plant: Plant, u0: Given, input_bounds: ArrayLike | None, stage: str) -> Start:
    """The `start` of a stage's loops. Raises ConfigError, naming the stage's table, also where nothing rests."""
    try:
        limits = bounds(plant, input_bounds)
        commands = start(plant, u0, limits)
        if isinstance(commands, str) and commands == EQUILIBRIUM:
            _at_rest(plant, limits)
    except ConfigError as error:
        raise ConfigError(f"{stage}.{error}") from None
    return commands


def past(plant: Plant, u0: Given, limits: np.ndarray, X0: np.ndarray, span: np.ndarray) -> Past:
    """The inputs of loops before t = 0, for starts X0 (B, n) and the delays `span` (B,) over which a table u0 extends.

    Raises ConfigError as `start` does, and where there is no equilibrium.
    """
    value = start(plant, u0, limits)
    if callable(value) or _is_table(value):
        return Past(np.zeros((len(X0), plant.m)), span, value, limits)
    return Past(before(plant, u0, limits, X0), span)


def rows_of(plant: Plant, u0: Given, limits: np.ndarray, X0: np.ndarray) -> np.ndarray:
    """The `before` of each start; of a history, its rows in turn: for questions about constant inputs, (B, m)."""
    value = start(plant, u0, limits)
    if _is_table(value):
        return value[np.arange(len(X0)) % len(value)]
    return before(plant, u0, limits, X0)


def before(plant: Plant, u0: Given, limits: np.ndarray, X0: np.ndarray) -> np.ndarray:
    """The constant input of each loop before t = 0, (B, m), for starts X0 (B, n) and limits (m, 2).

    The numbers of u0; kappa(X*), or kappa of the reference at t = 0, for "equilibrium"; for "law" kappa(X0, 0) within
    the limits, as if the controller had been on with the plant held at X0.
    Raises ConfigError as `start` does, for a history, and where there is no equilibrium.
    """
    value = start(plant, u0, limits)
    if callable(value) or _is_table(value):
        raise ConfigError("u0: expected a constant input, got a history; give numbers, or a word")
    if isinstance(value, str) and value == LAW:
        with np.errstate(all="ignore"):  # a loop that starts where kappa is undefined is NaN from the start
            return np.clip(plant.kappa(X0, 0.0), *limits.T)
    if isinstance(value, str):
        value = _at_rest(plant, limits)
    return np.array(np.broadcast_to(value, (len(X0), plant.m)))


def sentence(plant: Plant, u0: Given, limits: np.ndarray) -> str:
    """u0 in words: q = 0, or q = 0.5 of the rest, or kappa(X0, 0)."""
    value = start(plant, u0, limits)
    if _is_table(value):
        return f"a history of {len(value)} rows"
    if isinstance(value, str):
        at_rest = None if value == LAW else source_lines.values(plant.inputs, _at_rest(plant, limits))
        return f"{at_rest} of the rest" if at_rest else "kappa(X0, 0)"
    assert isinstance(value, np.ndarray)
    return source_lines.values(plant.inputs, value)


@lru_cache(maxsize=128)
def _held(plant: Plant) -> np.ndarray | None:
    """The input (m,) at the plant's rest; None where it has none."""
    try:
        return plant.rest and plant.rest[1]
    except ConfigError:
        return None


def _is_table(value: object) -> TypeGuard[np.ndarray]:
    return isinstance(value, np.ndarray) and value.ndim == 2


def _at_rest(plant: Plant, limits: np.ndarray) -> np.ndarray:
    """The input at rest, or at the reference at t = 0, (m,)."""
    try:
        u = plant.u_target(0.0)
    except ConfigError as error:
        raise ConfigError(f"u0: expected a rest to take it from, got: {error}; or give u0 as numbers") from None
    return _accepted(plant, u, limits, "that of the rest, ")


def _accepted(plant: Plant, u: np.ndarray, limits: np.ndarray, which: str) -> np.ndarray:
    """u (m,), rounding errors beyond the limits removed."""
    if not _inside(u, limits):
        got = f"{which}{source_lines.values(plant.inputs, u)}; give u0, the input at t < 0, within"
        raise ConfigError(f"u0: expected within input_bounds {limits.tolist()}, got {got}")
    return np.clip(u, *limits.T) + 0.0  # no -0.0


def _inside(u: np.ndarray, limits: np.ndarray) -> bool:
    slack = ROUNDING * np.abs(u)
    return bool((u >= limits[:, 0] - slack).all() and (u <= limits[:, 1] + slack).all())
