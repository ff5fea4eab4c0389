"""One constant delay, and a plant that is traced: formulas in C skeletons, compiled."""

from functools import partial
from typing import ClassVar

import numpy as np

from npred.formulas import Array, Value, called_functions, programs, tape
from npred.formulas.trace import Trace
from npred.kernels.formula import Formulas, vector
from npred.kernels.kernel import Kernel, skeleton
from npred.plants.base import Plant
from npred.prediction.delays import problem
from npred.prediction.delays.problem import PredictionProblem, Step, compiled, transition


class ConstantDelay(PredictionProblem):
    """All inputs arrive D late."""

    reads_cells: ClassVar = True

    @staticmethod
    def serves(plant: Plant) -> bool:
        return plant.traced and plant.one_delay and not plant.declares_delay

    def sweep(self, step: Step, cells: bool = False, more: int = 0) -> Kernel:
        n, m, of = self.plant.n, self.plant.m + more, Formulas(self.plant)
        x, (u0, um, u1) = of.trace.vector("x", n), (of.trace.vector(name, m) for name in ("a", "m", "b"))
        y = called_functions.stepped(of.trace, step, x, (u0, um, u1), of.trace.input("t"), of.trace.input("h"))
        y = self.plant.stopped(y, tape.M)
        middle = programs.depends(y, um)
        if hasattr(step, "whole") and not cells:
            middle = called_functions.reads_middle(self.plant, step)
        stride = "wide" if middle and not cells else "lanes"
        inputs = vector("a", m, stride), vector("m", m, "wide"), vector("b", m, stride)
        functions = {"STEP": of.function(y, [vector("x", n), *inputs, "t", "h"], {"y": n})}
        before, sizes = [skeleton("reading.h")], {"M": m, "CELLS": int(cells), "MIDDLE": int(middle)}
        return compiled("sweep", problem.PREDICT, "sweep.h", of, functions, before, **sizes)

    def paired(self, step: Step, cells: bool = False) -> Kernel:
        n, m, of = self.plant.n, self.plant.m, Formulas(self.plant)
        x, (u0, u1) = of.trace.vector("x", 2 * n), (of.trace.vector(name, m) for name in ("a", "b"))
        inputs = u0, 0.5 * (u0 + u1), u1
        y = called_functions.stepped(of.trace, step, x, inputs, of.trace.input("t"), of.trace.input("h"))
        arguments = [vector("x", 2 * n, "one"), vector("a", m), vector("b", m), "t", "h"]
        functions = {"STEP": of.function(y, arguments, {"y": 2 * n}, "one")}
        return compiled("paired", problem.PREDICT, "paired.h", of, functions, CELLS=int(cells))

    def picard(self, tolerance: float, sweeps: int) -> Kernel:
        of = Formulas(self.plant)
        sizes = {"TOLERANCE": repr(tolerance), "SWEEPS": sweeps}
        return compiled("picard", problem.PREDICT, "picard.h", of, {"F": of.f()}, **sizes)

    def control(self, step: Step) -> Kernel:
        n, m, of = self.plant.n, self.plant.m, Formulas(self.plant)
        U = of.trace.kappa(of.trace.vector("x", n), of.trace.input("t"))
        functions = {"KAPPA": of.function(U, [vector("x", n), "t"], {"U": m})}
        return compiled("control", problem.CONTROL, "control.h", of, functions)

    def update(self) -> Kernel:
        n, m, of = self.plant.n, self.plant.m, Formulas(self.plant)
        trace = of.trace
        x, u, t, h = trace.vector("x", n), trace.vector("a", m), trace.input("t"), trace.input("h")
        r, s = trace.vector("r", n), trace.vector("s", n)
        first, df = trace.f(x, u, t), partial(trace.df, dt=1.0)
        start = [vector("x", n), vector("a", m)]
        after = [*start, vector("r", n, "wide"), vector("s", n, "wide")]
        written = {"r_next": n, "s_next": n, "products": 2}
        one = _node(trace, x, u, t, first, h * df(x, u, t, first))
        node = _node(trace, x, u, t, *transition(df, x, u, t, h, r, s))
        functions = {
            "FIRST": of.function(one, [*start, "t", "h"], written, "wide"),
            "NODE": of.function(node, [*after, "t", "h"], written, "wide"),
            "VALUE": of.function([trace.V(x, t)], [vector("x", n), "t"], {"value": 1}, "wide"),
        }
        return compiled("update", problem.UPDATE, "update.h", of, functions)

    def correction(self) -> Kernel:
        """With e = P̂ - P, e' = D_hat f_P(P̂, u) e + δ, δ = P̂' - D_hat f(P̂, u), e(0) = P̂(0) - X; both of order 2."""
        n, m, of = self.plant.n, self.plant.m, Formulas(self.plant)
        x, u, e = of.trace.vector("x", n), of.trace.vector("u", m), of.trace.vector("e", n)
        along = of.trace.df(x, u, of.trace.input("t"), e)
        slope = of.function(along, [vector("x", n), vector("u", m), vector("e", n, "one"), "t"], {"d": n}, "one")
        return compiled("correction", problem.CORRECT, "correction.h", of, {"F": of.f(), "SLOPE": slope})

    def advance(self, step: Step) -> Kernel:
        n, m, of = self.plant.n, self.plant.m, Formulas(self.plant)
        x, u = of.trace.vector("x", n), of.trace.vector("u", m)
        y = called_functions.stepped(of.trace, step, x, (u, u, u), of.trace.input("t"), of.trace.input("h"))
        y = self.plant.stopped([*y], tape.M)
        functions = {"STEP": of.function(y, [vector("x", n), vector("u", m), "t", "h"], {"y": n}, "wide")}
        return compiled("advance", problem.ADVANCE, "advance.h", of, functions)


def _node(trace: Trace, x: Array, u: Array, t: Value, r: Array, s: Array) -> list[Value]:
    """r and s of the node, q1 w and w²."""
    kappa, q1 = trace.law(x, t, r, 1.0)
    w = u - kappa
    return [*r, *s, np.dot(q1, w), np.dot(w, w)]
