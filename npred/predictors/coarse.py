"""Any method on few cells, for accuracies that do not need the nodes: what a guard falls back to on a stiff plant."""

from typing import Any

import numpy as np

from npred.delays import family, family_of
from npred.errors import ConfigError
from npred.kernels.kernel import Kernel, made, skeleton
from npred.plants.base import Plant
from npred.predictors.base import Compiled, OneStep


def straight(u: np.ndarray, count: int) -> np.ndarray:
    """The straight lines nearest to u (B, nx, m) on cells, in the mean square: begin and end of each, (B, 2 count, m).

    A node stands for the cell around it. The C of it is npred/kernels/c/cells.h.
    """
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

    def compile(self) -> Kernel:
        n, m, count = self.plant.n, self.plant.m, self.count
        sweep: Any = self.method.cells()

        def work(nx: int, lanes: int, _: Any) -> int:
            cells = 2 * (nx + 1) * m + 2 * count * m + (count + 1) * n
            return cells * lanes + sweep.work(count + 1, lanes, None)

        sizes, body = {"N": n, "M": m, "COUNT": count}, skeleton("coarse.h")
        return made("coarse", family.PREDICT, body, {}, sizes, {"SWEEP": sweep}, [skeleton("cells.h")], work=work)

    def call_operations(self, steps: int) -> int:
        """The operations of a call, whatever number of steps the nodes ask for, counted in the program of a step."""
        return self.method.call_operations(self.count)
