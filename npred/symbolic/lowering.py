"""Long programs compiled without Numba's front end: each operation lowered by Numba itself, its types known beforehand.

Four fifths of the time that thousands of lines take to compile go into rewriting them and inferring types, and here
there is nothing to infer: all numbers are floats. What comes out is the same code.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred.symbolic.tape import OPS


def function(program: Callable[..., tuple[Any, ...]], size: int) -> Any:
    """What compiled code calls with a tuple of floats for `program(o, *floats)`, whose results are `size` floats."""
    from numba import types  # here and below: this folder is looked through for plants, and Numba loads slowly
    from numba.core import cgutils
    from numba.extending import intrinsic

    @intrinsic
    def lowered(_: Any, floats: Any) -> Any:
        def write(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            o = Operations(context, builder)
            results = program(o, *cgutils.unpack_tuple(builder, args[0]))
            return context.make_tuple(builder, signature.return_type, [o.value(y) for y in results])

        return types.UniTuple(types.float64, size)(floats), write

    return lowered


class Operations:
    """The operations `o` of a program, on values of the code that is being written."""

    def __init__(self, context: Any, builder: Any) -> None:
        from numba import float64

        self._context, self._builder, self._float = context, builder, float64

    def __getattr__(self, op: str) -> Callable[..., Any]:
        from numba import boolean

        function = np.sign if op == "sign" else OPS[op].value
        types = (boolean if op in ("lt", "le") else self._float)(*[self._float] * OPS[op].arity)
        lowered = self._context.get_function(function, types)

        def call(*args: Any) -> Any:
            return lowered(self._builder, [self.value(a) for a in args])

        setattr(self, op, call)  # looked up once a program
        return call

    def where(self, condition: Any, a: Any, b: Any) -> Any:
        """a where the condition holds, else b."""
        return self._builder.select(condition, self.value(a), self.value(b))

    def maximum(self, a: Any, b: Any) -> Any:
        """The larger, as the interpreter's `max`: the first unless the second is above it."""
        return self.where(self.lt(a, b), b, a)

    def minimum(self, a: Any, b: Any) -> Any:
        """The smaller, likewise."""
        return self.where(self.lt(b, a), b, a)

    def value(self, a: Any) -> Any:
        """A number becomes a constant of the code."""
        return self._context.get_constant(self._float, a) if isinstance(a, float) else a
