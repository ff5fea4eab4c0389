"""The operations of a long function of a plant, each a line of C; npred.symbolic.called_functions names them."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from npred.symbolic.c99 import library
from npred.symbolic.c99.values import Const, Number, binary

ARITHMETIC = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
COMPARED = {"lt": "<", "le": "<="}
EXTREMES = {"maximum": max, "minimum": min}


class LinesOfC:
    """The operations `o` of a program, on the numbers of a function that is being translated."""

    def __init__(self, body: Any) -> None:
        self._body = body

    def __getattr__(self, op: str) -> Callable[..., Number]:
        return lambda *args: self._body.temporary(self._value(op, [self.number(a) for a in args]))

    def number(self, a: Any) -> Any:
        """A Python float becomes a constant."""
        return Const(a, self._body.real) if isinstance(a, float) else a

    def _value(self, op: str, args: list[Any]) -> Number:
        body = self._body
        if op in ARITHMETIC:
            return binary(ARITHMETIC[op], args[0], args[1], body.real)
        if op in COMPARED:
            return body.compared(COMPARED[op], *args)
        if op == "neg":
            return body.negative(args[0])
        if op == "pow":
            return body.power(*args)
        if op == "where":
            return body.chosen(*args)
        function = EXTREMES.get(op) or {"abs": abs, "sign": np.sign}.get(op) or getattr(math, op)
        return library.call(body, function, args)
