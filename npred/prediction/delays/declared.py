"""A delay that the plant declares as a function of its state and the time, D(X, t): the horizon moves with the plant.

With H = D(X, t) the history is u(x, t) = U(t + H (x - 1)), and with s the time at which it acts,
    dP/dx = H g f(P, u(x), s),   ds/dx = H g,   g = 1 / (1 - D_X f - D_t),   P(0) = X, s(0) = t,
    U(t) = kappa(P(1), s(1))
[Bekiaris-Liberis, Krstic, Nonlinear Control Under Nonconstant Delays, SIAM 2013]. Where 1 - D_X f - D_t <= 0 commands
would overtake each other and no causal predictor exists: P is NaN from that node on.
"""

from typing import ClassVar

import numpy as np

from npred.formulas import Array, Value, programs, tape
from npred.formulas.trace import Trace
from npred.kernels.formula import Formulas, vector
from npred.kernels.kernel import Kernel, skeleton
from npred.plants.base import Plant
from npred.prediction.delays import problem
from npred.prediction.delays.constant import ConstantDelay
from npred.prediction.delays.problem import CURES, PredictionProblem, Step, compiled

STEPS = 20  # steps of Newton's method for s(1); a delay that is free of time needs one


class DeclaredDelay(PredictionProblem):
    """All inputs arrive D(X, t) late."""

    lacks: ClassVar = ("picard", "semi_implicit", "bound", "adaptation")
    cures: ClassVar = CURES | {"adaptation": "the controller knows that delay: leave the law out"}

    def expected(self) -> str:
        return f"expected a delay that is a number, plant {self.plant.name} declares delay(x, t, p, M)"

    def refusal(self, part: str) -> tuple[str, str] | None:
        """Those of `lacks`, and the files whose U is kappa(P(1), t + D_hat): no command acts at that time."""
        if part in ("onnx", "export c") and not self.plant.rests:
            return f"expected a law free of time, for that of plant {self.plant.name} is read at s(1)", CURES[part]
        return super().refusal(part)

    @staticmethod
    def serves(plant: Plant) -> bool:
        return plant.traced and plant.declares_delay

    def sweep(self, step: Step, cells: bool = False, more: int = 0, timed: bool = False) -> Kernel:
        """With `timed` the time s of each node is one state more, the last one of X and P."""
        n, m, of = self.plant.n, self.plant.m + more, Formulas(self.plant, ())
        trace = of.trace
        state, (u0, um, u1) = trace.vector("x", n + 1), (trace.vector(name, m) for name in "amb")

        def flow(y: Array, u: Array, _: Value) -> Array:
            """d(P, s)/dx / H: the method steps through the time too, as one state more."""
            velocity = trace.f(y[:-1], u, y[-1])
            return np.array([*velocity, 1.0], dtype=object) / _margin(trace, y[:-1], y[-1], velocity)

        y = step(flow, state, u0, um, u1, 0.0, trace.input("h"))
        y = [*self.plant.stopped(y[:-1], tape.M), y[-1]]
        margin = _margin(trace, state[:-1], state[-1], trace.f(state[:-1], u0[: self.plant.m], state[-1]))
        inputs = [vector(name, m, "wide") for name in "amb"]
        functions = {"STEP": of.function([*y, margin], [vector("x", n + 1, "one"), *inputs, "h"], {"y": n + 2}, "one")}
        sizes = {"M": m, "TIMED": int(timed), "MIDDLE": int(programs.depends(y, um))}
        return compiled("sweep", problem.PREDICT, "declared.h", of, functions, [skeleton("reading.h")], **sizes)

    def control(self, step: Step) -> Kernel:
        n, m, of = self.plant.n, self.plant.m, Formulas(self.plant, ())
        x, s, t = of.trace.vector("x", n), of.trace.input("s"), of.trace.input("t")
        delay = of.trace.delay(x, s)
        by_time = programs.derivative([delay], [s], [1.0])[0]
        after = [s - (s - t - delay) / (1.0 - by_time)]
        functions = {
            "TIME": of.function(after, [vector("x", n), "s", "t"], {"after": 1}, "one"),
            "KAPPA": of.function(of.trace.kappa(x, s), [vector("x", n), "s"], {"U": m}),
        }
        steps = STEPS if programs.depends([delay], [s]) else 1
        return compiled("control", problem.CONTROL, "control.h", of, functions, STEPS=steps)

    def advance(self, step: Step) -> Kernel:
        return ConstantDelay(self.plant).advance(step)  # the engine says when the inputs switch

    def horizon(self) -> Kernel:
        n, of = self.plant.n, Formulas(self.plant, ())
        delay = of.trace.delay(of.trace.vector("x", n), of.trace.input("t"))
        text = of.function([delay], [vector("x", n), "t"], {"value": 1}, "one")
        return compiled("horizon", problem.HORIZON, "horizon.h", of, {"VALUE": text})

    def speed(self) -> Kernel:
        n, m, of = self.plant.n, self.plant.m, Formulas(self.plant, ())
        x, u, t = of.trace.vector("x", n), of.trace.vector("u", m), of.trace.input("t")
        margin = _margin(of.trace, x, t, of.trace.f(x, u, t))
        text = of.function([margin], [vector("x", n), vector("u", m), "t"], {"value": 1}, "one")
        return compiled("speed", problem.SPEED, "speed.h", of, {"VALUE": text})


def _margin(trace: Trace, x: Array, t: Value, velocity: Array) -> Value:
    """1 - D_X f - D_t."""
    return 1.0 - programs.derivative([trace.delay(x, t)], [t, *x], [1.0, *velocity])[0]
