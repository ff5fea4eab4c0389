"""Prediction with one delay per input: an input is its history up to its delay, past it the value of kappa.

With r_j = D_j / D the share of input j in the longest delay and u_j(x) = U_j(t + D_j (x - 1)) its history,
    dP/dx = D_hat f(P, v),   v_j(x) = u_j(x / r_j) for x <= r_j,   kappa_j(P(x), t + x D_hat) for x > r_j
[Bekiaris-Liberis, Krstic, Predictor-Feedback Stabilization of Multi-Input Nonlinear Systems, IEEE TAC 62 (2017) 516].
A step that some r_j lies inside is taken in pieces, so that a method keeps its order where v jumps.
The command is U_j = kappa_j(P(r_j), t + r_j D_hat).
"""

from typing import ClassVar

import numpy as np

from npred.formulas import Array, Value, called_functions, tape
from npred.kernels.formula import Formulas, vector
from npred.kernels.kernel import Kernel
from npred.plants.base import Plant
from npred.prediction.delays import problem
from npred.prediction.delays.problem import PredictionProblem, Step, compiled


class DelayPerInput(PredictionProblem):
    """Each input arrives r_j D late."""

    lacks: ClassVar = ("picard", "semi_implicit", "adaptation", "bound")

    @staticmethod
    def serves(plant: Plant) -> bool:
        return plant.traced and not plant.one_delay

    def expected(self) -> str:
        delays = ", ".join(map(self.plant.time_text, self.plant.delays or ()))
        return f"expected one delay, plant {self.plant.name} has delays {delays}"

    def sweep(self, step: Step, cells: bool = False, more: int = 0) -> Kernel:
        of = Formulas(self.plant, ())
        functions, ratios = {"STEP": self._step(of, step, more)}, [*self.plant.ratios.tolist(), *more * [1.0]]
        return compiled("sweep", problem.PREDICT, "per_input.h", of, functions, M=len(ratios), RATIOS=_array(ratios))

    def control(self, step: Step) -> Kernel:
        n, m, of = self.plant.n, self.plant.m, Formulas(self.plant, ())
        Y, t, D_hat = of.trace.vector("x", n * m), of.trace.input("t"), of.trace.input("D_hat")
        ratios = self.plant.ratios.tolist()
        U = [of.trace.kappa(Y[c * n : (c + 1) * n], t + r * D_hat)[c] for c, r in enumerate(ratios)]
        law = of.function(U, [vector("x", n * m, "wide"), "t", "D_hat"], {"U": m})
        functions = {"STEP": self._step(of, step), "LAW": law}
        return compiled("control", problem.CONTROL, "per_input.h", of, functions, RATIOS=_array(ratios))

    def advance(self, step: Step) -> Kernel:
        n, m, of = self.plant.n, self.plant.m, Formulas(self.plant)
        x, u = of.trace.vector("x", n), of.trace.vector("u", m)
        y = called_functions.stepped(of.trace, step, x, (u, u, u), of.trace.input("t"), of.trace.input("h"))
        y = self.plant.stopped([*y], tape.M)
        functions = {"STEP": of.function(y, [vector("x", n), vector("u", m, "one"), "t", "h"], {"y": n})}
        return compiled("advance", problem.ADVANCE, "per_input_advance.h", of, functions)

    def _step(self, of: Formulas, step: Step, more: int = 0) -> str:
        """One step in place; `past` says which inputs' histories have ended."""
        n, m, trace = self.plant.n, self.plant.m + more, of.trace
        past = {c: trace.input(f"past{c}") for c, r in enumerate(self.plant.ratios) if r < 1}

        def closed(x: Array, u: Array, t: Value) -> Array:
            """f with kappa for the inputs whose history has ended: those that come sooner than the last."""
            law = trace.kappa(x, t)
            v = [tape.M.where(past[c], law[c], v) if c in past else v for c, v in enumerate(u)]
            return trace.f(x, np.array(v), t)

        inputs = [trace.vector(name, m) for name in "amb"]  # at the piece's begin, middle and end
        y = step(closed, trace.vector("x", n), *inputs, trace.input("t"), trace.input("h"))
        y = self.plant.stopped(y, tape.M)
        arguments = [vector("x", n), *(vector(name, m, "wide") for name in "amb"), vector("past", m, "one"), "t", "h"]
        return of.function(y, arguments, {"y": n})


def _array(numbers: list[float]) -> str:
    """Numbers, as C has them."""
    return f"{{{', '.join(map(repr, numbers))}}}"
