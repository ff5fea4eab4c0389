"""Costly plants: f, kappa and their derivatives compiled once as functions of their own, which the kernels call.

Written out, RK4 holds f four times and the update law its derivative twice; a compiler's time grows faster than that.
The functions themselves go past most of the compiler: their programs are lowered operation by operation (lowering.py).
"""

from functools import cache

import numpy as np

from npred.symbolic import kernels, programs, tape
from npred.symbolic.declared import Declared
from npred.symbolic.trace import Trace

LONG = 150  # lines from which on a function is called; below, all fits into registers and SIMD lanes

VERSION = 1  # compiled programs are kept under their text: a change of what lowering.py makes of it counts here
TEXTS = {name: f"o.{name}({', '.join(f'{{{k}}}' for k in range(op.arity))})" for name, op in tape.OPS.items()}
PROGRAM = """\
from npred.symbolic.lowering import function  # {version}


def program(o, {given}):
    {lines}
    return ({found},)


lowered = function(program, {size})
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
    return "".join(f"from {_module(trace.plant, name)} import plant_{name}\n" for name in trace.tape.called())


@cache
def _module(plant: Declared, name: str) -> str:
    """The name of the module that holds the compiled function, which is loaded."""
    arguments, lines, size = _lines(plant, name)
    given, found = ", ".join(arguments), ", ".join(_names("y", size))
    program = {"given": given, "found": found, "lines": "\n    ".join(lines), "size": size}
    preamble = PROGRAM.format(version=VERSION, **program)
    text = f"def plant_{name}({given}):\n    return lowered(({given},))\n"
    signature = f"UniTuple(float64, {size})({', '.join(['float64'] * len(arguments))})"
    return kernels.build(f"plant_{name}", signature, text, preamble).__module__


def _lines(plant: Declared, name: str) -> tuple[list[str], list[str], int]:
    """Arguments, lines and number of results of f, its derivative df along (v, dt), kappa, or kappa with its: law."""
    trace = Trace(plant)
    x, u, v = trace.vector("x", plant.n), trace.vector("u", plant.m), trace.vector("d", plant.n)
    t, dt = trace.input("t"), trace.input("dt")
    inputs = {"f": (x, u, t), "df": (x, u, t, v, dt), "kappa": (x, t), "law": (x, t, v, dt)}[name]
    outputs = np.ravel(getattr(trace, name)(*inputs))
    names = ["t", *_names("x", plant.n), *(_names("u", plant.m) if u is inputs[1] else [])]
    names += _names("p", len(plant.parameters)) + (["dt", *_names("d", plant.n)] if inputs[-1] is dt else [])
    targets = _names("y", len(outputs))
    return names, programs.lines(outputs, {}, targets, TEXTS), len(outputs)


def _names(prefix: str, count: int) -> list[str]:
    return [f"{prefix}{k}" for k in range(count)]
