"""One constant delay, and a plant that is traced: straight-line kernels, compiled."""

from functools import partial
from typing import Any, ClassVar

import numpy as np

from npred.delays import correction, family
from npred.delays.family import Family, Kernel, Step, transition
from npred.plants.base import Plant
from npred.symbolic import called_functions, kernels, programs, tape
from npred.symbolic.trace import Trace

# With few lanes the states stay in registers along x; with many, the lanes are the SIMD loop. A long step fits no
# registers, and compiling it twice takes twice as long.
SWEEP = """\
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

PAIRED = """\
    nx, n, lanes = P.shape
    {parameters}
    for l in range(lanes):
        h = D_hat[l] / (nx - 1)
        {start}
        for j in range(nx - 1):
            {lane}
"""

PICARD = """\
    nx, n, lanes = P.shape
    {parameters}
    before, total = np.empty(n), np.empty(n)
    for l in range(lanes):
        h = D_hat[l] / (nx - 1)
        for j in range(nx):
            for c in range(n):
                P[j, c, l] = X[c, l]
        for _ in range(SWEEPS):
            change = size = 0.0
            for j in range(nx):
                {node}
                for c in range(n):
                    y = X[c, l] if j == 0 else total[c] + h / 2 * (before[c] + f[c])
                    change, size = max(change, abs(y - P[j, c, l])), max(size, abs(y))
                    total[c], before[c], P[j, c, l] = y, f[c], y
            if change <= TOLERANCE * (1.0 + size):
                break
        else:
            P[:, :, l] = np.nan
"""

UPDATE = """\
    nx, n, lanes = P.shape
    {parameters}
    r, s = np.empty((n, lanes)), np.empty((n, lanes))
    I1, I2 = np.empty(lanes), np.empty(lanes)
    j = 0
    for l in range(lanes):
        h = D_hat[l] / (nx - 1)
        {first}
        I1[l] = 0.5 * i1
        I2[l] = 0.5 * i2
    for j in range(1, nx):
        weight = (1.0 + j / (nx - 1)) * (0.5 if j == nx - 1 else 1.0)
        for l in range(lanes):
            h = D_hat[l] / (nx - 1)
            {node}
            I1[l] += weight * i1
            I2[l] += weight * i2
    for l in range(lanes):
        {end}
        N[l] = 1.0 + v + b * I2[l] / (nx - 1)
        phi[l] = -I1[l] / (nx - 1) / N[l]
"""

CONTROL = """\
    lanes = P.shape[2]
    {parameters}
    j = P.shape[0] - 1
    for l in range(lanes):
        h = D_hat[l] / j
        {end}
"""

ADVANCE = """\
    {parameters}
    for l in range(X.shape[1]):
        h, start = share[0, l] * dt, t
        {first}
    for l in range(X.shape[1]):
        if share[0, l] < 1.0:
            h, start = (1.0 - share[0, l]) * dt, t + share[0, l] * dt
            {second}
"""


class ConstantDelay(Family):
    """All inputs arrive D late."""

    reads_cells: ClassVar = True

    @staticmethod
    def serves(plant: Plant) -> bool:
        return plant.traced and plant.one_delay and not plant.declares_delay

    def sweep(self, step: Step, cells: bool = False) -> Kernel:
        return family.build("sweep", family.PREDICT, *self.source(step, cells))

    def source(self, step: Step, cells: bool = False) -> tuple[str, str]:
        """The text of the sweep, and the lines that stand before it."""
        n, m, trace = self.plant.n, self.plant.m, called_functions.trace(self.plant)
        x, (u0, um, u1) = trace.vector("x", n), (trace.vector(name, m) for name in ("a", "m", "b"))
        y = called_functions.stepped(trace, step, x, (u0, um, u1), trace.input("t"), trace.input("h"))
        y = self.plant.stopped(y, tape.M)
        bindings = {"t": "(t + j * h)"} | (cell_lines(m) if cells else input_lines(m))
        scalar = programs.lines(y, bindings, [f"y{k}" for k in range(n)])
        scalar += [f"x{k} = P[j + 1, {k}, l] = y{k}" for k in range(n)]
        target = [f"P[j + 1, {k}, l]" for k in range(n)]
        weights = WEIGHTS.splitlines() if programs.depends(y, um) and not cells else []
        start = [f"x{k} = P[0, {k}, l] = X[{k}, l]" for k in range(n)]
        few = kernels.fill(FEW, start=start, weights=weights, scalar=scalar).splitlines()
        source = kernels.fill(
            SWEEP,
            parameters=kernels.parameters(len(self.plant.p)),
            few=few if len(scalar) < LONG else [],
            weights=weights,
            lane=programs.lines(y, bindings | {f"x{k}": f"P[j, {k}, l]" for k in range(n)}, target),
        )
        return source, called_functions.imports(trace)

    def paired(self, step: Step, cells: bool = False) -> Kernel:
        n, m, trace = self.plant.n, self.plant.m, called_functions.trace(self.plant)
        x, (u0, u1) = trace.vector("x", 2 * n), (trace.vector(name, m) for name in ("a", "b"))
        inputs = u0, 0.5 * (u0 + u1), u1
        names = {"t": "(t + j * h)"} | (cell_lines(m) if cells else input_lines(m))
        y = called_functions.stepped(trace, step, x, inputs, trace.input("t"), trace.input("h"))
        targets = [*(f"y{k}" for k in range(2 * n)), *(f"P[j + 1, {k}, l]" for k in range(n))]
        lane = programs.lines([*y, *(2.0 * y[n:] - y[:n])], names, targets)
        source = kernels.fill(
            PAIRED,
            parameters=kernels.parameters(len(self.plant.p)),
            start=[f"x{k} = x{n + k} = P[0, {k}, l] = X[{k}, l]" for k in range(n)],
            lane=lane + [f"x{k} = y{k}" for k in range(2 * n)],
        )
        return family.build("paired", family.PREDICT, source, called_functions.imports(trace))

    def picard(self, tolerance: float, sweeps: int) -> Kernel:
        n, m = self.plant.n, self.plant.m
        trace = called_functions.trace(self.plant)
        y = trace.f(trace.vector("x", n), trace.vector("a", m), trace.input("t"))
        names = {f"x{k}": f"P[j, {k}, l]" for k in range(n)} | {f"a{k}": f"u[j, {k}, l]" for k in range(m)}
        node = programs.lines(y, names | {"t": "(t + j * h)"}, [f"f{k}" for k in range(n)])
        node.append(f"f = ({', '.join(f'f{k}' for k in range(n))},)")
        source = PICARD.replace("SWEEPS", str(sweeps)).replace("TOLERANCE", repr(tolerance))
        source = kernels.fill(source, parameters=kernels.parameters(len(self.plant.p)), node=node)
        return family.build("picard", family.PREDICT, source, called_functions.imports(trace))

    def control(self, step: Step) -> Kernel:
        plant = self.plant
        trace = called_functions.trace(plant)
        U = trace.kappa(trace.vector("x", plant.n), trace.input("t"))
        end = programs.lines(U, _bindings(plant), [f"U[{k}, l]" for k in range(plant.m)])
        source = kernels.fill(CONTROL, parameters=kernels.parameters(len(plant.p)), end=end)
        return family.build("control", family.CONTROL, source, called_functions.imports(trace))

    def update(self) -> Kernel:
        plant = self.plant
        trace = called_functions.trace(plant)
        x, u, t, h = trace.vector("x", plant.n), trace.vector("a", plant.m), trace.input("t"), trace.input("h")
        r, s = trace.vector("r", plant.n), trace.vector("s", plant.n)
        first, df = trace.f(x, u, t), partial(trace.df, dt=1.0)
        source = kernels.fill(
            UPDATE,
            parameters=kernels.parameters(len(plant.p)),
            first=_node(trace, x, u, t, h, first, h * df(x, u, t, first)),
            node=_node(trace, x, u, t, h, *transition(df, x, u, t, h, r, s)),
            end=programs.lines([trace.V(trace.vector("X", plant.n), trace.input("t0"))], _bindings(plant), ["v"]),
        )
        return family.build("update", family.UPDATE, source, called_functions.imports(trace))

    def correction(self) -> Kernel:
        return correction.kernel(self.plant)

    def advance(self, step: Step) -> Kernel:
        trace = called_functions.trace(self.plant)
        parts = {name: advance_lines(trace, step, f"{U}[{{0}}, l]") for name, U in (("first", "U0"), ("second", "U1"))}
        source = kernels.fill(ADVANCE, parameters=kernels.parameters(len(self.plant.p)), **parts)
        return family.build("advance", family.ADVANCE, source, called_functions.imports(trace))


def input_lines(m: int) -> dict[str, str]:
    """The texts of the inputs at the begin a, the middle m and the end b of a cell; WEIGHTS stand before them."""
    bindings = {}
    for k in range(m):
        middle = " + ".join(f"w{i} * u[{i}, {k}, l]" for i in "abcd")
        middle = f"({middle} + linear * (u[j, {k}, l] + u[j + 1, {k}, l]))"
        bindings |= {f"a{k}": f"u[j, {k}, l]", f"b{k}": f"u[j + 1, {k}, l]", f"m{k}": middle}
    return bindings


def cell_lines(m: int) -> dict[str, str]:
    """The same where the rows of u are the begin and the end of each cell, a straight line in between."""
    ends = {"a": "u[2 * j, {}, l]", "b": "u[2 * j + 1, {}, l]"}
    bindings = {f"{name}{k}": text.format(k) for name, text in ends.items() for k in range(m)}
    return bindings | {f"m{k}": f"(0.5 * (u[2 * j, {k}, l] + u[2 * j + 1, {k}, l]))" for k in range(m)}


def advance_lines(trace: Trace, step: Step, U: str) -> list[str]:
    """The lines of a step of the plant; U is the text of an input, {0} its number."""
    plant = trace.plant
    x, u = trace.vector("x", plant.n), trace.vector("u", plant.m)
    y = called_functions.stepped(trace, step, x, (u, u, u), trace.input("t"), trace.input("h"))
    y = plant.stopped([*y], tape.M)
    names = {f"x{k}": f"X[{k}, l]" for k in range(plant.n)} | {f"u{k}": U.format(k) for k in range(plant.m)}
    return programs.lines(y, names | {"t": "start"}, [f"X[{k}, l]" for k in range(plant.n)])


def _node(trace: Trace, x: Any, u: Any, t: Any, h: Any, r: Any, s: Any) -> list[str]:
    """The lines of one node: r and s stored, i1 = q1·w and i2 = |w|²."""
    kappa, q1 = trace.law(x, t, r, 1.0)
    w, n = u - kappa, trace.plant.n
    targets = [f"r[{k}, l]" for k in range(n)] + [f"s[{k}, l]" for k in range(n)] + ["i1", "i2"]
    return programs.lines([*r, *s, np.dot(q1, w), np.dot(w, w)], _bindings(trace.plant), targets)


def _bindings(plant: Plant) -> dict[str, str]:
    names = {"t": "(t + j * h)", "t0": "t"}
    for k in range(plant.n):
        names |= {f"x{k}": f"P[j, {k}, l]", f"X{k}": f"X[{k}, l]", f"r{k}": f"r[{k}, l]", f"s{k}": f"s[{k}, l]"}
    return names | {f"a{k}": f"u[j, {k}, l]" for k in range(plant.m)}
