"""The functions that kernels call without defining them: Python's, those of math and NumPy, and their helpers in C."""

import builtins
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from npred.symbolic.c99.values import (
    COMPARE,
    INTEGERS,
    TERNARY,
    Array,
    Const,
    Elementwise,
    Number,
    Several,
    Term,
    converted,
    promoted,
    text,
)

# Python's max is the first argument unless the second is above it, NaN among them; % and // round towards -infinity;
# an index below 0 counts from the end.
HELPERS = {
    "max": "static inline {kind} {name}({kind} a, {kind} b)\n{{\n    return b > a ? b : a;\n}}",
    "min": "static inline {kind} {name}({kind} a, {kind} b)\n{{\n    return b < a ? b : a;\n}}",
    "sign": "static inline {kind} {name}({kind} a)\n{{\n    return a > 0 ? 1 : a < 0 ? -1 : a;\n}}",
    "modulo": "static inline {kind} {name}({kind} a, {kind} b)\n{{\n    const {kind} rest = a % b;\n"
    "    return rest != 0 && (rest < 0) != (b < 0) ? rest + b : rest;\n}}",
    "remainder": "static inline {kind} {name}({kind} a, {kind} b)\n{{\n    const {kind} rest = fmod{f}(a, b);\n"
    "    return rest != 0 && (rest < 0) != (b < 0) ? rest + b : rest;\n}}",
    "quotient": "static inline {kind} {name}({kind} a, {kind} b)\n{{\n    const {kind} whole = a / b;\n"
    "    return a % b != 0 && (a < 0) != (b < 0) ? whole - 1 : whole;\n}}",
    "wrapped": "static inline {kind} {name}({kind} index, {kind} extent)\n{{\n"
    "    return index < 0 ? index + extent : index;\n}}",
    "bits": "static inline {kind} {name}({integer} bits)\n{{\n    {kind} number;\n"
    "    memcpy(&number, &bits, sizeof number);\n    return number;\n}}",
}
BITS = {"int32_t": "float", "int64_t": "double"}
TYPES = {np.float32: "float", np.float64: "", np.int32: "int32_t", np.int64: "int64_t"}  # empty: the file's reals

MATHEMATICS: dict[Any, str] = {
    function: c
    for c, names in {
        "sqrt": ("sqrt",), "exp": ("exp",), "log": ("log",), "sin": ("sin",), "cos": ("cos",), "tan": ("tan",),
        "tanh": ("tanh",), "asinh": ("asinh", "arcsinh"), "floor": ("floor",), "ceil": ("ceil",), "expm1": ("expm1",),
        "log1p": ("log1p",), "sinh": ("sinh",), "cosh": ("cosh",), "atan": ("atan", "arctan"),
    }.items()
    for name in names
    for library in (math, np)
    if (function := getattr(library, name, None))
}  # fmt: skip
WHOLE = {math.floor, math.ceil}  # Python's give integers


def call(body: Any, function: Any, arguments: list[Any]) -> Any:
    """The value of a library function; None for a function that the library does not have."""
    if function in TYPES:
        return converted(arguments[0], TYPES[function] or body.real)
    if function in MATHEMATICS:
        return _elementwise(body, arguments[0], lambda a: _mathematics(body, function, a))
    handler = _HANDLERS.get(function)
    return handler(body, *arguments) if handler else None


def _elementwise(body: Any, a: Any, function: Callable[[Number], Number]) -> Any:
    if isinstance(a, Array | Elementwise):
        return Elementwise(a.shape, lambda index: function(body.element(a, index)))
    return function(a)


def _mathematics(body: Any, function: Any, a: Number) -> Number:
    name = MATHEMATICS[function]
    if isinstance(a, Const):
        with np.errstate(all="ignore"):
            value = float({"asinh": np.arcsinh, "atan": np.arctan}.get(name, getattr(np, name, None))(a.value))  # type: ignore[misc]
        result = Const(value, body.real if a.kind in INTEGERS else a.kind)
        return Const(int(value), "int") if function in WHOLE else result
    a = converted(a, body.real) if a.kind in INTEGERS else a
    result = Term(f"{name}{'f' * (a.kind == 'float')}({text(a)})", a.kind)
    return converted(result, "int") if function in WHOLE else result


def _extreme(name: str) -> Callable[..., Number]:
    def of(body: Any, *arguments: Any) -> Number:
        items = arguments[0].items if isinstance(arguments[0], Several) else arguments
        best = items[0]
        for other in items[1:]:
            best = _pair(body, name, best, other)
        return best

    return of


def _pair(body: Any, name: str, a: Number, b: Number) -> Number:
    kind = promoted(a.kind, b.kind)
    if isinstance(a, Const) and isinstance(b, Const):
        return Const(builtins.max(a.value, b.value) if name == "max" else builtins.min(a.value, b.value), kind)
    lows, highs = [x.low for x in (a, b)], [x.high for x in (a, b)]
    low, high = _ends(lows, max, name == "max"), _ends(highs, min, name == "min")
    return Term(f"{body.helper(name, kind)}({text(a, kind=kind)}, {text(b, kind=kind)})", kind, low=low, high=high)


def _ends(ends: list[int | None], tighter: Callable[..., int], either: bool) -> int | None:
    """A bound of an extreme: the tighter of those known, where either holds; else the looser, where both are known."""
    numbers = [end for end in ends if end is not None]
    if either:
        return tighter(numbers) if numbers else None
    looser = min if tighter is max else max
    return looser(numbers) if len(numbers) == len(ends) else None


def _absolute(body: Any, a: Any) -> Any:
    def one(a: Number) -> Number:
        if isinstance(a, Const):
            return Const(abs(a.value), a.kind)
        name = "abs" if a.kind in INTEGERS else "fabsf" if a.kind == "float" else "fabs"
        return Term(f"{name}({text(a)})", a.kind)

    return _elementwise(body, a, one)


def _sign(body: Any, a: Number) -> Number:
    if isinstance(a, Const):
        return Const(float(np.sign(a.value)), a.kind)
    return Term(f"{body.helper('sign', a.kind)}({text(a)})", a.kind)


def _classified(name: str) -> Callable[..., Number]:
    def of(body: Any, a: Number) -> Number:
        if isinstance(a, Const):
            return Const(bool(getattr(np, f"is{name}")(a.value)), "bool")
        return Term(f"is{name}({text(a)})", "bool")

    return of


def _integer(body: Any, a: Number) -> Number:
    return a if a.kind in INTEGERS and a.kind != "bool" else converted(a, "int")


def _rounded(body: Any, a: Number) -> Number:
    """Half to even, as Python's round, in the default mode of IEEE."""
    if isinstance(a, Const):
        return Const(round(a.value), "int")
    return Term(f"(int)rint{'f' * (a.kind == 'float')}({text(a, TERNARY)})", "int", COMPARE)


def _real(body: Any, a: Number) -> Number:
    return converted(a, body.real)


def _length(body: Any, a: Any) -> Number:
    return Const(len(a.items), "int") if isinstance(a, Several) else a.shape[0]


def _empty(body: Any, shape: Any, dtype: Any = None) -> Array:
    sizes = shape.items if isinstance(shape, Several) else (shape,)
    return body.buffer([size.value for size in sizes], (dtype and TYPES[dtype.value]) or body.real)


def _where(body: Any, test: Number, a: Number, b: Number) -> Number:
    return body.chosen(test, a, b)


_HANDLERS: dict[Any, Callable[..., Any]] = {
    builtins.max: _extreme("max"), builtins.min: _extreme("min"), builtins.abs: _absolute, np.abs: _absolute,
    builtins.int: _integer, builtins.float: _real, builtins.round: _rounded, builtins.len: _length,
    builtins.bool: lambda body, a: a, np.sign: _sign, np.isnan: _classified("nan"), math.isnan: _classified("nan"),
    np.isfinite: _classified("finite"), math.isfinite: _classified("finite"), np.empty: _empty, np.where: _where,
    np.maximum: _extreme("max"), np.minimum: _extreme("min"),
}  # fmt: skip
