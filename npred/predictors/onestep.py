"""One-step methods: a formula for the step, traced with the plant and swept over the nodes by one kernel."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

from npred.plants.black_box import BlackBox
from npred.predictors import array_predictors, multi_delay
from npred.predictors.base import SIGNATURE, Compiled
from npred.symbolic import called_functions, kernels, programs

# With few lanes the states stay in registers along x; with many, the lanes are the SIMD loop. A long step fits no
# registers, and compiling it twice takes twice as long.
SOURCE = """\
def sweep(X, u, D_hat, t, p, P):
    nx, n, lanes = P.shape
    {parameters}
    {few}
    for c in range(n):
        for l in range(lanes):
            P[0, c, l] = X[c, l]
    for j in range(nx - 1):
        {weights}
        for l in range(lanes):
            h = D_hat[l] / (nx - 1)
            {lane}
"""

FEW = """\
if lanes < 4:
    for l in range(lanes):
        h = D_hat[l] / (nx - 1)
        {start}
        for j in range(nx - 1):
            {weights}
            {scalar}
    return
"""
LONG = 500  # lines

# u at the middle of a cell by the cubic through four nodes, one-sided in the end cells; linear where nx < 4.
WEIGHTS = """\
a, wa, wb, wc, wd = j - 1, -0.0625, 0.5625, 0.5625, -0.0625
if nx < 4:
    a, wa, wb, wc, wd = 0, 0.0, 0.0, 0.0, 0.0
elif j == 0:
    a, wa, wb, wc, wd = 0, 0.3125, 0.9375, -0.3125, 0.0625
elif j == nx - 2:
    a, wa, wb, wc, wd = nx - 4, 0.0625, -0.3125, 0.9375, 0.3125
linear = 0.5 if nx < 4 else 0.0
b, c, d = min(a + 1, nx - 1), min(a + 2, nx - 1), min(a + 3, nx - 1)"""


class OneStep(Compiled):
    """x_{j+1} = step(x_j): `step` is the method's formula on arrays, of the declared order for smooth u."""

    @staticmethod
    @abstractmethod
    def step(f: Callable[..., Any], x: Any, u0: Any, um: Any, u1: Any, t: Any, h: Any) -> Any:
        """x(t + h) from x(t), the input being u0, um, u1 at t, t + h/2, t + h."""

    def compile(self) -> Callable[..., None]:
        if isinstance(self.plant, BlackBox):
            return array_predictors.sweep(self.plant, self.step)
        if not self.plant.one_delay:
            return kernels.build("sweep", SIGNATURE, multi_delay.sweep(self.plant, self.step), multi_delay.PREAMBLE)
        return kernels.build("sweep", SIGNATURE, *self._source())

    def _source(self) -> tuple[str, str]:
        """The kernel's text, and the lines that stand before it."""
        n, m, trace = self.plant.n, self.plant.m, called_functions.trace(self.plant)
        x, (u0, um, u1) = trace.vector("x", n), (trace.vector(name, m) for name in ("a", "m", "b"))
        y = self.step(trace.f, x, u0, um, u1, trace.input("t"), trace.input("h"))
        bindings = {"t": "(t + j * h)"}
        for k in range(m):
            middle = " + ".join(f"w{i} * u[{i}, {k}, l]" for i in "abcd")
            middle = f"({middle} + linear * (u[j, {k}, l] + u[j + 1, {k}, l]))"
            bindings |= {f"a{k}": f"u[j, {k}, l]", f"b{k}": f"u[j + 1, {k}, l]", f"m{k}": middle}
        scalar = programs.lines(y, bindings, [f"y{k}" for k in range(n)])
        scalar += [f"x{k} = P[j + 1, {k}, l] = y{k}" for k in range(n)]
        target = [f"P[j + 1, {k}, l]" for k in range(n)]
        weights = WEIGHTS.splitlines() if programs.depends(y, um) else []
        start = [f"x{k} = P[0, {k}, l] = X[{k}, l]" for k in range(n)]
        few = kernels.fill(FEW, start=start, weights=weights, scalar=scalar).splitlines()
        source = kernels.fill(
            SOURCE,
            parameters=kernels.parameters(len(self.plant.p)),
            few=few if len(scalar) < LONG else [],
            weights=weights,
            lane=programs.lines(y, bindings | {f"x{k}": f"P[j, {k}, l]" for k in range(n)}, target),
        )
        return source, called_functions.imports(trace)
