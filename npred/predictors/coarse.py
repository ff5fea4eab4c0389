"""Any method on few cells, for accuracies that do not need the nodes: what a guard falls back to on a stiff plant."""

from collections.abc import Callable

import numpy as np

from npred.delays import family, family_of
from npred.errors import ConfigError
from npred.plants.base import Plant
from npred.predictors.base import Compiled
from npred.predictors.onestep import OneStep
from npred.symbolic import kernels

# Positions are counted in nodes; mass[j] and turn[j] are the integrals of u and of s u from 0 to where the cell of node
# j begins, for each input and lane. A lane is summed in scalars: sums in memory would wait for it at each node.
INTEGRALS = """\
m, lanes = u.shape[1], u.shape[2]
sums = np.empty((2, nx + 1, m, lanes))
mass, turn = sums[0], sums[1]
for c in range(m):
    for l in range(lanes):
        whole, lever = 0.5 * u[0, c, l], 0.125 * u[0, c, l]
        mass[0, c, l], turn[0, c, l] = 0.0, 0.0
        mass[1, c, l], turn[1, c, l] = whole, lever
        for j in range(1, last):
            whole += u[j, c, l]
            lever += j * u[j, c, l]
            mass[j + 1, c, l], turn[j + 1, c, l] = whole, lever
        mass[nx, c, l] = whole + 0.5 * u[last, c, l]
        turn[nx, c, l] = lever + (0.5 * last - 0.125) * u[last, c, l]"""

# v: the begin and the end of the straight line on each cell that is nearest to u in the mean square.
CELLS = """\
v, long = np.empty((2 * count, m, lanes)), last / count
for J in range(count):
    low, high = J * long, (J + 1) * long
    i, j = min(int(low + 0.5), last), min(int(high + 0.5), last)
    a, b, middle = low - max(i - 0.5, 0.0), high - max(j - 0.5, 0.0), 0.5 * (low + high)
    lever_a, lever_b = a * (low - 0.5 * a), b * (high - 0.5 * b)
    for c in range(m):
        for l in range(lanes):
            whole = mass[j, c, l] - mass[i, c, l] + b * u[j, c, l] - a * u[i, c, l]
            lean = turn[j, c, l] - turn[i, c, l] + lever_b * u[j, c, l] - lever_a * u[i, c, l] - middle * whole
            mean, half = whole / long, 6.0 * lean / (long * long)
            v[2 * J, c, l] = mean - half
            v[2 * J + 1, c, l] = mean + half"""

BODY = """\
    nx, n, lanes = P.shape
    last, count = nx - 1, {count}
    {integrals}
    {cells}
    Q = np.empty((count + 1, n, lanes))
    sweep(X, v, D_hat, t, p, Q)
    for j in range(nx):
        place = j * count / last
        J = min(int(place), count - 1)
        share = place - J
        for c in range(n):
            for l in range(lanes):
                P[j, c, l] = Q[J, c, l] + share * (Q[J + 1, c, l] - Q[J, c, l])
"""


def straight(u: np.ndarray, count: int) -> np.ndarray:
    """The same of inputs at nodes u (B, nx, m): begin and end of each of `count` cells, (B, 2 count, m)."""
    last = u.shape[1] - 1
    edges = np.clip(np.arange(last + 2) - 0.5, 0.0, last)
    places = np.linspace(0.0, last, count + 1)
    before = np.minimum((places + 0.5).astype(int), last)
    begins, part = edges[before], u[:, before]
    weights, levers = np.diff(edges), np.diff(edges**2) / 2
    sums = [np.cumsum(w[:, None] * u, axis=1) for w in (weights, levers)]
    mass, turn = (np.concatenate([0 * a[:, :1], a], axis=1)[:, before] for a in sums)
    mass = mass + (places - begins)[:, None] * part
    turn = turn + (places**2 - begins**2)[:, None] / 2 * part
    long, middle = last / count, (places[1:] + places[:-1])[:, None] / 2
    whole = np.diff(mass, axis=1)
    half = 6.0 * (np.diff(turn, axis=1) - middle * whole) / long**2
    return np.stack([whole / long - half, whole / long + half], axis=2).reshape(len(u), 2 * count, -1)


def ends(predictor: OneStep, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, count: int, t: np.ndarray) -> np.ndarray:
    """P(1) (B, n) by the method on so many cells, of X (B, n), u (B, nx, m), D_hat and t (B,)."""
    plant, P = predictor.plant, np.full((len(X), count + 1, predictor.plant.n), np.nan)
    times = t if plant.clocked else np.zeros(len(X))
    family.by_time(predictor.cells(), (X, straight(u, count), D_hat), times, (plant.p,), (P,))
    return P[:, -1]


class Coarse(Compiled):
    """A one-step method on `count` cells, whatever nx is: each cell reads the straight line nearest to u on it.

    A jump of u inside a cell keeps its weight and its place, so that few steps do where the plant is smooth. Between
    its ends P is interpolated linearly. For a traced plant with one constant delay: raises ConfigError for others.
    """

    order = 2

    def __init__(self, plant: Plant, method: type[OneStep], count: int, nx: int = 101):
        super().__init__(plant, nx)
        self.method, self.count = method(plant), count
        self.name = f"{method.name} on {count} cells"  # type: ignore[misc]
        if not family_of(plant).reads_cells:
            raise ConfigError(f"coarse: expected a traced plant with one constant delay, got {plant.name}; use rk4")

    def compile(self) -> Callable[..., None]:
        part = self.method.cells()
        source = kernels.fill(
            BODY.replace("{count}", str(self.count)), integrals=INTEGRALS.splitlines(), cells=CELLS.splitlines()
        )
        return family.build(
            "coarse", family.PREDICT, source, f"from {part.__module__} import {part.__name__} as sweep\n"
        )

    @property
    def operations(self) -> int:
        """The operations of a call, counted in the program of a step."""
        return self.count * self.method.operations(self.plant)
