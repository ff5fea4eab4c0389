"""Prediction where inputs have delays of their own: an input is its history up to its delay, past it the law's value.

With r_j = D_j / D the share of input j in the longest delay and u_j(x) = U_j(t + D_j (x - 1)) its own history,
    dP/dx = D_hat f(P, v),   v_j(x) = u_j(x / r_j) for x <= r_j,   kappa_j(P(x), t + x D_hat) for x > r_j
[Bekiaris-Liberis, Krstic, Predictor-Feedback Stabilization of Multi-Input Nonlinear Systems, IEEE TAC 62 (2017) 516].
A step that some r_j lies inside is taken in pieces, so that a method keeps its order where v jumps.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred.plants.base import Plant
from npred.symbolic import kernels, programs, tape
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
def sweep(X, u, D_hat, t, p, P):
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


def sweep(plant: Plant, step: Callable[..., Any]) -> str:
    """The text of a predictor kernel: the one-step formula over the nodes, in pieces."""
    parameters = kernels.parameters(len(plant.p))
    lines = piece(plant, step, [f"P[j + 1, {k}, l]" for k in range(plant.n)])
    return kernels.fill(SWEEP, parameters=parameters, edges=edges(plant), split=split(plant), piece=lines)


def edges(plant: Plant) -> list[str]:
    """edge_j: where the history of input j ends."""
    return [f"edge{c} = edge({r!r} * last)" for c, r in enumerate(plant.ratios.tolist())]


def split(plant: Plant) -> list[str]:
    """`end` moved to the first edge in between, and past_j: whether the piece lies past input j's history."""
    early = _early(plant)
    ends = [f"end = edge{c} if begin < edge{c} < end else end" for c in early]
    return ends + [f"past{c} = begin >= edge{c}" for c in early]


def piece(plant: Plant, step: Callable[..., Any], state: list[str]) -> list[str]:
    """The lines of one step of lane l from `begin` to `end`, in place on the texts of the state's components."""
    trace = Trace(plant)
    inputs = [trace.vector(name, plant.m) for name in "amb"]  # at the piece's begin, middle and end
    y = step(_closed(trace), trace.vector("x", plant.n), *inputs, trace.input("t"), trace.input("h"))
    names = {f"x{k}": text for k, text in enumerate(state)}
    names |= {"h": "(D_hat[l] * (end - begin) / last)", "t": "(t + D_hat[l] * begin / last)"}
    for c, r in enumerate(plant.ratios.tolist()):
        places = {"a": "begin", "m": "(begin + end) / 2.0", "b": "end"}
        names |= {f"{name}{c}": f"read(u, {c}, l, {place} / {r!r})" for name, place in places.items()}
    return programs.lines(y, names, state)


def _closed(trace: Trace) -> Callable[..., Any]:
    """f with the law in place of the inputs whose history has ended."""
    past = {c: trace.input(f"past{c}") for c in _early(trace.plant)}

    def f(x: Any, u: Any, t: Any) -> Any:
        law = trace.kappa(x, t)
        return trace.f(x, np.array([tape.M.where(past[c], law[c], v) if c in past else v for c, v in enumerate(u)]), t)

    return f


def _early(plant: Plant) -> list[int]:
    """The inputs whose history ends before x = 1: those that come sooner than the others."""
    return [c for c, r in enumerate(plant.ratios) if r < 1]
