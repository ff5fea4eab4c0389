"""PREDICT by a trained network on a fixed grid: its program printed as calls on constants and buffers."""

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from npred.delays import family
from npred.kernels.c_text import constant, literal
from npred.kernels.kernel import Kernel, made, skeleton
from npred.runtimes.program import Matrix, Program, Step

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
    lines = "\n    ".join(line for step in steps for line in step.lines(_view(p)))
    return f"static void PART(_{name})(PART(_memory) *restrict q)\n{{\n    {lines}\n}}\n"


def _view(p: Program) -> Callable[[Matrix | None], str]:
    """The C of a matrix of the program: where its first element is, and its strides."""

    def text(matrix: Matrix | None) -> str:
        if matrix is None:
            return "0, (View){0, 0}"
        name = f"q->{RENAMED.get(matrix.name, matrix.name)}" if matrix.name in p.buffers else f"c_{matrix.name}"
        moves = {"": matrix.offset, " * e": matrix.turn, " * o": matrix.layer}
        place = name + "".join(f" + {count}{index}" for index, count in moves.items() if count)
        return f"{place}, (View){{{matrix.row}, {matrix.column}}}"

    return text
