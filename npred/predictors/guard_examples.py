"""How few steps a guard can do with, by examples of a network's data: in its estimate, and where it falls back."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import cast

import numpy as np

from npred.delays.family import by_time
from npred.plants.base import Plant
from npred.predictors import method
from npred.predictors.base import OneStep, Predictor
from npred.predictors.coarse import Coarse, straight
from npred.predictors.runge_kutta import RK4

LADDER = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 50, 64, 80, 100, 128, 160, 200)  # of the coarser grid
WORTH = 0.4  # of the operations of `exact`: what a shadow may take
EXPLICIT = 50  # steps of RK4 that a plant that is not stiff can do with
Grids = tuple[int, int]  # the steps of the finer one, and of the coarser


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
        run = _one_step(name)(plant).cells()
        with np.errstate(all="ignore"):
            by_time(run, (self.X, straight(self.u, count), self.D_hat), times, (plant.p,), (P,))
        return self.command(P[:, -1])

    def move(self, name: str, count: int) -> float:
        """How far U moves, for all but one of a hundred, as the method takes twice as many cells."""
        few, many = (self.on_cells(name, k) for k in (count, 2 * count))
        with np.errstate(all="ignore"):
            moves = np.nan_to_num(np.abs(few - many).max(axis=-1), nan=np.inf)
        return float(np.quantile(moves, 0.99, method="higher"))

    def by_cost(self, names: Iterable[str]) -> list[tuple[int, str, int]]:
        """The operations of N and 2 N steps of each method, its name and N, the cheapest first."""
        per_step = {name: _one_step(name).operations(self.plant) for name in names}
        return sorted((3 * count * cost, name, count) for name, cost in per_step.items() for count in LADDER)

    def exact(self, names: Iterable[str], tolerance: float) -> Predictor:
        """RK4 on the guard's nodes, or the cheapest of the implicit methods on few cells; see Guarded.exact."""
        nx = self.u.shape[1]
        if self.move(RK4.name, EXPLICIT) > tolerance:
            for _, name, count in self.by_cost(names):
                if self.move(name, count) <= tolerance:
                    return Coarse(self.plant, _one_step(name), 2 * count, nx)
        return RK4(self.plant, nx)

    def shadow(
        self, model: Predictor, exact: Predictor, names: Iterable[str], passing: float, tolerance: float
    ) -> tuple[str, Grids]:
        """The method and the grids (2 N, N) of the estimate; see Guarded.reference.

        Where the shadow moves by no more than `passing` as its cells are halved, its R has to be that of `exact`: where
        the data's own inputs mislead it, an adversary finds many that do. The cost of a call is that of 3 N steps, and,
        for the share of the examples that does not pass, that of `exact`. A shadow that takes as long as `exact` is of
        no use: of those that take a share WORTH of that, if none will do, the guard has the one that is misled least.
        """
        U, U_exact = (self.command(predict(*self.calls)[:, -1]) for predict in (model, exact))
        last = self.u.shape[1] - 1
        cost_exact = _operations(exact, last)
        right, least = (np.inf, ("heun", (last, last // 2))), (np.inf, ("heun", (last, last // 2)))
        for cost, name, count in self.by_cost(names):
            if cost >= right[0] or (cost > WORTH * cost_exact and np.isfinite(least[0])):
                break
            B, A = (self.on_cells(name, k) for k in (count, 2 * count))
            R = A + (A - B) / 3.0
            gap, error, noise = (np.abs(a).max(axis=-1) for a in (U - R, U_exact - R, A - B))
            passes = gap + noise <= passing
            if passes.any():
                misled, grids = error[noise <= passing].max(), (name, (2 * count, count))
                if misled <= tolerance:
                    right = min(right, (cost + (1 - passes.mean()) * cost_exact, grids))
                least = min(least, (misled, grids))
        return right[1] if np.isfinite(right[0]) else least[1]


def _operations(exact: Predictor, steps: int) -> int:
    """Those of a call; of a predictor whose operations are not known, those of RK4."""
    counted = exact if isinstance(exact, Coarse | OneStep) else RK4(exact.plant)
    return counted.call_operations(steps)


def _one_step(name: str) -> type[OneStep]:
    return cast(type[OneStep], method(name))
