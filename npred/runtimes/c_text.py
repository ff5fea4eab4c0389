"""A program printed as C99: plain loops over static arrays, which a compiler for a microcontroller reads too."""

from collections.abc import Iterable
from functools import partial

import numpy as np

from npred.json_files import escaped
from npred.plants.base import Plant
from npred.runtimes.program import Product, Repeat, Silu, SiluPair, Step, Transpose, loops
from npred.symbolic import programs
from npred.symbolic.trace import Trace

MATHEMATICS = {
    "pow": "pow({0}, {1})", "abs": "fabs({0})", "sign": "(double)(({0} > 0) - ({0} < 0))",
    "where": "{0} ? {1} : {2}", "maximum": "{1} > {0} ? {1} : {0}", "minimum": "{1} < {0} ? {1} : {0}",
} | {name: f"{name}({{0}})" for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "tanh")}  # fmt: skip

_loops = partial(loops, head="for (int {0} = 0; {0} < {1}; {0}++) {{", tail=["}"])


def comment(text: str) -> str:
    """The text as a comment may hold it: it cannot end the comment, nor begin one, and is no trigraph."""
    return escaped(text).replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


def constant(name: str, values: np.ndarray) -> str:
    """A static array, its numbers exact in hexadecimal."""
    kind, suffix = ("float", "f") if values.dtype == np.float32 else ("double", "")
    numbers = [float(value).hex() + suffix for value in values]
    rows = [", ".join(numbers[i : i + 6]) for i in range(0, len(numbers), 6)]
    return f"static const {kind} {name}[{len(numbers)}] = {{\n    " + ",\n    ".join(rows) + "\n};"


def steps(program: Iterable[Step]) -> list[str]:
    """The lines of some steps."""
    return [line for step in program for line in _step(step)]


def _step(step: Step) -> list[str]:
    if isinstance(step, Product):
        return _product(step)
    if isinstance(step, Repeat):
        views = [f"const float *{m.view} = {m.name} + o * {m.layer};" for m in step.stacks]
        return _loops({"o": step.count}, [*views, *steps(step.steps)])
    if isinstance(step, Silu | SiluPair):
        name = "silu" if isinstance(step, Silu) else "silu_pair"
        return [f"{name}({step.a}, {step.count}, {step.out});"]
    if isinstance(step, Transpose):
        line = f"{step.out.at('j', 'i')} = {step.a.at('i', 'j')};"
        return _loops({"i": step.shape[0], "j": step.shape[1]}, [line])
    even, odd, half = step.even.at("i", "j"), step.odd.at("i", "j"), (step.nx + 1) // 2
    mirrored = f"{step.out.at('i', f'{step.nx - 1} - j')} = {even} - {odd};"
    return _loops({"i": step.rows, "j": half}, [mirrored, f"{step.out.at('i', 'j')} = {even} + {odd};"])


def _product(step: Product) -> list[str]:
    M, K, N = step.shape
    out, inner = step.out.at("i", "j"), f"{step.out.at('i', 'j')} += factor * {step.b.at('k', 'j')};"
    start = [] if step.adds else _loops({"j": N}, [f"{out} = {step.bias.at('i', 'j') if step.bias else '0'};"])
    terms = _loops({"k": K}, [f"const float factor = {step.a.at('i', 'k')};", *_loops({"j": N}, [inner])])
    lines = _loops({"i": M}, [*start, *terms])
    return lines if step.repeats == 1 else _loops({"e": step.repeats}, lines)


def control_law(plant: Plant, only: int | None = None) -> list[str]:
    """The lines of U = kappa(X, t), from the plant's formulas; of all inputs, or `only` of one."""
    trace = Trace(plant)
    outputs = trace.kappa(trace.vector("x", plant.n), trace.input("t"))
    bindings = {f"x{k}": f"X[{k}]" for k in range(plant.n)} | {"t": "t"}
    bindings |= {f"p{k}": f"({value!r})" for k, value in enumerate(plant.p.tolist())}
    chosen = range(plant.m) if only is None else [only]
    lines = programs.lines([outputs[k] for k in chosen], bindings, [f"U[{k}]" for k in chosen], MATHEMATICS)
    words = [line.replace("np.inf", "INFINITY").replace("np.nan", "NAN") for line in lines]
    return [f"{'' if line.startswith('U[') else 'const double '}{line};" for line in words]
