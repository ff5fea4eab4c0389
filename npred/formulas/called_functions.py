"""Costly plants: f, kappa and their derivatives compiled once as separate functions, which the kernels call.

Written out, RK4 holds f four times and the update law its derivative twice; a compiler's time grows faster than that.
"""

import re
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from npred.formulas import Value, programs
from npred.formulas.declared import Declared
from npred.formulas.tape import names
from npred.formulas.trace import Trace

LONG = 150  # lines from which on a function is called; below, all fits into registers and SIMD lanes
LONG_STEP = 500  # lines of an implicit step, which holds its matrix and elimination

Step = Callable[..., np.ndarray]  # npred.prediction.methods.base


@cache
def called(plant: Declared) -> tuple[str, ...]:
    """The functions of the plant that its kernels call: those whose programs are long, and call no network."""
    texts = {name: lines(plant, name) for name in (("f", "kappa") if plant.declares_kappa else ("f",))}
    return tuple(name for name, text in texts.items() if len(text) > LONG and "plant_network" not in "".join(text))


def whole(step: Step, chains: int = 1) -> Step:
    """Mark the formula of an implicit step: it reads derivatives or mechanics, for which f has to be written out.

    `chains` is how many states side by side it advances.
    """
    step.whole = chains  # type: ignore[attr-defined]
    return step


def composed(step: Step) -> Step:
    """Mark the formula of steps that is made of those of another method, which it takes by `stepped`."""
    step.composed = True  # type: ignore[attr-defined]
    return step


def stepped(f: Trace | Step, step: Step, x: np.ndarray, inputs: Sequence[np.ndarray], t: Value, h: Value) -> np.ndarray:
    """x(t + h) by a one-step method's formula for an f, the inputs being u0, um, u1; a long implicit one is called."""
    trace = f
    if not isinstance(trace, Trace):
        return step(f, x, *inputs, t, h)
    if not hasattr(step, "whole"):
        return step(trace.f if not hasattr(step, "composed") else trace, x, *inputs, t, h)
    name = re.sub(r"\W", "_", step.__qualname__).lower() + ("_held" if inputs[0] is inputs[2] else "")
    if "f" not in trace.called and operations(trace.plant, name, step) <= LONG_STEP:
        return step(trace, x, *inputs, t, h)
    trace.steps[name] = step
    u = inputs[0] if inputs[0] is inputs[2] else np.concatenate(inputs)
    return np.array(trace.tape.call(name, [t, *x, *u, *trace.parameters, h], 0, len(x)), dtype=object)


def operations(plant: Declared, name: str, step: Step | None = None) -> int:
    """How many lines the program of a function has, or of a step, f written out."""
    return len(lines(plant, name, step))


def lines(plant: Declared, name: str, step: Step | None = None) -> list[str]:
    """Those lines."""
    _, outputs = program(plant, name, step)
    return programs.lines(outputs, {}, names("y", len(outputs)))


def program(plant: Declared, name: str, step: Step | None = None) -> tuple[list[str], np.ndarray]:
    """Names of the arguments and results of f, its derivative df along (v, dt), kappa, kappa with its law, a step."""
    trace = Trace(plant)
    if step is not None:
        n, m, held = plant.n * getattr(step, "whole", 1), plant.m, name.endswith("_held")
        prefixes = "a" if held else "amb"
        inputs = [trace.vector(prefix, m) for prefix in prefixes] * (3 if held else 1)
        outputs = step(trace, trace.vector("x", n), *inputs, trace.input("t"), trace.input("h"))
        arguments = ["t", *names("x", n), *(name for prefix in prefixes for name in names(prefix, m))]
        return [*arguments, *names("p", len(trace.parameters)), "h"], outputs
    x, u, v = trace.vector("x", plant.n), trace.vector("u", plant.m), trace.vector("d", plant.n)
    t, dt = trace.input("t"), trace.input("dt")
    read = {"f": (x, u, t), "df": (x, u, t, v, dt), "kappa": (x, t), "law": (x, t, v, dt)}[name]
    outputs = np.ravel(getattr(trace, name)(*read))
    arguments = ["t", *names("x", plant.n), *(names("u", plant.m) if u is read[1] else [])]
    arguments += names("p", len(plant.p_names)) + (["dt", *names("d", plant.n)] if read[-1] is dt else [])
    return arguments, outputs


@cache
def reads_middle(plant: Declared, step: Step) -> bool:
    """True if an implicit step takes u in the middle of it: a call does not tell which of its inputs are read."""
    trace = Trace(plant)
    inputs = [trace.vector(prefix, plant.m) for prefix in "amb"]
    y = step(trace, trace.vector("x", plant.n), *inputs, trace.input("t"), trace.input("h"))
    return programs.depends(y, inputs[1])
