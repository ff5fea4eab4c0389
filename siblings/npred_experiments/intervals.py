"""Intervals of numbers, so that a plant's program on them encloses its values: Moore, Interval Analysis, 1966.

NumPy's operators and functions take an Interval where they take an array (NEP 13 and 18), so that the same program
runs on both. Ends are arrays of one shape. Each operation's result is widened by a unit in the last place, so that
rounding loses nothing, the library's functions being as accurate as that.
"""

from collections.abc import Callable
from functools import reduce
from typing import Any, Union

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

EPS = np.finfo(float).eps
Ends = np.ndarray | float
Operand = Union["Interval", np.ndarray, float]


class Interval(NDArrayOperatorsMixin):
    """All numbers from `low` to `high`, arrays or floats."""

    __slots__ = ("high", "low")

    def __init__(self, low: Ends, high: Ends) -> None:
        self.low, self.high = low, high

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *operands: Operand) -> "Interval":
        if method != "__call__" or ufunc not in OPERATIONS:
            return NotImplemented
        return OPERATIONS[ufunc](*map(interval, operands))

    def __array_function__(self, function: Any, types: Any, operands: tuple[Operand, ...], _: Any) -> "Interval":
        return _where(*map(interval, operands)) if function is np.where else NotImplemented


def interval(a: Operand) -> Interval:
    """A number as the interval that holds it alone."""
    return a if isinstance(a, Interval) else Interval(a, a)


def _widened(low: Ends, high: Ends) -> Interval:
    return Interval(np.nextafter(low, -np.inf), np.nextafter(high, np.inf))


def _product(a: Interval, b: Interval) -> Interval:
    """The least interval around the products of ends; all numbers where one of them is none, as 0 times infinity."""
    if a is b:  # a square: [-1, 2]² is [0, 4]
        size = _size(a)
        return Interval(size.low * size.low * (1 - EPS), np.nextafter(size.high * size.high, np.inf))
    ends = (a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high)
    low, high = reduce(np.minimum, ends), reduce(np.maximum, ends)
    return _widened(np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high))


def _quotient(a: Interval, b: Interval) -> Interval:
    vanishes = (b.low <= 0) & (b.high >= 0)
    low, high = np.where(vanishes, 1.0, b.low), np.where(vanishes, 1.0, b.high)
    return _product(a, _widened(np.where(vanishes, -np.inf, 1 / high), np.where(vanishes, np.inf, 1 / low)))


def _size(a: Interval) -> Interval:
    nearest = np.maximum(0.0, np.maximum(a.low, -a.high))
    return Interval(nearest, np.maximum(-a.low, a.high))


def _before(test: np.ufunc) -> Callable[[Interval, Interval], Interval]:
    """a before b by `test`: [1, 1] where it holds for all, [0, 0] where for none, else [0, 1]."""
    return lambda a, b: Interval(test(a.high, b.low) * 1.0, test(a.low, b.high) * 1.0)


def _rising(function: np.ufunc, lowest: float = -np.inf) -> Callable[[Interval], Interval]:
    """A function that rises from `lowest` on, on intervals; all numbers where the argument may be below."""

    def call(a: Interval) -> Interval:
        with np.errstate(all="ignore"):
            low, high = function(a.low), function(a.high)
        undefined = a.low < lowest
        return _widened(np.where(undefined, -np.inf, low), np.where(undefined, np.inf, high))

    return call


def _cos(a: Interval) -> Interval:
    """The cosine: its extremes are at whole multiples of pi."""
    below, above = np.ceil(a.low / np.pi - 1e-12), np.floor(a.high / np.pi + 1e-12)
    both = above - below >= 1  # a maximum and a minimum
    even = (above == below) & (below % 2 == 0)
    odd = (above == below) & (below % 2 != 0)
    ends = np.cos(a.low), np.cos(a.high)
    low = np.where(both | odd, -1.0, np.minimum(*ends))
    return _widened(low, np.where(both | even, 1.0, np.maximum(*ends)))


def _tan(a: Interval) -> Interval:
    """The tangent: all numbers where the argument may pass a pole."""
    passes = np.floor(a.low / np.pi + 0.5) != np.floor(a.high / np.pi + 0.5)
    low, high = np.tan(a.low), np.tan(a.high)
    return _widened(np.where(passes, -np.inf, low), np.where(passes, np.inf, high))


def _where(condition: Interval, a: Interval, b: Interval) -> Interval:
    """a where the condition holds for all, b where for none, else the hull of both."""
    always, never = condition.low > 0, condition.high <= 0
    low = np.where(always, a.low, np.where(never, b.low, np.minimum(a.low, b.low)))
    return Interval(low, np.where(always, a.high, np.where(never, b.high, np.maximum(a.high, b.high))))


_exp, _log = _rising(np.exp), _rising(np.log, 0.0)
OPERATIONS: dict[np.ufunc, Callable[..., Interval]] = {
    np.add: lambda a, b: _widened(a.low + b.low, a.high + b.high),
    np.subtract: lambda a, b: _widened(a.low - b.high, a.high - b.low),
    np.negative: lambda a: Interval(-a.high, -a.low),
    np.multiply: _product,
    np.divide: _quotient,
    np.power: lambda a, b: _exp(_product(b, _log(a))),
    np.absolute: _size,
    np.less: _before(np.less),
    np.less_equal: _before(np.less_equal),
    np.greater: lambda a, b: _before(np.less)(b, a),
    np.greater_equal: lambda a, b: _before(np.less_equal)(b, a),
    np.maximum: lambda a, b: Interval(np.maximum(a.low, b.low), np.maximum(a.high, b.high)),
    np.minimum: lambda a, b: Interval(np.minimum(a.low, b.low), np.minimum(a.high, b.high)),
    np.sin: lambda a: _cos(_widened(a.low - np.pi / 2, a.high - np.pi / 2)),
    np.cos: _cos,
    np.tan: _tan,
    np.exp: _exp,
    np.log: _log,
    np.sqrt: _rising(np.sqrt, 0.0),
    np.tanh: _rising(np.tanh),
    np.sign: _rising(np.sign),
}
