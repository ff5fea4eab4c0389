"""What the translator knows of an expression: a number, C text of a kind, a view of an array, or a Python object."""

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from npred.json_files import escaped

INTEGERS = ("bool", "int", "int32_t", "int64_t")
KINDS = (*INTEGERS, "float", "double")  # each includes those before it
SMALLEST, LARGEST = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
TERNARY, OR, AND, COMPARE, SHIFT, SUM, PRODUCT, UNARY, ATOM = range(9)  # how strongly C binds


@dataclass(frozen=True)
class Const:
    """A number that is known at the export."""

    value: Any
    kind: str
    level = ATOM

    @property
    def low(self) -> int | None:
        return self.value if self.kind in INTEGERS else None

    high = low


@dataclass(frozen=True)
class Term:
    """The text of a number in C, how strongly it binds, and, of an integer, the numbers that it lies between."""

    text: str
    kind: str
    level: int = ATOM
    low: int | None = None
    high: int | None = None


Number = Const | Term
ZERO = Const(0, "int")


@dataclass(frozen=True)
class Array:
    """A view of memory: element (i, j, …) is name[offset + i strides[0] + j strides[1] + …].

    `data` are the numbers of the whole memory where they are known at the export; `parameter` is the name of the
    function's argument that the memory came by. `fixed` are the numbers of a memory of which some are set at run time,
    NaN those.
    """

    name: str
    kind: str
    shape: tuple[Number, ...]
    strides: tuple[int, ...]
    offset: Number = ZERO
    data: np.ndarray | None = None
    parameter: str = ""
    fixed: np.ndarray | None = None

    @classmethod
    def whole(
        cls, name: str, kind: str, shape: tuple[int, ...], data: np.ndarray | None = None,
        fixed: np.ndarray | None = None,
    ) -> "Array":  # fmt: skip
        """All of a memory, C-contiguous."""
        strides = tuple(math.prod(shape[i + 1 :]) for i in range(len(shape)))
        return cls(name, kind, tuple(Const(size, "int") for size in shape), strides, data=data, fixed=fixed)

    def number(self, at: Number) -> "Const | None":
        """The number at a place of the memory, None where it is not known at the export."""
        numbers = self.fixed if self.data is None else self.data
        if numbers is None or not isinstance(at, Const):
            return None
        value = numbers[at.value].item()
        return None if self.data is None and math.isnan(value) else Const(value, self.kind)

    @property
    def size(self) -> int:
        """The number of elements. Raises KeyError where an extent is not known at the export."""
        return math.prod(self.extents)

    @property
    def extents(self) -> tuple[int, ...]:
        """The shape as numbers. Raises KeyError where one is not known at the export."""
        sizes = [extent.value for extent in self.shape if isinstance(extent, Const)]
        if len(sizes) < len(self.shape):
            raise KeyError(f"{self.name}: an extent that is not known at the export")
        return tuple(sizes)

    def reshaped(self, shape: tuple[int, ...]) -> "Array":
        """Other axes of the same memory, which is contiguous; one extent may be -1."""
        rest = math.prod(size for size in shape if size != -1)
        whole = Array.whole(self.name, self.kind, tuple(self.size // rest if size == -1 else size for size in shape))
        assert self.strides == Array.whole("", "", self.extents).strides, f"{self.name}: not contiguous"
        return replace(self, shape=whole.shape, strides=whole.strides)


@dataclass(frozen=True)
class Elementwise:
    """A function of arrays, element by element."""

    shape: tuple[Number, ...]
    element: Callable[[list[Number]], Number]


@dataclass(frozen=True)
class Several:
    """A tuple."""

    items: tuple[Any, ...]


@dataclass(frozen=True)
class Fields:
    """A named tuple of values."""

    fields: Mapping[str, Any]


@dataclass(frozen=True)
class Foreign:
    """An object of Python: a function, a module, a type, None."""

    value: Any


def alike(value: Several) -> bool:
    """Whether all are numbers of one kind: such a tuple is an array in C."""
    return len({item.kind for item in value.items}) == 1


def promoted(*kinds: str) -> str:
    """The kind that holds them all."""
    return max(kinds, key=KINDS.index)


def literal(value: Any, kind: str) -> str:
    """The number in C, in decimal."""
    if kind in INTEGERS:
        return str(int(value))
    if not math.isfinite(value):
        return {math.inf: "INFINITY", -math.inf: "-INFINITY"}.get(value, "NAN")
    written, suffix = (str(np.float32(_single(value))), "f") if kind == "float" else (repr(float(value)), "")
    return written + ("" if "." in written or "e" in written else ".0") + suffix


def exact(value: Any, kind: str) -> str:
    """The number in C, in hexadecimal."""
    if not math.isfinite(value):
        return literal(value, kind)
    return f"{float(np.float32(_single(value))).hex()}f" if kind == "float" else float(value).hex()


def _single(value: float) -> float:
    """The number within float's range. What is too small becomes its smallest: a guard against 0 stays one."""
    return math.copysign(min(max(abs(value), SMALLEST), LARGEST), value) if value else value


def comment(text: str) -> str:
    """The text as a comment may hold it: it cannot end the comment, nor begin one, and is no trigraph."""
    return escaped(text).replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


def text(number: Number, level: int = TERNARY, kind: str = "") -> str:
    """The text of a number as an operand of an operator that binds as `level`; constants are written in that kind."""
    if isinstance(number, Const):
        written = literal(number.value, kind if kind and number.kind not in INTEGERS else number.kind)
        if kind in ("float", "double") and number.kind in INTEGERS:
            written = literal(float(number.value), kind)
        return f"({written})" if written.startswith("-") and level > SUM else written
    if kind == "float" and number.kind in INTEGERS:  # which may round; a double holds every int
        return text(converted(number, kind), level)
    return f"({number.text})" if number.level < level else number.text


FOLD: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "<<": operator.lshift,
    "//": operator.floordiv, "%": operator.mod, "**": operator.pow,
}  # fmt: skip
LEVELS = {"+": SUM, "-": SUM, "*": PRODUCT, "/": PRODUCT, "<<": SHIFT}


def folded(symbol: str, a: Const, b: Const, real: str) -> Const:
    """The result of an operation on numbers, as IEEE has it."""
    kind = promoted(a.kind, b.kind, "int")
    kind = promoted(kind, real) if symbol == "/" and kind in INTEGERS else kind
    if kind in INTEGERS:
        return Const(FOLD[symbol](a.value, b.value), kind)
    with np.errstate(all="ignore"):
        return Const(float(FOLD[symbol](np.float64(a.value), np.float64(b.value))), kind)


def binary(symbol: str, a: Number, b: Number, real: str) -> Number:
    """a symbol b for +, -, *, / and <<."""
    if isinstance(a, Const) and isinstance(b, Const):
        return folded(symbol, a, b, real)
    kind = promoted(a.kind, b.kind, "int")
    if symbol == "/" and kind in INTEGERS:
        kind = real
        a = a if isinstance(a, Const) else converted(a, real)
    if kind in INTEGERS and (simple := _simpler(symbol, a, b)) is not None:
        return simple
    level = LEVELS[symbol]
    low, high = _between(symbol, a, b) if kind in INTEGERS else (None, None)
    written = f"{text(a, level, kind)} {symbol} {text(b, level + 1, kind)}"
    return Term(written, kind, level, low, high)


def _simpler(symbol: str, a: Number, b: Number) -> Number | None:
    """Sums with 0 and products with 0 and 1, of integers: most indices are such."""
    zeros = [isinstance(x, Const) and x.value == 0 for x in (a, b)]
    ones = [isinstance(x, Const) and x.value == 1 for x in (a, b)]
    if symbol == "*" and any(zeros):
        return ZERO
    if (symbol == "+" and zeros[0]) or (symbol == "*" and ones[0]):
        return b
    return a if (symbol in "+-" and zeros[1]) or (symbol == "*" and ones[1]) else None


def _between(symbol: str, a: Number, b: Number) -> tuple[int | None, int | None]:
    """Bounds of an integer result."""
    if symbol == "*" and isinstance(b, Const) and b.value >= 0:
        return tuple(None if end is None else end * b.value for end in (a.low, a.high))  # type: ignore[return-value]
    if symbol not in "+-":
        return None, None
    ends = (b.low, b.high) if symbol == "+" else (b.high, b.low)
    sign = 1 if symbol == "+" else -1
    low, high = ((None if x is None or y is None else x + sign * y) for x, y in zip((a.low, a.high), ends, strict=True))
    return low, high


def converted(number: Number, kind: str) -> Number:
    """The number as another kind."""
    if number.kind == kind:
        return number
    if isinstance(number, Const):
        return Const(int(number.value) if kind in INTEGERS else float(number.value), kind)
    return Term(f"({'int' if kind == 'bool' else kind}){text(number, UNARY)}", kind, UNARY)
