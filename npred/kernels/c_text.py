"""Texts of C: numbers, arrays and comments, and the same text in single precision."""

import math
import re

import numpy as np

from npred.base.json_files import escaped

SMALLEST, LARGEST = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
FUNCTIONS = [
    "sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "fabs", "pow",
    "asinh", "rint", "floor", "ceil", "fmod", "remainder",
]  # fmt: skip
_NUMBER = re.compile(r"(?<![\w.])(\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)(?![\w.])")
_HEXADECIMAL = re.compile(r"-?0x[\da-f.]+p[+-]?\d+(?![\w.])")
_WORD = re.compile(rf"\bdouble\b|\b({'|'.join(FUNCTIONS)})(?=\()")


def literal(value: float, kind: str) -> str:
    """The number in C, in decimal."""
    if not math.isfinite(value):
        return {math.inf: "INFINITY", -math.inf: "-INFINITY"}.get(value, "NAN")
    written, suffix = (str(np.float32(_single(value))), "f") if kind == "float" else (repr(float(value)), "")
    return written + ("" if "." in written or "e" in written else ".0") + suffix


def constant(name: str, values: np.ndarray, kind: str = "double") -> str:
    """A static array of int, or of numbers that are exact in hexadecimal."""
    numbers = [_exact(value, kind) for value in values.tolist()]
    rows = [", ".join(numbers[i : i + 6]) for i in range(0, len(numbers), 6)]
    return f"static const {kind} {name}[{len(numbers)}] = {{\n    " + ",\n    ".join(rows) + "\n};"


def comment(text: str) -> str:
    """The text as a comment may hold it: it cannot end the comment, nor begin one, and is no trigraph."""
    return escaped(text).replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


def single(text: str) -> str:
    """C in double precision as C in single precision: its types, its numbers and the functions of its library."""
    text = _HEXADECIMAL.sub(lambda number: _exact(float.fromhex(number[0]), "float"), text)
    text = _NUMBER.sub(lambda number: literal(float(number[1]), "float"), text)
    return _WORD.sub(lambda number: f"{number[1]}f" if number[1] else "float", text)


def _exact(value: float, kind: str) -> str:
    if kind == "int":
        return str(value)
    if not math.isfinite(value):
        return literal(value, kind)
    return f"{float(np.float32(_single(value))).hex()}f" if kind == "float" else float(value).hex()


def _single(value: float) -> float:
    """The number within float's range. A number that is too small becomes its smallest: a guard against 0 stays one."""
    return math.copysign(min(max(abs(value), SMALLEST), LARGEST), value) if value else value
