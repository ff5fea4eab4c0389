"""Costly plants: f, kappa and their derivatives compiled once as separate functions, which the kernels call.

Written out, RK4 holds f four times and the update law its derivative twice; a compiler's time grows faster than that.
The functions themselves go past most of the compiler: each operation of their programs is lowered by Numba itself, its
types known beforehand. Four fifths of the time that thousands of lines take to compile go into rewriting them and
inferring types, and here there is nothing to infer: all numbers are floats. What comes out is the same code.
"""

import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from npred.symbolic import kernels, programs, tape
from npred.symbolic.declared import Declared
from npred.symbolic.linearised import Flow
from npred.symbolic.tape import names
from npred.symbolic.trace import Trace

LONG = 150  # lines from which on a function is called; below, all fits into registers and SIMD lanes

LONG_STEP = 500  # lines of an implicit step, which holds its matrix and elimination

Step = Callable[..., Any]  # npred.predictors.onestep
VERSION = 1  # compiled programs are kept under their text: a change of how they are lowered counts here
TEXTS = {name: f"o.{name}({', '.join(f'{{{k}}}' for k in range(op.arity))})" for name, op in tape.OPS.items()}
PROGRAM = """\
from npred.symbolic.called_functions import lowered_function  # {version}


def program(o, {arguments}):
    {lines}
    return ({results},)


lowered = lowered_function(program, {size})
"""


@cache
def called(plant: Declared) -> tuple[str, ...]:
    """The functions of the plant that its kernels call: those whose programs are long."""
    return tuple(name for name in ("f", "kappa") if len(_lines(plant, name)[1]) > LONG)


def trace(plant: Declared) -> Trace:
    """The trace that kernels are made of."""
    return Trace(plant, called(plant))


def imports(trace: Trace) -> str:
    """The lines that stand before a kernel of that trace: where the functions that it calls are."""
    modules = {name: _module(trace.plant, name, trace.steps.get(name)) for name in trace.tape.called()}
    return "".join(f"from {module} import plant_{name}\n" for name, module in modules.items())


def whole(step: Step, chains: int = 1) -> Step:
    """Mark the formula of an implicit step: it reads derivatives or mechanics, for which f has to be written out.

    `chains` is how many states side by side it advances.
    """
    step.whole = chains  # type: ignore[attr-defined]
    return step


def stepped(trace: Trace, step: Step, x: np.ndarray, inputs: Sequence[np.ndarray], t: Any, h: Any) -> np.ndarray:
    """x(t + h) by the formula of a one-step method, the inputs being u0, um, u1; a long implicit one is called."""
    if not hasattr(step, "whole"):
        return step(trace.f, x, *inputs, t, h)
    name = re.sub(r"\W", "_", step.__qualname__).lower() + ("_held" if inputs[0] is inputs[2] else "")
    if "f" not in trace.called and len(_lines(trace.plant, name, step)[1]) <= LONG_STEP:
        return step(Flow(trace), x, *inputs, t, h)
    trace.steps[name] = step
    u = inputs[0] if inputs[0] is inputs[2] else np.concatenate(inputs)
    return np.array(trace.tape.call(name, [t, *x, *u, *trace.parameters, h], 0, len(x)), dtype=object)


def operations(plant: Declared, step: Step) -> int:
    """How many operations a step is, f written out."""
    return len(_step_lines(Trace(plant), step, held=False)[1])


@cache
def _module(plant: Declared, name: str, step: Step | None) -> str:
    """The name of the module that holds the compiled function, which is loaded."""
    arguments, lines, size = _lines(plant, name, step)
    named, results = ", ".join(arguments), ", ".join(names("y", size))
    program = {"arguments": named, "results": results, "lines": "\n    ".join(lines), "size": size}
    preamble = PROGRAM.format(version=VERSION, **program)
    text = f"def plant_{name}({named}):\n    return lowered(({named},))\n"
    signature = f"UniTuple(float64, {size})({', '.join(['float64'] * len(arguments))})"
    return kernels.build(f"plant_{name}", signature, text, preamble).__module__


def _lines(plant: Declared, name: str, step: Step | None = None) -> tuple[list[str], list[str], int]:
    """Arguments, lines and number of results of f, its derivative df along (v, dt), kappa, kappa with its: law, or of a
    step.
    """
    trace = Trace(plant)
    if step is not None:
        return _step_lines(trace, step, name.endswith("_held"))
    x, u, v = trace.vector("x", plant.n), trace.vector("u", plant.m), trace.vector("d", plant.n)
    t, dt = trace.input("t"), trace.input("dt")
    inputs = {"f": (x, u, t), "df": (x, u, t, v, dt), "kappa": (x, t), "law": (x, t, v, dt)}[name]
    outputs = np.ravel(getattr(trace, name)(*inputs))
    arguments = ["t", *names("x", plant.n), *(names("u", plant.m) if u is inputs[1] else [])]
    arguments += names("p", len(plant.parameters)) + (["dt", *names("d", plant.n)] if inputs[-1] is dt else [])
    targets = names("y", len(outputs))
    return arguments, programs.lines(outputs, {}, targets, TEXTS), len(outputs)


def _step_lines(trace: Trace, step: Step, held: bool) -> tuple[list[str], list[str], int]:
    n, m = trace.plant.n * getattr(step, "whole", 1), trace.plant.m
    prefixes = "a" if held else "amb"
    inputs = [trace.vector(prefix, m) for prefix in prefixes] * (3 if held else 1)
    outputs = step(Flow(trace), trace.vector("x", n), *inputs, trace.input("t"), trace.input("h"))
    arguments = ["t", *names("x", n), *(name for prefix in prefixes for name in names(prefix, m))]
    arguments += [*names("p", len(trace.parameters)), "h"]
    return arguments, programs.lines(outputs, {}, names("y", n), TEXTS), n


def lowered_function(program: Callable[..., tuple[Any, ...]], size: int) -> Any:
    """The function of a tuple of floats that compiled code calls for `program(o, *floats)`, with `size` results."""
    from numba import types  # here and below: Numba loads slowly, and `npred plants` needs none of it
    from numba.core import cgutils
    from numba.extending import intrinsic

    @intrinsic
    def lowered(_: Any, floats: Any) -> Any:
        def write(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            o = Operations(context, builder)
            results = program(o, *cgutils.unpack_tuple(builder, args[0]))
            return context.make_tuple(builder, signature.return_type, [o.value(y) for y in results])

        return types.UniTuple(types.float64, size)(floats), write

    vars(lowered)["program"] = program  # for other compilers than Numba's
    return lowered


class Operations:
    """The operations `o` of a program, on values of the code that is being written."""

    def __init__(self, context: Any, builder: Any) -> None:
        from numba import float64

        self._context, self._builder, self._float = context, builder, float64

    def __getattr__(self, op: str) -> Callable[..., Any]:
        from numba import boolean

        function = np.sign if op == "sign" else tape.OPS[op].value
        types = (boolean if op in ("lt", "le") else self._float)(*[self._float] * tape.OPS[op].arity)
        code = self._context.get_function(function, types)

        def call(*args: Any) -> Any:
            return code(self._builder, [self.value(a) for a in args])

        setattr(self, op, call)  # looked up once per program
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
