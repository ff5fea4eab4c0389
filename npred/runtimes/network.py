"""PREDICT by a trained network on a fixed grid: its program printed as calls on constants and buffers."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from npred.delays import family
from npred.kernels.c_text import constant, literal
from npred.kernels.kernel import Kernel, made, skeleton
from npred.runtimes.program import Matrix, Product, Program, Repeat, Silu, SiluPair, Step, Transpose

# 2^f on [-1/2, 1/2], to 2e-7 of the value and to 2e-16; (e^d - 1) / d on [-1/2, 1/2]: Taylor's, but for the shortest
EXP2 = {
    np.float32: [1.0000001192, 0.6931471825, 0.2402210683, 0.0555035696, 0.0096760318, 0.0013390863],
    np.float64: [math.log(2) ** k / math.factorial(k) for k in range(13)],
}
EXPM1 = {kind: [1 / math.factorial(k + 1) for k in range(terms)] for kind, terms in ((np.float32, 7), (np.float64, 13))}
KINDS = {np.dtype(np.float32): "float", np.dtype(np.float64): "double"}
RENAMED = {"N": "N_"}


def kernel(p: Program) -> Kernel:
    """The kernel of a program, for p.nx nodes and any number of lanes."""
    functions = {"steps": p.steps} | ({"series": [p.series.product]} if p.series else {})
    texts = [_memory(p), *(_function(name, steps, p) for name, steps in functions.items())]
    constants = [constant(f"c_{name}", values, KINDS[values.dtype]) for name, values in p.constants.items()]
    size = sum(p.buffers.values()) + p.nx  # doubles, for numbers of either precision
    body = "\n".join([skeleton("network.h"), *constants, *texts, skeleton("fused.h")])
    return made("fused", family.PREDICT, body, {}, _sizes(p), work=lambda nx, lanes, _: size)


def _sizes(p: Program) -> dict[str, Any]:
    """The macros of the skeletons."""
    numbers = np.finfo(p.precision)
    sizes = {
        "N": p.n, "M": p.m, "NX": p.nx, "SEEN": p.seen, "COLUMNS": p.columns, "REAL": KINDS[np.dtype(p.precision)],
        "INTEGER": f"int{numbers.bits}_t", "MANTISSA": numbers.nmant, "EXPONENT": numbers.maxexp - 1,
        "EXP2": _braces(EXP2[p.precision], p), "EXPM1": _braces(EXPM1[p.precision], p), "PHASED": int(bool(p.period)),
        "PERIOD": repr(p.period or 1.0), "PAIRED": int(p.rows == 2), "TWICE": int(p.twice),
        "SERIES_TERMS": p.series.terms if p.series else 0, "BASED": int("base" in p.constants),
    }  # fmt: skip
    if p.series:
        sizes |= {"SERIES_LOW": repr(p.series.low), "SERIES_SCALE": repr(2 / (p.series.high - p.series.low))}
    return sizes


def _braces(values: Iterable[float], p: Program) -> str:
    return "{" + ", ".join(literal(value, KINDS[np.dtype(p.precision)]) for value in values) + "}"


def _memory(p: Program) -> str:
    """The struct of the buffers; that of N is called N_, beside the macro N."""
    members = "\n".join(f"    REAL {RENAMED.get(name, name)}[{size}];" for name, size in p.buffers.items())
    return f"typedef struct {{\n    double prefix[NX];\n{members}\n}} ALIASED PART(_memory);\n"


def _function(name: str, steps: Iterable[Step], p: Program) -> str:
    lines = "\n    ".join(line for step in steps for line in _step(step, p))
    return f"static void PART(_{name})(PART(_memory) *restrict q)\n{{\n    {lines}\n}}\n"


def _step(step: Step, p: Program) -> list[str]:
    """The lines of a step: a call with literal sizes and strides."""

    def view(matrix: Matrix | None) -> str:
        """Where its first element is, and its strides."""
        if matrix is None:
            return "0, (View){0, 0}"
        name = f"q->{RENAMED.get(matrix.name, matrix.name)}" if matrix.name in p.buffers else f"c_{matrix.name}"
        moves = [f" + {count}{of}" for count, of in ((matrix.offset, ""), (matrix.turn, " * e"), (matrix.layer, " * o"))
                 if count]  # fmt: skip
        return f"{name}{''.join(moves)}, (View){{{matrix.row}, {matrix.column}}}"

    if isinstance(step, Product):
        bias, sizes = view(step.bias), ", ".join(map(str, step.shape))
        call = f"product({sizes}, {view(step.out)}, {view(step.a)}, {view(step.b)}, {bias}, {int(step.adds)});"
        return [call] if step.repeats == 1 else [f"for (int e = 0; e < {step.repeats}; e++) {{", f"    {call}", "}"]
    if isinstance(step, Repeat):
        inner = [f"    {line}" for part in step.steps for line in _step(part, p)]
        return [f"for (int o = 0; o < {step.count}; o++) {{", *inner, "}"]
    if isinstance(step, Silu | SiluPair):
        name = "silu" if isinstance(step, Silu) else "silu_pair"
        return [f"{name}({step.count}, q->{step.a}, q->{step.out});"]
    if isinstance(step, Transpose):
        return [f"transpose({step.shape[0]}, {step.shape[1]}, {view(step.a)}, {view(step.out)});"]
    return [f"mirror({step.rows}, {step.nx}, {view(step.even)}, {view(step.odd)}, {view(step.out)});"]
