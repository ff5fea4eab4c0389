"""A law as the Python that it is: called as a plant's kappa is, printed to be pasted, pickled by its text."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from npred.formulas import Parameters, Value, programs
from npred.formulas.tape import FUNCTIONS, OPS, Functions, Vector, names
from npred.formulas.trace import Trace
from npred.plants.base import Plant

DIGITS = 8  # digits of a gain: more differ between libraries of linear algebra, and gains enter keys
SMALL = 1e-9  # share of a law's largest term that is rounding
TEXTS = {
    name: f"M.{name}({', '.join(f'{{{k}}}' for k in range(op.text.count('{')))})"
    for name, op in OPS.items()
    if name in FUNCTIONS
} | {"where": "M.where({0}, {1}, {2})", "interp": "M.interp({0}, {1})"}


@dataclass(frozen=True)
class Law:
    """A law kappa(x, t, p, M) by the text of its definition, which can be pasted into a plant's class.

    A plant with it has this `guess`: a law holds the rest that it was designed for, and perhaps no other.

    Parameters
    ----------
    text : str
        The definition of kappa in Python.
    guess : (n,), the states' units
        The rest that the law holds.
    made_for : dict, optional
        The formulas of the plant that it was designed for: another one refuses it, but takes its text.
    """

    text: str
    guess: tuple[float, ...]
    made_for: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    @cached_property
    def function(self) -> Callable[..., list[Value]]:
        """The function that the text defines."""
        space: dict[str, Any] = {"np": np}
        exec(self.text, space)
        return space["kappa"]

    def __call__(self, x: Parameters, t: Value, p: Parameters, M: Functions) -> list[Value]:
        return self.function(x, t, p, M)

    def __str__(self) -> str:
        return self.text

    def __reduce__(self) -> tuple[type["Law"], tuple[str, tuple[float, ...], Mapping[str, Any]]]:
        return Law, (self.text, self.guess, self.made_for)


def written(trace: Trace, guess: tuple[float, ...], outputs: Vector) -> Law:
    """The law whose values are these expressions of the trace's x, t and parameters."""
    plant: Plant = trace.plant
    bindings = {f"x{k}": f"x.{name}" for k, name in enumerate(plant.states)}
    bindings |= {f"p{k}": f"p.{name}" for k, name in enumerate(plant.p_names)}
    results = names("u", plant.m)
    lines = programs.lines(outputs, bindings, results, TEXTS)
    return _defined([*lines, f"return [{', '.join(results)}]"], guess, plant)


def linear(plant: Plant, K: np.ndarray, X: np.ndarray, u: np.ndarray, widths: np.ndarray) -> Law:
    """u - K (x - X) for K (m, n), X (n,), u (m,), or those of the set-point, without the terms that are rounding for
    errors of those widths."""
    commands, errors = [], [error(f"x.{name}", rest) for name, rest in zip(plant.states, X, strict=True)]
    named = [f"p.{name}" for name in plant.p_names[-plant.n - plant.m :]] if plant.declares_setpoint else []
    if named:
        errors = [f"(x.{name} - {rest})" for name, rest in zip(plant.states, named[: plant.n], strict=True)]
    for k, (at_rest, gains) in enumerate(zip(u, K, strict=True)):
        sizes = np.abs(gains) * widths
        terms = [
            f"{'-' if gain > 0 else '+'} {abs(gain):.{DIGITS}g} * {away}"
            for away, gain, size in zip(errors, gains, sizes, strict=True)
            if size > SMALL * sizes.max()
        ]
        if named:
            terms.insert(0, named[plant.n + k])
        elif at_rest or not terms:
            terms.insert(0, f"{at_rest:.12g}")
        else:
            sign, first = terms[0].split(" ", 1)
            terms[0] = first if sign == "+" else f"-{first}"
        commands.append(" ".join(terms))
    return _defined([f"return [{', '.join(commands)}]"], tuple(X.tolist()), plant)


def error(state: str, rest: float) -> str:
    """state - rest, in brackets, as text; without a rest that is 0."""
    return f"({state} {'-' if rest > 0 else '+'} {abs(rest):.12g})" if rest else state


def rounded(values: Any) -> np.ndarray:
    """The values to DIGITS digits."""
    return np.array([float(f"{value:.{DIGITS}g}") for value in np.ravel(values)]).reshape(np.shape(values))


def _defined(lines: Sequence[str], guess: tuple[float, ...], plant: Plant) -> Law:
    text = "\n".join(["def kappa(x, t, p, M):", *(f"    {line}" for line in lines)]) + "\n"
    return Law(text, guess, plant.formulas)
