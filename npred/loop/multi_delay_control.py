"""The control law where inputs have delays of their own: U_j = kappa_j(P(r_j), t + r_j D_hat)."""

from collections.abc import Callable
from typing import Any

from npred.plants.base import Plant
from npred.predictors import RK4, multi_delay
from npred.symbolic import kernels, programs
from npred.symbolic.trace import Trace

SOURCE = """\
def control(P, u, D_hat, t, p, U):
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


def source(plant: Plant) -> str:
    """The text of the kernel: P(r_j) is a node of P, or a step of RK4 from the node before it."""
    text = SOURCE.replace("{all}", f"({', '.join(f'edge{c}' for c in range(plant.m))},)")
    return kernels.fill(
        text,
        parameters=kernels.parameters(len(plant.p)),
        edges=multi_delay.edges(plant),
        split=multi_delay.split(plant),
        piece=multi_delay.piece(plant, RK4.step, [f"Y[c, {k}, l]" for k in range(plant.n)]),
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


def build(plant: Plant, signature: str) -> Callable[..., None]:
    """The compiled law."""
    return kernels.build("control", signature, source(plant), multi_delay.PREAMBLE)
