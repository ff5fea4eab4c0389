"""The formulas of one plant as C functions, those of a costly plant calling other functions."""

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np

from npred.formulas import called_functions
from npred.formulas.trace import Trace
from npred.kernels import formula
from npred.kernels.formula import Strided, vector


class Formulas:
    """A trace, and C functions of what is made on it; `{name}` stands for the name of each."""

    def __init__(self, plant: Any, called: Collection[str] | None = None) -> None:
        """Of `called` the functions are not written out; by default of those whose programs are long."""
        self.plant = plant
        self.trace = Trace(plant, called_functions.called(plant) if called is None else called)

    def function(
        self, outputs: Any, arguments: Iterable[Strided | str], results: Mapping[str, int], stride: str = "lanes"
    ) -> str:
        """The C function of some outputs; see npred.kernels.formula.function."""
        n, m = self.plant.n, self.plant.m
        sizes = {name: n * getattr(step, "whole", 1) for name, step in self.trace.steps.items()}
        sizes = {"f": n, "df": n, "kappa": m, "law": 2 * m} | sizes
        return formula.function("{name}", outputs, arguments, results, len(self.plant.p), stride, sizes)

    def f(self) -> str:
        """f of x, u with the stride of lanes, to y next to each other."""
        n, m = self.plant.n, self.plant.m
        y = self.trace.f(self.trace.vector("x", n), self.trace.vector("u", m), self.trace.input("t"))
        return self.function(y, [vector("x", n), vector("u", m), "t"], {"y": n}, "one")

    def called(self) -> list[str]:
        """The functions that those of this trace call."""
        texts = []
        for name in self.trace.tape.called():
            arguments, outputs = called_functions.program(self.plant, name, self.trace.steps.get(name))
            read = {argument: f"q[{k}][l]" for k, argument in enumerate(arguments)}
            lines = formula.statements(np.ravel(outputs), read, [f"y[{k}][l]" for k in range(len(outputs))])
            texts.append(formula.called(name, lines))
        return texts
