"""Any method on few cells, where an accuracy does not need the nodes, and how few the examples of a network allow.

A guard's estimate is by few steps, and so is what it falls back to on a stiff plant.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from npred.base.errors import ConfigError
from npred.kernels.kernel import Kernel, made, skeleton
from npred.plants.base import Plant
from npred.prediction.delays import problem, problem_of
from npred.prediction.methods import method
from npred.prediction.methods.base import Compiled, OneStep, Predictor
from npred.prediction.methods.runge_kutta import RK4

LADDER = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 50, 64, 80, 100, 128, 160, 200)  # cells of the coarser grid
EXPLICIT = 50  # steps of RK4 that a plant that is not stiff can do with


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
        if not problem_of(plant).reads_cells:
            raise ConfigError(f"coarse: expected a traced plant with one constant delay, got {plant.name}; use rk4")

    def compile(self) -> Kernel:
        n, m, count = self.plant.n, self.plant.m, self.count
        sweep: Any = self.method.cells()

        def work(nx: int, lanes: int, _: Any) -> int:
            cells = 2 * (nx + 1) * m + 2 * count * m + (count + 1) * n
            return cells * lanes + sweep.work(count + 1, lanes, None)

        sizes, body = {"N": n, "M": m, "COUNT": count}, skeleton("coarse.h")
        return made("coarse", problem.PREDICT, body, {}, sizes, {"SWEEP": sweep}, [skeleton("cells.h")], work=work)

    def call_operations(self, steps: int) -> int:
        """The operations of a call, whatever number of steps the nodes ask for, counted in the program of a step."""
        return self.method.call_operations(self.count)


@dataclass(frozen=True)
class Examples:
    """Some calls that the data hold: X (B, n), u (B, nx, m) on the nodes of the guard, D_hat and t (B,)."""

    plant: Plant
    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray
    t: np.ndarray

    @property
    def calls(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The arguments of a predictor."""
        return self.X, self.u, self.D_hat, self.t

    def command(self, end: np.ndarray) -> np.ndarray:
        """U (B, m) of the predictions P(1) (B, n)."""
        with np.errstate(all="ignore"):
            return self.plant.kappa(end, self.t + self.D_hat)

    def on_cells(self, name: str, count: int) -> np.ndarray:
        """U (B, m) by the method on so many cells."""
        plant, P = self.plant, np.full((len(self.X), count + 1, self.plant.n), np.nan)
        times = self.t if plant.clocked else np.zeros(len(self.X))
        run = one_step(name)(plant).cells()
        with np.errstate(all="ignore"):
            problem.by_time(run, (self.X, straight(self.u, count), self.D_hat), times, (plant.p,), (P,))
        return self.command(P[:, -1])

    def move(self, name: str, count: int) -> float:
        """How far U moves, for all but one of a hundred, as the method takes twice as many cells."""
        few, many = (self.on_cells(name, k) for k in (count, 2 * count))
        with np.errstate(all="ignore"):
            moves = np.nan_to_num(np.abs(few - many).max(axis=-1), nan=np.inf)
        return float(np.quantile(moves, 0.99, method="higher"))

    def by_cost(self, names: Iterable[str]) -> list[tuple[int, str, int]]:
        """The operations of N and 2 N steps of each method, its name and N, the cheapest first."""
        per_step = {name: one_step(name).operations(self.plant) for name in names}
        return sorted((3 * count * cost, name, count) for name, cost in per_step.items() for count in LADDER)

    def exact(self, names: Iterable[str], tolerance: float) -> Predictor:
        """RK4 on the guard's nodes, or the cheapest of the implicit methods on few cells; see Guarded.exact."""
        nx = self.u.shape[1]
        if self.move(RK4.name, EXPLICIT) > tolerance:
            for _, name, count in self.by_cost(names):
                if self.move(name, count) <= tolerance:
                    return Coarse(self.plant, one_step(name), 2 * count, nx)
        return RK4(self.plant, nx)


def one_step(name: str) -> type[OneStep]:
    return cast(type[OneStep], method(name))
