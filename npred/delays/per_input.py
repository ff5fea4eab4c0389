"""Prediction with one delay per input: an input is its history up to its delay, past it the value of kappa.

With r_j = D_j / D the share of input j in the longest delay and u_j(x) = U_j(t + D_j (x - 1)) its history,
    dP/dx = D_hat f(P, v),   v_j(x) = u_j(x / r_j) for x <= r_j,   kappa_j(P(x), t + x D_hat) for x > r_j
[Bekiaris-Liberis, Krstic, Predictor-Feedback Stabilization of Multi-Input Nonlinear Systems, IEEE TAC 62 (2017) 516].
A step that some r_j lies inside is taken in pieces, so that a method keeps its order where v jumps.
The command is U_j = kappa_j(P(r_j), t + r_j D_hat).
"""

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from npred.delays import family
from npred.delays.constant import advance_lines
from npred.delays.family import Family, Kernel, Step
from npred.plants.base import Plant
from npred.symbolic import called_functions, kernels, programs, tape
from npred.symbolic.trace import Trace

# Positions are counted in nodes; an r_j this close to a node, in nodes, is on it.
PREAMBLE = """\
@njit
def edge(position):
    near = round(position)
    return float(near) if abs(position - near) < 1e-9 else position


@njit
def read(u, c, l, position):
    # The cubic through four nodes, one-sided at the ends, as RK4 reads one input; linear where nx < 4.
    last = u.shape[0] - 1
    position = min(position, float(last))
    if last < 3:
        i = min(int(position), last - 1)
        return u[i, c, l] + (position - i) * (u[i + 1, c, l] - u[i, c, l])
    i = min(max(int(position) - 1, 0), last - 3)
    s = position - i
    outer = (s - 1.0) * (s - 2.0) * (s * u[i + 3, c, l] - (s - 3.0) * u[i, c, l]) / 6.0
    return outer + s * (s - 3.0) * ((s - 2.0) * u[i + 1, c, l] - (s - 1.0) * u[i + 2, c, l]) / 2.0


"""

SWEEP = """\
    nx, n, lanes = P.shape
    last = nx - 1
    {parameters}
    {edges}
    P[0] = X
    for j in range(last):
        P[j + 1] = P[j]
        begin = float(j)
        while begin < j + 1:
            end = j + 1.0
            {split}
            for l in range(lanes):
                {piece}
            begin = end
"""

CONTROL = """\
    nx, n, lanes = P.shape
    last = nx - 1
    {parameters}
    {edges}
    Y = np.empty((U.shape[0], n, lanes))
    for c, edge_c in enumerate({all}):
        j = int(edge_c)
        Y[c] = P[j]
        begin = float(j)
        while begin < edge_c:
            end = edge_c
            {split}
            for l in range(lanes):
                {piece}
            begin = end
    for l in range(lanes):
        {law}
"""

# Each input switches at another moment.
ADVANCE = """\
    {parameters}
    for l in range(X.shape[1]):
        begin = 0.0
        while begin < 1.0:
            end = 1.0
            for c in range(share.shape[0]):
                if begin < share[c, l] < end:
                    end = share[c, l]
            h, start = (end - begin) * dt, t + begin * dt
            {piece}
            begin = end
"""


class DelayPerInput(Family):
    """Each input arrives r_j D late."""

    lacks: ClassVar = {
        "picard": "use rk4",
        "semi_implicit": "use rosenbrock",
        "published": "use euler, heun or rk4",
        "euler_python": "use euler, heun or rk4",
        "adaptation": 'freeze the estimate, in a pipeline by adaptation = "frozen"',
        "defect": "take by = 'shadow'",
        "bound": "take error, an estimate",
        "import": "the files hold one D_hat per row",
    }

    @staticmethod
    def serves(plant: Plant) -> bool:
        return plant.traced and not plant.one_delay

    def expected(self) -> str:
        delays = ", ".join(map(self.plant.time_text, self.plant.delays or ()))
        return f"expected one delay, plant {self.plant.name} has delays {delays}"

    def sweep(self, step: Step) -> Kernel:
        return family.build("sweep", family.PREDICT, sweep_source(self.plant, step), PREAMBLE)

    def control(self, step: Step) -> Kernel:
        return family.build("control", family.CONTROL, control_source(self.plant, step), PREAMBLE)

    def advance(self, step: Step) -> Kernel:
        trace = called_functions.trace(self.plant)
        piece = advance_lines(trace, step, "(U0[{0}, l] if begin < share[{0}, l] else U1[{0}, l])")
        source = kernels.fill(ADVANCE, parameters=kernels.parameters(len(self.plant.p)), piece=piece)
        return family.build("advance", family.ADVANCE, source, called_functions.imports(trace))


def sweep_source(plant: Plant, step: Step) -> str:
    """The text of a predictor kernel: the one-step formula over the nodes, in pieces."""
    parameters = kernels.parameters(len(plant.p))
    lines = _piece(plant, step, [f"P[j + 1, {k}, l]" for k in range(plant.n)])
    return kernels.fill(SWEEP, parameters=parameters, edges=_edges(plant), split=_split(plant), piece=lines)


def control_source(plant: Plant, step: Step) -> str:
    """The text of the control law: P(r_j) is a node of P, or a step from the node before it."""
    text = CONTROL.replace("{all}", f"({', '.join(f'edge{c}' for c in range(plant.m))},)")
    return kernels.fill(
        text,
        parameters=kernels.parameters(len(plant.p)),
        edges=_edges(plant),
        split=_split(plant),
        piece=_piece(plant, step, [f"Y[c, {k}, l]" for k in range(plant.n)]),
        law=_law(plant),
    )


def _law(plant: Plant) -> list[str]:
    """The lines of U: each component of kappa at its own prediction and time."""
    trace = Trace(plant)
    names: dict[str, str] = {}
    U: list[Any] = []
    for c, r in enumerate(plant.ratios.tolist()):
        U.append(trace.kappa(trace.vector(f"x{c}_", plant.n), trace.input(f"t{c}"))[c])
        names |= {f"x{c}_{k}": f"Y[{c}, {k}, l]" for k in range(plant.n)} | {f"t{c}": f"(t + {r!r} * D_hat[l])"}
    return programs.lines(U, names, [f"U[{c}, l]" for c in range(plant.m)])


def _edges(plant: Plant) -> list[str]:
    """edge_j: where the history of input j ends."""
    return [f"edge{c} = edge({r!r} * last)" for c, r in enumerate(plant.ratios.tolist())]


def _split(plant: Plant) -> list[str]:
    """`end` moved to the first edge in between, and past_j: whether the piece lies past input j's history."""
    early = _early(plant)
    ends = [f"end = edge{c} if begin < edge{c} < end else end" for c in early]
    return ends + [f"past{c} = begin >= edge{c}" for c in early]


def _piece(plant: Plant, step: Step, state: list[str]) -> list[str]:
    """The lines of one step of lane l from `begin` to `end`, in place on the texts of the state's components."""
    trace = Trace(plant)
    inputs = [trace.vector(name, plant.m) for name in "amb"]  # at the piece's begin, middle and end
    y = step(_closed(trace), trace.vector("x", plant.n), *inputs, trace.input("t"), trace.input("h"))
    y = plant.stopped(y, tape.M)
    names = {f"x{k}": text for k, text in enumerate(state)}
    names |= {"h": "(D_hat[l] * (end - begin) / last)", "t": "(t + D_hat[l] * begin / last)"}
    for c, r in enumerate(plant.ratios.tolist()):
        places = {"a": "begin", "m": "(begin + end) / 2.0", "b": "end"}
        names |= {f"{name}{c}": f"read(u, {c}, l, {place} / {r!r})" for name, place in places.items()}
    return programs.lines(y, names, state)


def _closed(trace: Trace) -> Callable[..., Any]:
    """f with kappa for the inputs whose history has ended."""
    past = {c: trace.input(f"past{c}") for c in _early(trace.plant)}

    def f(x: Any, u: Any, t: Any) -> Any:
        law = trace.kappa(x, t)
        return trace.f(x, np.array([tape.M.where(past[c], law[c], v) if c in past else v for c, v in enumerate(u)]), t)

    return f


def _early(plant: Plant) -> list[int]:
    """The inputs whose history ends before x = 1: those that come sooner than the others."""
    return [c for c, r in enumerate(plant.ratios) if r < 1]
