"""A delay that the plant declares as a function of its state and the time, D(X, t): the horizon moves with the plant.

With H = D(X, t) the history is u(x, t) = U(t + H (x - 1)), and with s the time at which it acts,
    dP/dx = H g f(P, u(x), s),   ds/dx = H g,   g = 1 / (1 - D_X f - D_t),   P(0) = X, s(0) = t,
    U(t) = kappa(P(1), s(1))
[Bekiaris-Liberis, Krstic, Nonlinear Control Under Nonconstant Delays, SIAM 2013]. Where 1 - D_X f - D_t <= 0 commands
would overtake each other and no causal predictor exists: P is NaN from that node on.
"""

from typing import Any, ClassVar

import numpy as np

from npred.delays import family
from npred.delays.constant import WEIGHTS, ConstantDelay, input_lines
from npred.delays.family import Family, Kernel, Step
from npred.symbolic import kernels, programs, tape
from npred.symbolic.trace import Trace

SWEEP = """\
    nx, n, lanes = P.shape
    {parameters}
    for l in range(lanes):
        h, s = D_hat[l] / (nx - 1), t
        for c in range(n):
            P[0, c, l] = X[c, l]
        for j in range(nx - 1):
            {weights}
            {node}
            if not margin > 0.0:
                P[j + 1:, :, l] = np.nan
                break
"""

# s(1) solves s = t + D(P(1), s), by Newton's method from s = t + H; a delay that is free of time needs one step.
CONTROL = """\
    lanes, j = P.shape[2], P.shape[0] - 1
    {parameters}
    for l in range(lanes):
        s = t + D_hat[l]
        for _ in range(STEPS):
            {time}
        {law}
"""
STEPS = 20

ROWS = """\
    {parameters}
    for l in range(X.shape[1]):
        {lines}
        for c in range({target}.shape[0]):
            {target}[c, l] = value
"""


class DeclaredDelay(Family):
    """All inputs arrive D(X, t) late."""

    lacks: ClassVar = {
        "picard": "use rk4",
        "semi_implicit": "use rosenbrock",
        "published": "use euler, heun or rk4",
        "euler_python": "use euler, heun or rk4",
        "defect": "take by = 'shadow'",
        "bound": "take error, an estimate",
        "adaptation": "the controller knows that delay: leave the law out",
    }

    def expected(self) -> str:
        return f"expected a delay that is a number, plant {self.plant.name} declares delay(x, t, p, M)"

    def refusal(self, part: str) -> tuple[str, str] | None:
        """Those of `lacks`, and the files whose U is kappa(P(1), t + D_hat): no command acts at that time."""
        cures = {"onnx": "use the runtime torch or fused", "export c": "use npred.controller"}
        if part in cures and not self.plant.rests:
            return f"expected a law free of time, for that of plant {self.plant.name} is read at s(1)", cures[part]
        return super().refusal(part)

    @staticmethod
    def serves(plant: Any) -> bool:
        return plant.traced and plant.declares_delay

    def sweep(self, step: Step, timed: bool = False) -> Kernel:
        """With `timed` the time s of each node is one state more, the last one of X and P."""
        n, m, trace = self.plant.n, self.plant.m, Trace(self.plant)
        state, (u0, um, u1) = trace.vector("x", n + 1), (trace.vector(name, m) for name in ("a", "m", "b"))

        def flow(y: Any, u: Any, _: Any) -> Any:
            """d(P, s)/dx / H: the method steps through the time too, as one state more."""
            velocity = trace.f(y[:-1], u, y[-1])
            return np.array([*velocity, 1.0], dtype=object) / self._margin(trace, y[:-1], y[-1], velocity)

        y = step(flow, state, u0, um, u1, 0.0, trace.input("h"))
        y = [*self.plant.stopped(y[:-1], tape.M), y[-1]]
        margin = self._margin(trace, state[:-1], state[-1], trace.f(state[:-1], u0, state[-1]))
        names = {f"x{k}": f"P[j, {k}, l]" for k in range(n)} | {f"x{n}": "s"} | input_lines(m)
        targets = [*(f"P[j + 1, {k}, l]" for k in range(n)), "after", "margin"]
        clock = [f"P[j + 1, {n}, l] = s"] if timed else []
        node = [*programs.lines([*y, margin], names, targets), "s = after", *clock]
        weights = WEIGHTS.splitlines() if programs.depends(y, um) else []
        source = kernels.fill(SWEEP, parameters=kernels.parameters(len(self.plant.p)), weights=weights, node=node)
        return family.build("sweep", family.PREDICT, source)

    @staticmethod
    def _margin(trace: Trace, x: Any, t: Any, velocity: Any) -> Any:
        """1 - D_X f - D_t."""
        return 1.0 - programs.derivative([trace.delay(x, t)], [t, *x], [1.0, *velocity])[0]

    def control(self, step: Step) -> Kernel:
        trace = Trace(self.plant)
        x, s, t = trace.vector("x", self.plant.n), trace.input("s"), trace.input("t")
        delay = trace.delay(x, s)
        by_time = programs.derivative([delay], [s], [1.0])[0]
        names = {f"x{k}": f"P[j, {k}, l]" for k in range(self.plant.n)}
        time = programs.lines([s - (s - t - delay) / (1.0 - by_time)], names, ["s"])
        law = programs.lines(trace.kappa(x, s), names, [f"U[{c}, l]" for c in range(self.plant.m)])
        text = CONTROL.replace("STEPS", str(STEPS if programs.depends([delay], [s]) else 1))
        source = kernels.fill(text, parameters=kernels.parameters(len(self.plant.p)), time=time, law=law)
        return family.build("control", family.CONTROL, source)

    def advance(self, step: Step) -> Kernel:
        return ConstantDelay(self.plant).advance(step)  # the engine says when the inputs switch

    def horizon(self) -> Kernel:
        trace = Trace(self.plant)
        x, t = trace.vector("x", self.plant.n), trace.input("t")
        return self._rows("horizon", family.HORIZON, "D", trace.delay(x, t), ["D_hat[l] = value"])

    def speed(self) -> Kernel:
        trace = Trace(self.plant)
        x, u, t = trace.vector("x", self.plant.n), trace.vector("u", self.plant.m), trace.input("t")
        return self._rows("speed", family.SPEED, "speed", self._margin(trace, x, t, trace.f(x, u, t)), [])

    def _rows(self, name: str, arguments: str, target: str, value: Any, more: list[str]) -> Kernel:
        """The kernel that writes a value to each row of the target."""
        names = {f"x{k}": f"X[{k}, l]" for k in range(self.plant.n)}
        names |= {f"u{c}": f"U[{c}, l]" for c in range(self.plant.m)}
        lines = [*programs.lines([value], names, ["value"]), *more]
        text = ROWS.replace("{target}", target)
        source = kernels.fill(text, parameters=kernels.parameters(len(self.plant.p)), lines=lines)
        return family.build(name, arguments, source)
