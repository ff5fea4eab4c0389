"""Networks as one compiled function: a whole call of the operator on the loop's memory, for a fixed grid."""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred.delays import family
from npred.operators import Operator
from npred.plants.base import Plant
from npred.predictors.base import Compiled
from npred.runtimes import numba_text
from npred.runtimes.lower import fold, require
from npred.runtimes.program import Program
from npred.symbolic import kernels

COARSE = 100  # intervals that an FNO is evaluated on, at least

SOURCE = """\
    _wide()
    lanes = X.shape[1]
    flat_u, flat_P = u.reshape(-1), P.reshape(-1)
    {memory}
    for l in range(lanes):
        {body}
        if lanes == 1:
            for j in range({nx}):
                {flat}
        else:
            for j in range({nx}):
                {lane}
"""

# The running mean is summed in double precision, four nodes at a time: that of equal values is exact, and so is the
# anchor. One lane has separate loops, for with a stride of one they are SIMD.
SAMPLE = """\
for c in range({n}):
    z[c] = REAL((np.arcsinh(X[c, l] * X_bend[c]) - X_zero[c]) * X_gain[c])
{phase}
z[{seen}] = REAL((D_hat[l] - D_hat_zero[0]) * D_hat_gain[0])
for c in range({m}):
    if lanes == 1:
        for j in range({nx}):
            v[j * {m} + c] = REAL((flat_u[j * {m} + c] - u_zero[c]) * u_gain[c])
    else:
        for j in range({nx}):
            v[j * {m} + c] = REAL((u[j, c, l] - u_zero[c]) * u_gain[c])
    total = 0.0
    for j in range(0, {quads}, 4):
        q0, q1 = np.float64(v[j * {m} + c]), np.float64(v[(j + 1) * {m} + c])
        q2, q3 = np.float64(v[(j + 2) * {m} + c]), np.float64(v[(j + 3) * {m} + c])
        q01 = q0 + q1
        prefix[j], prefix[j + 1], prefix[j + 2] = total + q0, total + q01, total + (q01 + q2)
        total += q01 + (q2 + q3)
        prefix[j + 3] = total
    for j in range({quads}, {nx}):
        total += np.float64(v[j * {m} + c])
        prefix[j] = total
    q0 = np.float64(v[c])
    for j in range({nx}):
        r[c * {nx} + j] = REAL((2.0 * prefix[j] - q0 - np.float64(v[j * {m} + c])) * share[j])
    r[c * {nx}] = v[c]
"""

PAIR = """\
for c in range({n}):
    z[{columns} + c] = ZERO
for c in range({n}, {columns}):
    z[{columns} + c], z[c] = z[c], ZERO
"""

PHASE = """\
angle = {turn!r} * (t / {period!r} % 1.0)
z[{n}], z[{n} + 1] = REAL(np.cos(angle)), REAL(np.sin(angle))
"""

# Inside the series' range one pass is enough; outside it the point of rest has a separate pass, before the sample's.
SERIES = """\
s = (np.float64(D_hat[l]) - {low!r}) * {scale!r} - 1.0
inside = abs(s) <= 1.0
{passes}
if inside:
    one, two = 1.0, s
    for k in range({terms}):
        T[k] = REAL(one)
        one, two = two, 2.0 * s * two - one
    {series}
{difference}
"""

PASSES = """\
for row in range({first}, 2):
    {sample}
    if row == 0:
        z[:{n}] = ZERO
        r[:] = ZERO
    {steps}
    if row == 0:
        for j in range({size}):
            N_rest[j] = N[j]
"""

DIFFERENCE = """\
for j in range({size}):
    N[j] -= N_rest[j]
"""


class Fused(Compiled):
    """P_hat of a trained operator by one compiled function on one core, without Python.

    It is compiled for a grid, the weights in it, and kept on the disk like every kernel; loops with it run in the
    compiled engine. Another nx in a call compiles another function. `precision` of the network is np.float32 or
    np.float64. Equal to the operator up to its rounding, but for an FNO on a fine grid: it is evaluated on every
    `stride`-th node, cubics between, by default so that COARSE intervals or more are left. At those nodes, x = 1 among
    them, it is exact too. Raises ConfigError for a network that cannot be lowered.
    """

    def __init__(
        self, plant: Plant, operator: Operator, nx: int = 101, name: str = "neural", stride: int | None = None,
        precision: Any = np.float32, device: str = "cpu",
    ) -> None:  # fmt: skip
        super().__init__(plant, nx)
        require(operator, "fused", "use the runtime torch or onnx", "" if name == "neural" else name)
        self.name, self.stride, self.precision = name, stride, precision  # type: ignore[misc]
        self.operator, self.kernels = operator.to("cpu").eval(), {}

    def compile(self) -> Callable[..., None]:
        return self.on(self.nx)

    def on(self, nx: int) -> Callable[..., None]:
        if nx not in self.kernels:
            stride = self.stride or coarsest(nx)
            self.kernels[nx] = build(fold(self.operator, self.plant, nx, stride, self.precision))
        return self.kernels[nx]

    def __getstate__(self) -> dict[str, Any]:
        """The operator; its functions are compiled again, or read from the disk, on use."""
        return super().__getstate__() | {"kernels": {}}


def coarsest(nx: int) -> int:
    """The largest stride that divides the intervals and leaves COARSE of them, or 1."""
    intervals = nx - 1
    return max(s for s in range(1, max(intervals // COARSE, 1) + 1) if intervals % s == 0)


def build(p: Program) -> Callable[..., None]:
    """The compiled function of a program: PREDICT, for p.nx nodes and any number of lanes."""
    return family.build("fused", family.PREDICT, *source(p), fastmath=numba_text.FASTMATH)


def source(p: Program) -> tuple[str, str]:
    """The lines of that function, and those that stand before it."""
    preamble = numba_text.preamble(p.constants, p.precision) + f"share = 0.5 / np.maximum(np.arange({p.nx}), 1)\n"
    memory = numba_text.buffers(p.buffers, p.precision) + numba_text.buffers({"prefix": p.nx}, np.float64)
    slots = {"memory": memory + numba_text.arrays(p.constants), "body": _body(p)}
    slots |= {"flat": _outputs(p, f"flat_P[j * {p.n} + {{c}}]"), "lane": _outputs(p, "P[j, {c}, l]")}
    return kernels.fill(SOURCE, **slots).format(**_sizes(p)), preamble


def _outputs(p: Program, target: str) -> list[str]:
    """The lines that write the states of a node."""
    start, factor = ("base[{c}]", "1.0") if "base" in p.constants else ("X[{c}, l]", "D_hat[l]")
    line = f"{target} = {start} + {factor} * (gain[{{c}} * {p.nx} + j] * N[{{c}} * {p.nx} + j])"
    return [line.format(c=c) for c in range(p.n)]


def _body(p: Program) -> list[str]:
    """The lines from the inputs to N."""
    sample = kernels.fill(SAMPLE, phase=PHASE.splitlines() if p.period else []).splitlines()
    steps, difference = numba_text.steps(p.steps), DIFFERENCE.splitlines()
    passes = kernels.fill(PASSES, sample=sample, steps=steps).splitlines()
    if p.series:
        series = numba_text.steps([p.series.product])
        return kernels.fill(SERIES, passes=passes, series=series, difference=difference).splitlines()
    return passes + difference if p.twice else sample + (PAIR.splitlines() if p.rows == 2 else []) + steps


def _sizes(p: Program) -> dict[str, Any]:
    sizes: dict[str, Any] = {"n": p.n, "m": p.m, "nx": p.nx, "quads": p.nx - p.nx % 4, "size": p.n * p.nx}
    sizes |= {"seen": p.seen, "columns": p.columns, "period": p.period, "turn": 2 * np.pi, "first": "0"}
    if p.series is None:
        return sizes
    return sizes | {
        "first": "1 if inside else 0",
        "low": p.series.low,
        "scale": 2 / (p.series.high - p.series.low),
        "terms": p.series.terms,
    }
