"""A table of numbers as a function: straight lines from point to point, or a cubic spline, held beyond its ends."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from npred.base.errors import unlisted
from npred.formulas import Array

DEGREES = {"linear": 1, "cubic": 3}


@dataclass(frozen=True)
class Lookup:
    """The `derivative`-th derivative of the function through the points (xp, fp).

    Formatted it is the last arguments of M.interp, and with "c" those of `interpolated` in kernels/c/base.h.
    """

    xp: tuple[float, ...]
    fp: tuple[float, ...]
    kind: str = "linear"
    derivative: int = 0

    @property
    def degree(self) -> int:
        """That of its polynomials."""
        return DEGREES[self.kind] - self.derivative

    @cached_property
    def rows(self) -> np.ndarray:
        """(points + 1, 2 + degree): where each piece begins and its coefficients by powers of the distance from there.

        The first piece is what comes before the table, the last what comes after it.
        """
        x, y, none = np.array(self.xp), np.array(self.fp), np.zeros(1)
        h = np.diff(x)
        slopes = np.diff(y) / h
        coefficients = [y[[0, *range(len(y))]], np.r_[none, slopes, none]]
        if self.kind == "cubic":
            bends = _bends(h, slopes)
            before, after = bends[:-1], bends[1:]
            coefficients[1] = np.r_[none, slopes - h * (2 * before + after) / 6, none]
            coefficients += [np.r_[none, before / 2, none], np.r_[none, (after - before) / (6 * h), none]]
        for _ in range(self.derivative):
            coefficients = [k * c for k, c in enumerate(coefficients)][1:] or [np.zeros(len(x) + 1)]
        return np.column_stack([x[[0, *range(len(x))]], *coefficients])

    def __call__(self, x: Array) -> Array:
        """Its values at numbers or NumPy arrays."""
        k = np.searchsorted(self.rows[1:, 0], x, side="right")
        return polynomial(np.clip(x, self.xp[0], self.xp[-1]) - self.rows[k, 0], self.rows[k, 1:])

    def __format__(self, language: str) -> str:
        if not language:
            return f"{self.xp}, {self.fp}, {self.kind!r}, {self.derivative}"
        numbers = ", ".join(map(repr, self.rows.ravel().tolist()))
        return f"{len(self.rows)}, {self.rows.shape[1]}, {{{numbers}}}"


@lru_cache(maxsize=256)
def _checked(xp: tuple[float, ...], fp: tuple[float, ...], kind: str, derivative: int) -> Lookup:
    if kind not in DEGREES:
        raise ValueError(unlisted("M.interp: kind", kind, DEGREES))
    least = DEGREES[kind] + 1
    if len(xp) != len(fp) or len(xp) < least:
        got = f"got {len(xp)} and {len(fp)}"
        raise ValueError(f"M.interp: expected as many values as points, at least {least} if {kind}, {got}; give them")
    if not (np.isfinite([xp, fp]).all() and (np.diff(xp) > 0).all()):
        raise ValueError("M.interp: expected finite numbers, the points rising, got others; sort and clean the table")
    if derivative not in range(DEGREES[kind] + 1):
        raise ValueError(f"M.interp: expected a derivative of 0 to {DEGREES[kind]}, got {derivative!r}; choose one")
    return Lookup(xp, fp, kind, derivative)


def table(xp: Sequence[float], fp: Sequence[float], kind: str = "linear", derivative: int = 0) -> Lookup:
    """The table of such points and values. Raises ValueError for other than finite numbers, the points rising."""
    try:
        points, values = (tuple(np.asarray(numbers, dtype=float).tolist()) for numbers in (xp, fp))
        return _checked(points, values, kind, derivative)
    except TypeError:
        what = "M.interp: expected a table of numbers, got something else in it, a state or parameter say"
        raise TypeError(f"{what}; multiply what M.interp gives, or its argument, by that") from None


def interp(x: Array, xp: Sequence[float], fp: Sequence[float], kind: str = "linear", derivative: int = 0) -> Array:
    """M.interp on numbers and NumPy arrays."""
    return table(xp, fp, kind, derivative)(x)


def polynomial(s: Array, coefficients: Array) -> Array:
    """The polynomial of s (...) whose coefficients (..., k) are by rising powers; one of torch too."""
    value = coefficients[..., -1] + 0.0 * s
    for k in range(coefficients.shape[-1] - 2, -1, -1):
        value = value * s + coefficients[..., k]
    return value


def _bends(h: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The second derivatives (points,) of the spline whose third one does not jump at the second and last but one
    point, as SciPy's CubicSpline has it [de Boor, A Practical Guide to Splines, ch. IV].
    """
    low, middle, high = h[:-1].copy(), 2 * (h[:-1] + h[1:]), h[1:].copy()
    right = 6 * np.diff(slopes)
    first, last = h[0] / h[1], h[-1] / h[-2]  # the outer bends are straight lines through the two next to them
    middle[0], high[0] = middle[0] + h[0] * (1 + first), high[0] - h[0] * first
    middle[-1], low[-1] = middle[-1] + h[-1] * (1 + last), low[-1] - h[-1] * last
    for k in range(1, len(right)):
        share = low[k] / middle[k - 1]
        middle[k] -= share * high[k - 1]
        right[k] -= share * right[k - 1]
    bends = np.zeros(len(h) + 1)
    for k in range(len(right) - 1, -1, -1):
        bends[k + 1] = (right[k] - (high[k] * bends[k + 2] if k < len(right) - 1 else 0.0)) / middle[k]
    bends[0] = bends[1] + first * (bends[1] - bends[2])
    bends[-1] = bends[-2] + last * (bends[-2] - bends[-3])
    return bends
