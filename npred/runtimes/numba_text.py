"""A program printed as the text of one Numba function on the loop's memory.

Lengths are literal and buffers are on the stack, so that LLVM vectorises every inner loop and nothing is allocated.
Products go by blocks of four rows and eight terms: each weight that is loaded serves all rows of the block.
"""

import base64
from collections.abc import Iterable

import numpy as np

from npred.runtimes.program import Loop, Product, Silu, SiluPair, Step, Transpose

ROWS, TERMS = 4, 8  # of a block of a product
NARROW = 48  # columns
STACK = 4096  # numbers of a buffer on the stack; longer ones cost more than their allocation anyway
FASTMATH = ("contract", "nsz", "arcp")  # NaN stays NaN

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

    return take


_stack32, _stack64 = _stack(types.float32, ir.FloatType()), _stack(types.float64, ir.DoubleType())


def _array(text, kind):
    return np.frombuffer(base64.b64decode(text), kind)


F32, I32 = np.float32, np.int32
ZERO, HALF, ONE = F32(0), F32(0.5), F32(1)
MINUS_LOG2_E, LOWEST, HIGHEST, BIAS = F32(-1.4426950408889634), F32(-126.0), F32(126.0), F32(127.5)
C0, C1, C2, C3, C4, C5 = (
    F32(c) for c in (1.0000001192, 0.6931471825, 0.2402210683, 0.0555035696, 0.0096760318, 0.0013390863)
)
E2, E3, E4, E5, E6, E7 = (F32(1 / math.factorial(k)) for k in range(2, 8))
"""

# 1 + e^-x = 1 + 2^y: the exponent's bits times a polynomial on [-1/2, 1/2], to 2e-7 of the value
POWER = """\
    y = x * MINUS_LOG2_E
    y = LOWEST if y < LOWEST else y
    y = HIGHEST if y > HIGHEST else y
    k = I32(y + BIAS)
    f = y - F32(I32(k - 127))
    power = ONE + I32(k << 23).view(np.float32) * (C0 + f * (C1 + f * (C2 + f * (C3 + f * (C4 + f * C5)))))
"""

SILU = f"""\
for j in range({{count}}):
    x = {{a}}[j]
{POWER}    {{out}}[j] = x / power
"""

# With s the logistic function and d = b - a: silu(b) - silu(a) = d s(b) + a (s(b) - s(a)), and for small d
# s(b) - s(a) = s(a) (1 - s(b)) (e^d - 1), which cancels nothing.
SILU_PAIR = f"""\
for j in range({{count}}):
    x = {{a}}[{{count}} + j]
    rest = x
{POWER}    s_rest = ONE / power
    {{out}}[{{count}} + j] = rest * s_rest
    d = {{a}}[j]
    x = rest + d
{POWER}    s = ONE / power
    e = d * (ONE + d * (E2 + d * (E3 + d * (E4 + d * (E5 + d * (E6 + d * E7))))))
    {{out}}[j] = d * s + rest * (s_rest * (ONE - s) * e if abs(d) < HALF else s - s_rest)
"""

TRANSPOSE = """\
for j in range({shape[1]}):
    for i in range({shape[0]}):
        {out} = {a}
"""

MIRROR = """\
for i in range({rows}):
    for j in range({half}):
        {mirrored} = {even} - {odd}
    for j in range({half}):
        {out} = {even} + {odd}
"""


def preamble(constants: dict[str, np.ndarray]) -> str:
    """What stands before the function: helpers and the constants."""
    lines = [
        f"{name} = _array({base64.b64encode(a.tobytes()).decode()!r}, '{a.dtype.str}')" for name, a in constants.items()
    ]
    return PREAMBLE + "\n".join(lines) + "\n"


def buffers(sizes: dict[str, int], bits: int = 32) -> list[str]:
    """The lines that make buffers of floats of so many bits."""
    return [f"{name} = {_memory(size, bits)}" for name, size in sizes.items()]


def _memory(size: int, bits: int) -> str:
    return f"carray(_stack{bits}({size}), ({size},))" if size <= STACK else f"np.empty({size}, np.float{bits})"


def steps(program: Iterable[Step]) -> list[str]:
    """The lines of some steps."""
    return [line for step in program for line in _step(step)]


def _step(step: Step) -> list[str]:
    if isinstance(step, Product):
        return _product(step)
    if isinstance(step, Loop):
        views = [f"{m.view} = {m.name}[o * {m.layer} : (o + 1) * {m.layer}]" for m in step.stacks]
        return [f"for o in range({step.count}):", *_indent([*views, *steps(step.steps)])]
    if isinstance(step, Silu | SiluPair):
        text = (SILU if isinstance(step, Silu) else SILU_PAIR).format(out=step.out, a=step.a, count=step.count)
    elif isinstance(step, Transpose):
        text = TRANSPOSE.format(out=step.out.at("j", "i"), a=step.a.at("i", "j"), shape=step.shape)
    else:
        parts = {name: getattr(step, name).at("i", "j") for name in ("out", "even", "odd")}
        parts["mirrored"] = step.out.at("i", f"{step.nx - 1} - j")
        text = MIRROR.format(**parts, rows=step.rows, half=(step.nx + 1) // 2)
    return text.splitlines()


def _product(step: Product) -> list[str]:
    """A product by blocks of rows."""
    M = step.shape[0]
    whole, lines = M - M % ROWS, []
    if whole > ROWS:
        lines += [f"for i in range(0, {whole}, {ROWS}):", *_indent(_rows(step, "i", ROWS))]
    elif whole:
        lines += _rows(step, "0", ROWS)
    lines += _rows(step, str(whole), M - whole) if whole < M else []
    return lines if step.repeats == 1 else [f"for e in range({step.repeats}):", *_indent(lines)]


def _rows(step: Product, i: str, rows: int) -> list[str]:
    """A block of rows: a loop over blocks of terms, and what is left of them."""
    K = step.shape[1]
    if K <= TERMS:
        return _terms(step, i, rows, "0", K, sets=not step.adds)
    whole, lines = K - K % TERMS, [] if step.adds else _start(step, i, rows)
    lines += [f"for k in range(0, {whole}, {TERMS}):", *_indent(_terms(step, i, rows, "k", TERMS, sets=False))]
    return lines + (_terms(step, i, rows, str(whole), K - whole, sets=False) if whole < K else [])


def _start(step: Product, i: str, rows: int) -> list[str]:
    rows_of = [(_plus(i, r), step.bias) for r in range(rows)]
    outs = [f"{step.out.at(row, 'j')} = {bias.at(row, 'j') if bias else 'ZERO'}" for row, bias in rows_of]
    return [f"for j in range({step.shape[2]}):", *_indent(outs)]


def _terms(step: Product, i: str, rows: int, k: str, terms: int, sets: bool) -> list[str]:
    """A block of rows and terms; `sets` starts the sums, else they go on."""
    pairs = [(r, q) for r in range(rows) for q in range(terms)]
    a = [f"a{r}_{q} = {step.a.at(_plus(i, r), _plus(k, q))}" for r, q in pairs]
    inner = [f"b{q} = {step.b.at(_plus(k, q), 'j')}" for q in range(terms)]
    for r in range(rows):
        target = step.out.at(_plus(i, r), "j")
        start = target if not sets else step.bias.at(_plus(i, r), "j") if step.bias else None
        inner.append(f"{target} = {_sum(start, [f'a{r}_{q} * b{q}' for q in range(terms)], step.shape[2])}")
    return [*a, f"for j in range({step.shape[2]}):", *_indent(inner)]


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


def _indent(lines: list[str]) -> list[str]:
    return [f"    {line}" for line in lines]
