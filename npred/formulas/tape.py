"""A small tape: an ordinary Python function, run on symbols, leaves its operations as nodes.

Equal operations share one node, and constants fold. programs.py turns a tape into programs. See docs/design.md for
why this and not a computer-algebra system.
"""

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from npred.base.errors import unlisted
from npred.formulas import Value, ldl, tables

Vector = Sequence[Value] | np.ndarray
Arguments = tuple[Any, ...]  # an operation's: symbols and numbers, and for some the name of an input or function


@dataclass(frozen=True)
class Op:
    """One operation: its value on floats, its text, and its tangent from arguments, value and argument tangents."""

    value: Callable[..., Any]
    text: str
    tangent: Callable[..., Any]


def _pow_tangent(a: Value, b: Value, y: Value, da: Value, db: Value) -> Value:
    by_base = b * a ** (b - 1) * da if nonzero(da) else 0.0
    return by_base + (y * M.log(a) * db if nonzero(db) else 0.0)


def _interp_tangent(a: Value, table: tables.Lookup, y: Value, da: Value, _: Value) -> Value:
    return _apply("interp", a, replace(table, derivative=table.derivative + 1)) * da if table.degree else 0.0


def _flat(*_: Value) -> float:
    return 0.0


OPS: dict[str, Op] = {
    "add": Op(operator.add, "{0} + {1}", lambda a, b, y, da, db: da + db),
    "sub": Op(operator.sub, "{0} - {1}", lambda a, b, y, da, db: da - db),
    "mul": Op(operator.mul, "{0} * {1}", lambda a, b, y, da, db: da * b + a * db),
    "div": Op(operator.truediv, "{0} / {1}", lambda a, b, y, da, db: (da - y * db) / b),
    "neg": Op(operator.neg, "-{0}", lambda a, y, da: -da),
    "pow": Op(operator.pow, "{0} ** {1}", _pow_tangent),
    "sqrt": Op(math.sqrt, "math.sqrt({0})", lambda a, y, da: da / (2 * y)),
    "exp": Op(math.exp, "math.exp({0})", lambda a, y, da: y * da),
    "log": Op(math.log, "math.log({0})", lambda a, y, da: da / a),
    "sin": Op(math.sin, "math.sin({0})", lambda a, y, da: M.cos(a) * da),
    "cos": Op(math.cos, "math.cos({0})", lambda a, y, da: -(M.sin(a) * da)),
    "tan": Op(math.tan, "math.tan({0})", lambda a, y, da: (1 + y * y) * da),
    "tanh": Op(math.tanh, "math.tanh({0})", lambda a, y, da: (1 - y * y) * da),
    "sinh": Op(math.sinh, "math.sinh({0})", lambda a, y, da: M.cosh(a) * da),
    "cosh": Op(math.cosh, "math.cosh({0})", lambda a, y, da: M.sinh(a) * da),
    "asin": Op(math.asin, "math.asin({0})", lambda a, y, da: da / M.sqrt((1 - a) * (1 + a))),
    "acos": Op(math.acos, "math.acos({0})", lambda a, y, da: -da / M.sqrt((1 - a) * (1 + a))),
    "atan": Op(math.atan, "math.atan({0})", lambda a, y, da: da / (1 + a * a)),
    "atan2": Op(math.atan2, "math.atan2({0}, {1})", lambda a, b, y, da, db: (b * da - a * db) / (a * a + b * b)),
    "floor": Op(lambda a: float(np.floor(a)), "np.floor({0})", _flat),
    "mod": Op(operator.mod, "{0} % {1}", lambda a, b, y, da, db: da - (a - y) / b * db),
    "abs": Op(abs, "abs({0})", lambda a, y, da: M.sign(a) * da),
    "sign": Op(lambda a: float((a > 0) - (a < 0)), "np.sign({0})", _flat),
    "lt": Op(operator.lt, "{0} < {1}", _flat),
    "le": Op(operator.le, "{0} <= {1}", _flat),
    "logical_and": Op(lambda a, b: bool(a and b), "bool({0} and {1})", _flat),
    "logical_or": Op(lambda a, b: bool(a or b), "bool({0} or {1})", _flat),
    "logical_not": Op(operator.not_, "not {0}", _flat),
    "where": Op(
        lambda c, a, b: a if c else b, "{1} if {0} else {2}", lambda c, a, b, y, dc, da, db: M.where(c, da, db)
    ),
    "maximum": Op(max, "max({0}, {1})", lambda a, b, y, da, db: M.where(b < a, da, db)),
    "minimum": Op(min, "min({0}, {1})", lambda a, b, y, da, db: M.where(a < b, da, db)),
    "interp": Op(lambda a, table: float(table(a)), "interp({0}, {1})", _interp_tangent),
}


def names(prefix: str, count: int) -> list[str]:
    """prefix0, prefix1, …"""
    return [f"{prefix}{k}" for k in range(count)]


class Tape:
    """The nodes of one trace, each an operation on earlier nodes or constants, stored once."""

    def __init__(self) -> None:
        self.nodes: list[tuple[str, Arguments]] = []
        self._index: dict[tuple[str, Arguments], int] = {}
        self._solved: dict[int, Solution] = {}
        self.networks: dict[str, Any] = {}  # npred.formulas.network.CalledNetwork by the names that they are called by

    def solve(self, A: Sequence[Vector], b: Vector) -> list[Value]:
        """y of A y = b, A symmetric positive definite; see ldl.solve. Its derivative takes the same factors."""
        before = len(self.nodes)
        L, inverse = ldl.factors([list(row) for row in A])
        y = ldl.back(L, inverse, list(b))
        solution = Solution(A, b, y, L, inverse)
        self._solved |= {a.index: solution for a in y if isinstance(a, Symbol) and a.index >= before}
        return y

    def solution(self, index: int) -> "Solution | None":
        """The system of equations whose solution the node is a component of."""
        return self._solved.get(index)

    def input(self, name: str) -> "Symbol":
        """The symbol of an input; its text is `name`."""
        return self.node("input", (name,))

    def inputs(self, prefix: str, count: int) -> list["Symbol"]:
        """The symbols prefix0, prefix1, …"""
        return list(map(self.input, names(prefix, count)))

    def apply(self, op: str, *args: Value) -> "Symbol | float":
        """The node op(args), folded to a number where all arguments are numbers and simplified by 0 and 1."""
        if not any(isinstance(a, Symbol) for a in args):
            return _fold(op, args)
        simple = _simplify(op, args)
        return self.node(op, args) if simple is None else simple

    def call(self, name: str, args: Vector, direct: int, size: int) -> list["Symbol"]:
        """The `size` results of a function compiled on its own, with the derivative `d<name>` by `direct` arguments."""
        called = self.node("call", (name, direct, *args))
        return [self.node("item", (called, k)) for k in range(size)]

    def called(self) -> list[str]:
        """The names of the functions that are called, each once."""
        return sorted({args[0] for op, args in self.nodes if op == "call"})

    def node(self, op: str, args: Arguments) -> "Symbol":
        """The node op(args) as it stands, stored once."""
        key = (op, tuple(a.index if isinstance(a, Symbol) else _constant(a) for a in args))
        if key not in self._index:
            self._index[key] = len(self.nodes)
            self.nodes.append((op, args))
        return Symbol(self, self._index[key])


@dataclass(frozen=True)
class Solution:
    """y of A y = b with the factors of A."""

    A: Sequence[Vector]
    b: Vector
    y: Vector
    L: list[list[Value]]
    inverse: list[Value]

    def tangent(self, tangents: dict[int, Value]) -> dict[int, Value]:
        """A dy = db - dA y: the tangents of y's nodes. Of A those on and below the diagonal, which gave the factors."""
        size = range(len(self.y))
        dA = [[tangent_of(self.A[max(i, j)][min(i, j)], tangents) for j in size] for i in size]
        turned = [ldl.total(a * y for a, y in zip(row, self.y, strict=True)) for row in dA]
        right = [tangent_of(b, tangents) - a for b, a in zip(self.b, turned, strict=True)]
        dy = ldl.back(self.L, self.inverse, right)
        return {y.index: change for y, change in zip(self.y, dy, strict=True) if isinstance(y, Symbol)}


def tangent_of(a: Value, tangents: dict[int, Value]) -> Value:
    """That of a node by its index, 0 of a number."""
    return tangents.get(a.index, 0.0) if isinstance(a, Symbol) else 0.0


def _constant(a: Value) -> tuple[str, Value]:
    return ("constant", a if isinstance(a, str | tables.Lookup) else float(a).hex())


def _fold(op: str, args: Arguments) -> float:
    try:
        return OPS[op].value(*args)
    except (ArithmeticError, ValueError):
        return math.nan


def nonzero(a: Value) -> bool:
    return isinstance(a, Symbol) or a != 0


def _is(a: Value, value: float) -> bool:
    return not isinstance(a, Symbol) and a == value


def _simplify(op: str, args: Arguments) -> Value:
    """The shorter equal of op(args), or None. Zero times anything is zero: derivatives are mostly zeros."""
    a, b = args[0], args[-1]
    if op in ("add", "sub") and _is(b, 0):
        return a
    if op == "add" and _is(a, 0):
        return b
    if op == "sub" and _is(a, 0):
        return -b
    if op == "mul" and (_is(a, 0) or _is(b, 0)):
        return 0.0
    if op == "mul" and _is(a, 1):
        return b
    if op in ("mul", "div") and _is(b, 1):
        return a
    if op == "div" and _is(a, 0):
        return 0.0
    if op == "where" and not isinstance(args[0], Symbol):
        return args[1] if args[0] else args[2]
    if op == "where" and _same(args[1], args[2]):
        return args[1]
    return None


def _same(a: Value, b: Value) -> bool:
    if isinstance(a, Symbol) and isinstance(b, Symbol):
        return a.index == b.index
    return not isinstance(a, Symbol) and not isinstance(b, Symbol) and a == b


def _both(op: str) -> tuple[Callable[["Symbol", Value], Value], Callable[["Symbol", Value], Value]]:
    """The methods of a symbol that stands before the operator, and of one that stands after it."""
    return lambda a, b: _binary(op, a, b), lambda a, b: _binary(op, b, a)


class Symbol:
    """A value that is not known yet. Arithmetic records; a decision on it (`if`, `max`, `float`) is refused."""

    __slots__ = ("index", "tape")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, tape: Tape, index: int) -> None:
        self.tape, self.index = tape, index

    __add__, __radd__ = _both("add")
    __sub__, __rsub__ = _both("sub")
    __mul__, __rmul__ = _both("mul")
    __truediv__, __rtruediv__ = _both("div")
    __mod__, __rmod__ = _both("mod")
    __lt__, __gt__ = _both("lt")
    __le__, __ge__ = _both("le")

    def __neg__(self) -> Value:
        return self.tape.apply("neg", self)

    def __pos__(self) -> Value:
        return self

    def __abs__(self) -> Value:
        return self.tape.apply("abs", self)

    def __pow__(self, power: Value) -> Value:
        return _power(self, power)

    def __rpow__(self, base: Value) -> Value:
        return _binary("pow", base, self)

    def __eq__(self, other: object) -> Value:
        raise TypeError("== on a state, input or parameter has no derivative; compare with <= and use M.where")

    def __bool__(self) -> bool:
        raise TypeError(
            "a decision on a state, input or parameter (if, and, not, max, min), which has no number yet: "
            "M.where decides on it, M.logical_and joins two, M.maximum takes the larger"
        )

    def __float__(self) -> float:
        raise TypeError(
            "math.sin or float of a state, input or parameter, which has no number yet: M.sin and its like take it"
        )

    __int__ = __index__ = __float__  # type: ignore[assignment]


def _binary(op: str, a: Value, b: Value) -> Value:
    """The node op(a, b); an array beside a symbol is left to NumPy, which applies the operation to its elements."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return NotImplemented
    return _apply(op, a, b)


def _power(base: Symbol, power: Value) -> Value:
    """Powers as products and square roots: a general `pow` keeps the compiler from using SIMD lanes."""
    if isinstance(power, Symbol) or float(2 * power) != int(2 * power) or abs(power) > 64:
        return base.tape.apply("pow", base, power)
    if power < 0:
        return 1.0 / _power(base, -power)
    whole, half = divmod(int(2 * power), 2)
    result: Value = M.sqrt(base) if half else 1.0
    square: Value = base
    while whole:
        if whole & 1:
            result = result * square
        whole >>= 1
        if whole:
            square = square * square
    return result


class Mathematics:
    """The mathematics M that plant functions use, on symbols."""

    pi = math.pi

    def where(self, condition: Value, a: Value, b: Value) -> Value:
        """a where the condition holds, else b."""
        return _apply("where", condition, a, b)

    def clip(self, a: Value, low: Value, high: Value) -> Value:
        """a within low and high."""
        return self.minimum(self.maximum(a, low), high)

    def interp(
        self, x: Value, xp: Sequence[float], fp: Sequence[float], kind: str = "linear", derivative: int = 0
    ) -> Value:
        """The table (xp, fp) at x, or a derivative of that; see npred.formulas.tables."""
        return _apply("interp", x, tables.table(xp, fp, kind, derivative))

    def solve(self, A: Sequence[Vector], b: Vector) -> list[Value]:
        """y of A y = b for a symmetric positive definite A, given as rows; above its diagonal nothing is read."""
        tape = next((a.tape for row in [*A, b] for a in row if isinstance(a, Symbol)), None)
        return ldl.solve([list(row) for row in A], list(b)) if tape is None else tape.solve(A, b)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name not in FUNCTIONS:
            message = unlisted("M", name, NAMES)
            raise AttributeError(f"{message.rpartition(';')[0]}; write {INSTEAD[name]}" if name in INSTEAD else message)
        count = OPS[name].text.count("{")

        def call(*args: Value) -> Value:
            if len(args) != count:
                raise TypeError(f"M.{name} expected {count} argument{'s' * (count > 1)}, got {len(args)}; give {count}")
            return _apply(name, *args)

        return call


FUNCTIONS = (
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp", "log", "sqrt", "abs", "sign",
    "floor", "mod", "maximum", "minimum", "logical_and", "logical_or", "logical_not",
)  # fmt: skip
NAMES = ("pi", *FUNCTIONS, "clip", "where", "interp", "solve")
INSTEAD = {  # what to write for names of other libraries
    "arcsin": "M.asin", "arccos": "M.acos", "arctan": "M.atan", "arctan2": "M.atan2", "ceil": "-M.floor(-a)",
    "remainder": "M.mod", "fmod": "M.mod", "absolute": "M.abs", "fabs": "M.abs", "fmax": "M.maximum",
    "fmin": "M.minimum", "max": "M.maximum", "min": "M.minimum", "amax": "M.maximum", "amin": "M.minimum",
    "if_else": "M.where", "select": "M.where", "heaviside": "M.where(a < 0, 0.0, 1.0)", "piecewise": "M.where",
    "interp1d": "M.interp", "CubicSpline": 'M.interp(a, xp, fp, "cubic")', "interpolant": "M.interp",
    "hypot": "M.sqrt(a * a + b * b)", "square": "a * a", "power": "a ** b", "pow": "a ** b",
    "log10": "M.log(a) / M.log(10.0)", "log2": "M.log(a) / M.log(2.0)", "log1p": "M.log(1 + a)",
    "expm1": "M.exp(a) - 1", "radians": "a * M.pi / 180", "deg2rad": "a * M.pi / 180", "round": "M.floor(a + 0.5)",
    "rint": "M.floor(a + 0.5)", "floor_divide": "M.floor(a / b)", "norm": "M.sqrt of the sum of the squares",
}  # fmt: skip
M = Mathematics()
Functions = Mathematics | SimpleNamespace | ModuleType  # M: on symbols, or on arrays and tensors, see array_math


def _apply(op: str, *args: Value) -> Value:
    tape = next((a.tape for a in args if isinstance(a, Symbol)), None)
    return _fold(op, args) if tape is None else tape.apply(op, *args)
