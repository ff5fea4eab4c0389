"""Intervals of numbers, so that a plant's program on them encloses its values: Moore, Interval Analysis, 1966.

Ends are arrays of one shape. Each operation's result is widened by a unit in the last place, so that rounding loses
nothing, the library's functions being as accurate as that.
"""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from npred.symbolic import programs, tape

EPS = np.finfo(float).eps


class Interval:
    """All numbers from `low` to `high`, arrays or floats."""

    __slots__ = ("high", "low")
    __array_priority__ = 1000  # NumPy leaves operations beside an array to this class

    def __init__(self, low: Any, high: Any) -> None:
        self.low, self.high = low, high

    def __add__(self, other: Any) -> "Interval":
        b = interval(other)
        return _widened(self.low + b.low, self.high + b.high)

    def __neg__(self) -> "Interval":
        return Interval(-self.high, -self.low)

    def __sub__(self, other: Any) -> "Interval":
        return self + -interval(other)

    def __mul__(self, other: Any) -> "Interval":
        if other is self:  # a square: [-1, 2]² is [0, 4]
            size = abs(self)
            return Interval(size.low * size.low * (1 - EPS), np.nextafter(size.high * size.high, np.inf))
        b = interval(other)
        return _hull(self.low * b.low, self.low * b.high, self.high * b.low, self.high * b.high)

    def __truediv__(self, other: Any) -> "Interval":
        b = interval(other)
        vanishes = (b.low <= 0) & (b.high >= 0)
        low, high = np.where(vanishes, 1.0, b.low), np.where(vanishes, 1.0, b.high)
        inverse = Interval(np.where(vanishes, -np.inf, 1 / high), np.where(vanishes, np.inf, 1 / low))
        return self * _widened(inverse.low, inverse.high)

    def __pow__(self, power: Any) -> "Interval":
        return exp(interval(power) * log(self))

    __radd__ = __add__
    __rmul__ = __mul__

    def __rsub__(self, other: Any) -> "Interval":
        return interval(other) - self

    def __rtruediv__(self, other: Any) -> "Interval":
        return interval(other) / self

    def __rpow__(self, other: Any) -> "Interval":
        return interval(other) ** self

    def __abs__(self) -> "Interval":
        nearest = np.maximum(0.0, np.maximum(self.low, -self.high))
        return Interval(nearest, np.maximum(-self.low, self.high))

    def __lt__(self, other: Any) -> "Interval":
        """[1, 1] where it holds for all, [0, 0] where for none, else [0, 1]."""
        b = interval(other)
        return Interval((self.high < b.low) * 1.0, (self.low < b.high) * 1.0)

    def __le__(self, other: Any) -> "Interval":
        b = interval(other)
        return Interval((self.high <= b.low) * 1.0, (self.low <= b.high) * 1.0)

    def __gt__(self, other: Any) -> "Interval":
        return interval(other) < self

    def __ge__(self, other: Any) -> "Interval":
        return interval(other) <= self


def interval(a: Any) -> Interval:
    """A number as the interval that holds it alone."""
    return a if isinstance(a, Interval) else Interval(a, a)


def _widened(low: Any, high: Any) -> Interval:
    return Interval(np.nextafter(low, -np.inf), np.nextafter(high, np.inf))


def _hull(*ends: Any) -> Interval:
    """The least interval around some numbers; all numbers where one of them is none, as 0 times infinity."""
    low, high = ends[0], ends[0]
    for end in ends[1:]:
        low, high = np.minimum(low, end), np.maximum(high, end)
    return _widened(np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high))


def _rising(function: Callable[[Any], Any], lowest: float = -np.inf) -> Callable[[Any], Interval]:
    """A function that rises from `lowest` on, on intervals; all numbers where the argument may be below."""

    def call(a: Any) -> Interval:
        a = interval(a)
        with np.errstate(all="ignore"):
            low, high = function(a.low), function(a.high)
        undefined = a.low < lowest
        return _widened(np.where(undefined, -np.inf, low), np.where(undefined, np.inf, high))

    return call


def cos(a: Any) -> Interval:
    """The cosine: its extremes are at whole multiples of pi."""
    a = interval(a)
    below, above = np.ceil(a.low / np.pi - 1e-12), np.floor(a.high / np.pi + 1e-12)
    both = above - below >= 1  # a maximum and a minimum
    even = (above == below) & (below % 2 == 0)
    odd = (above == below) & (below % 2 != 0)
    ends = np.cos(a.low), np.cos(a.high)
    low = np.where(both | odd, -1.0, np.minimum(*ends))
    return _widened(low, np.where(both | even, 1.0, np.maximum(*ends)))


def sin(a: Any) -> Interval:
    """The sine, by the cosine."""
    return cos(interval(a) - np.pi / 2)


def tan(a: Any) -> Interval:
    """The tangent: all numbers where the argument may pass a pole."""
    a = interval(a)
    passes = np.floor(a.low / np.pi + 0.5) != np.floor(a.high / np.pi + 0.5)
    low, high = np.tan(a.low), np.tan(a.high)
    return _widened(np.where(passes, -np.inf, low), np.where(passes, np.inf, high))


def where(condition: Any, a: Any, b: Any) -> Interval:
    """a where the condition holds for all, b where for none, else what holds both."""
    condition, a, b = interval(condition), interval(a), interval(b)
    always, never = condition.low > 0, condition.high <= 0
    low = np.where(always, a.low, np.where(never, b.low, np.minimum(a.low, b.low)))
    return Interval(low, np.where(always, a.high, np.where(never, b.high, np.maximum(a.high, b.high))))


def maximum(a: Any, b: Any) -> Interval:
    """The larger of two."""
    a, b = interval(a), interval(b)
    return Interval(np.maximum(a.low, b.low), np.maximum(a.high, b.high))


def minimum(a: Any, b: Any) -> Interval:
    """The smaller of two."""
    return -maximum(-interval(a), -interval(b))


exp, log = _rising(np.exp), _rising(np.log, 0.0)
sqrt, tanh, sign = _rising(np.sqrt, 0.0), _rising(np.tanh), _rising(np.sign)
FUNCTIONS = SimpleNamespace(
    sin=sin, cos=cos, tan=tan, exp=exp, log=log, sqrt=sqrt, tanh=tanh, abs=abs, sign=sign, where=where,
    maximum=maximum, minimum=minimum,
)  # fmt: skip
TEXTS = {
    name: f"M.{name}({', '.join(f'{{{k}}}' for k in range(op.arity))})"
    for name, op in tape.OPS.items()
    if hasattr(FUNCTIONS, name)
}


def program(outputs: tape.Vector, names: Sequence[str]) -> Callable[..., list[Any]]:
    """The program of some outputs as a function of the named inputs, intervals or numbers, to intervals or numbers."""
    targets = tape.names("y", len(outputs))
    lines = programs.lines(outputs, {}, targets, TEXTS)
    text = f"def function({', '.join(names)}):\n    " + "\n    ".join(lines) + f"\n    return [{', '.join(targets)}]"
    space: dict[str, Any] = {"M": FUNCTIONS, "np": np}
    exec(text, space)
    return space["function"]
