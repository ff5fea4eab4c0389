"""A program printed as the text of one Numba function on the loop's memory.

Lengths are literal and buffers are on the stack, so that LLVM vectorises every inner loop and nothing is allocated.
Products go by blocks of four rows and eight terms: each weight that is loaded serves all rows of the block. Where the
processor has vectors of 512 bits LLVM takes them by an attribute alone: products are faster by a tenth and more.
"""

import base64
import math
from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np

from npred.runtimes.program import Product, Repeat, Silu, SiluPair, Step, Transpose, indented, loops

ROWS, TERMS = 4, 8  # of a block of a product
NARROW = 48  # columns
STACK = 4096  # numbers of a buffer on the stack; longer ones cost more than their allocation anyway
FASTMATH = ("contract", "nsz", "arcp")  # NaN stays NaN

# 2^f on [-1/2, 1/2], to 2e-7 of the value and to 2e-16; (e^d - 1) / d on [-1/2, 1/2]: Taylor's, but for the shortest
EXP2 = {
    np.float32: [1.0000001192, 0.6931471825, 0.2402210683, 0.0555035696, 0.0096760318, 0.0013390863],
    np.float64: [math.log(2) ** k / math.factorial(k) for k in range(13)],
}
EXPM1 = {kind: [1 / math.factorial(k + 1) for k in range(terms)] for kind, terms in ((np.float32, 7), (np.float64, 13))}

PREAMBLE = """\
import base64

from llvmlite import ir
from numba import carray, types
from numba.core import cgutils
from numba.extending import intrinsic


def _stack(kind, of):
    @intrinsic
    def take(context, count):
        if not isinstance(count, types.IntegerLiteral):
            return None

        def code(context, builder, signature, arguments):
            size = ir.Constant(ir.IntType(64), signature.args[0].literal_value)
            return cgutils.alloca_once(builder, of, size=size)

        return types.CPointer(kind)(count), code

    take.memory = str(kind)
    return take


_stack_float32, _stack_float64 = _stack(types.float32, ir.FloatType()), _stack(types.float64, ir.DoubleType())


def _constant(text, kind):
    values = base64.b64decode(text)

    @intrinsic
    def take(context):
        def code(context, builder, signature, arguments):
            data = cgutils.create_constant_array(ir.IntType(8), bytearray(values))
            memory = cgutils.global_constant(builder, "weights", data)
            memory.align = 64
            return builder.bitcast(memory, context.get_value_type(signature.return_type))

        return types.CPointer(kind)(), code

    take.memory = np.frombuffer(values, str(kind))
    return take


@intrinsic
def _wide(context):
    def code(context, builder, signature, arguments):
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')  # its own add knows no such attribute
        return context.get_dummy_value()

    return types.void(), code


_wide.memory = ""  # that these three stand for memory, and of which kind, is for other compilers than Numba's
REAL, INT, MANTISSA, EXPONENT = {real}, {integer}, {mantissa}, {exponent}
ZERO, HALF, ONE, MINUS_LOG2_E = REAL(0), REAL(0.5), REAL(1), REAL(-1.4426950408889634)
LOWEST, HIGHEST, BIAS = REAL(1 - EXPONENT), REAL(EXPONENT - 1), REAL(EXPONENT + 0.5)


@njit(inline="always")
def _power(x):
    y = x * MINUS_LOG2_E
    y = y if y > LOWEST else LOWEST  # NaN too: as an integer it is undefined in C
    y = y if y < HIGHEST else HIGHEST
    k = INT(y + BIAS)
    f = y - REAL(INT(k - EXPONENT))
    return ONE + INT(k << MANTISSA).view(REAL) * {power}


@njit(inline="always")
def _change(d):
    return {change}


"""

SILU = """\
for j in range({count}):
    x = {a}[j]
    {out}[j] = x / _power(x)
"""

# With s the logistic function and d = b - a: silu(b) - silu(a) = d s(b) + a (s(b) - s(a)), and for small d
# s(b) - s(a) = s(a) (1 - s(b)) (e^d - 1), which cancels nothing.
SILU_PAIR = """\
for j in range({count}):
    d, rest = {a}[j], {a}[{count} + j]
    s_rest, s = ONE / _power(rest), ONE / _power(rest + d)
    {out}[{count} + j] = rest * s_rest
    {out}[j] = d * s + rest * (s_rest * (ONE - s) * _change(d) if abs(d) < HALF else s - s_rest)
"""

_loops = partial(loops, head="for {} in range({}):")


def preamble(constants: dict[str, np.ndarray], precision: Any) -> str:
    """The lines before the function: helpers and the constants.

    The constants are written into the code: Numba caches no function that reads a global array of over 1 MB.
    """
    format_ = np.finfo(precision)
    head = PREAMBLE.format(
        real=f"np.{precision.__name__}", integer=f"np.int{format_.bits}", mantissa=format_.nmant,
        exponent=format_.maxexp - 1, power=_horner("f", EXP2[precision]),
        change=f"d * {_horner('d', EXPM1[precision])}",
    )  # fmt: skip
    lines = [
        f"_{name} = _constant({base64.b64encode(a.tobytes()).decode()!r}, types.{a.dtype})"
        for name, a in constants.items()
    ]
    return head + "\n".join(lines) + "\n"


def arrays(constants: dict[str, np.ndarray]) -> list[str]:
    """The lines that name the constants' memory."""
    return [f"{name} = carray(_{name}(), ({a.size},))" for name, a in constants.items()]


def _horner(x: str, coefficients: list[float]) -> str:
    """The polynomial of x with these coefficients, the constant first."""
    first, *rest = coefficients
    return f"(REAL({first!r}) + {x} * {_horner(x, rest)})" if rest else f"REAL({first!r})"


def buffers(sizes: dict[str, int], precision: Any) -> list[str]:
    """The lines that make buffers of floats."""
    return [f"{name} = {_memory(size, precision.__name__)}" for name, size in sizes.items()]


def _memory(size: int, kind: str) -> str:
    return f"carray(_stack_{kind}({size}), ({size},))" if size <= STACK else f"np.empty({size}, np.{kind})"


def steps(program: Iterable[Step]) -> list[str]:
    """The lines of some steps."""
    return [line for step in program for line in _step(step)]


def _step(step: Step) -> list[str]:
    if isinstance(step, Product):
        return _product(step)
    if isinstance(step, Repeat):
        views = [f"{m.view} = {m.name}[o * {m.layer} : (o + 1) * {m.layer}]" for m in step.stacks]
        return _loops({"o": step.count}, [*views, *steps(step.steps)])
    if isinstance(step, Silu | SiluPair):
        text = SILU if isinstance(step, Silu) else SILU_PAIR
        return text.format(out=step.out, a=step.a, count=step.count).splitlines()
    if isinstance(step, Transpose):
        line = f"{step.out.at('j', 'i')} = {step.a.at('i', 'j')}"
        return _loops({"j": step.shape[1], "i": step.shape[0]}, [line])
    even, odd, half = step.even.at("i", "j"), step.odd.at("i", "j"), (step.nx + 1) // 2
    mirrored = _loops({"j": half}, [f"{step.out.at('i', f'{step.nx - 1} - j')} = {even} - {odd}"])
    return _loops({"i": step.rows}, [*mirrored, *_loops({"j": half}, [f"{step.out.at('i', 'j')} = {even} + {odd}"])])


def _product(step: Product) -> list[str]:
    """A product by blocks of rows."""
    M = step.shape[0]
    whole, lines = M - M % ROWS, []
    if whole > ROWS:
        lines += [f"for i in range(0, {whole}, {ROWS}):", *indented(_rows(step, "i", ROWS))]
    elif whole:
        lines += _rows(step, "0", ROWS)
    lines += _rows(step, str(whole), M - whole) if whole < M else []
    return lines if step.repeats == 1 else _loops({"e": step.repeats}, lines)


def _rows(step: Product, i: str, rows: int) -> list[str]:
    """A block of rows: a loop over blocks of terms, and what is left of them."""
    K = step.shape[1]
    if K <= TERMS:
        return _terms(step, i, rows, "0", K, sets=not step.adds)
    whole, lines = K - K % TERMS, [] if step.adds else _start(step, i, rows)
    lines += [f"for k in range(0, {whole}, {TERMS}):", *indented(_terms(step, i, rows, "k", TERMS, sets=False))]
    return lines + (_terms(step, i, rows, str(whole), K - whole, sets=False) if whole < K else [])


def _start(step: Product, i: str, rows: int) -> list[str]:
    rows_of = [(_plus(i, r), step.bias) for r in range(rows)]
    outs = [f"{step.out.at(row, 'j')} = {bias.at(row, 'j') if bias else 'ZERO'}" for row, bias in rows_of]
    return _loops({"j": step.shape[2]}, outs)


def _terms(step: Product, i: str, rows: int, k: str, terms: int, sets: bool) -> list[str]:
    """A block of rows and terms; `sets` starts the sums, else they go on."""
    pairs = [(r, q) for r in range(rows) for q in range(terms)]
    a = [f"a{r}_{q} = {step.a.at(_plus(i, r), _plus(k, q))}" for r, q in pairs]
    inner = [f"b{q} = {step.b.at(_plus(k, q), 'j')}" for q in range(terms)]
    for r in range(rows):
        target = step.out.at(_plus(i, r), "j")
        start = target if not sets else step.bias.at(_plus(i, r), "j") if step.bias else None
        inner.append(f"{target} = {_sum(start, [f'a{r}_{q} * b{q}' for q in range(terms)], step.shape[2])}")
    return [*a, *_loops({"j": step.shape[2]}, inner)]


def _plus(index: str, offset: int) -> str:
    if index.isdigit():
        return str(int(index) + offset)
    return f"{index} + {offset}" if offset else index


def _sum(start: str | None, terms: list[str], width: int) -> str:
    """Wide rows keep the multiply-adds busy one after the other; in narrow ones they would wait for each other."""
    terms = terms if width > NARROW else [_tree(terms)]
    return " + ".join([*([start] if start else []), *terms])


def _tree(terms: list[str]) -> str:
    """A sum by halves."""
    half = len(terms) // 2
    return terms[0] if len(terms) == 1 else f"({_tree(terms[:half])} + {_tree(terms[half:])})"
