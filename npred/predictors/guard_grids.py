"""How few steps a guard can do with, by the examples of a network's data: in its estimate, and where it falls back."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from npred.predictors import method
from npred.predictors.base import Predictor
from npred.predictors.coarse import Coarse, ends
from npred.predictors.onestep import OneStep
from npred.predictors.rk4 import RK4

LADDER = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 50, 64, 80, 100, 128, 160, 200)  # of the coarser grid
WORTH = 0.4  # of the operations of `exact`: what a shadow may take
EXPLICIT = 50  # steps of RK4 that a plant that is not stiff can do with


def exact(guarded: Any, names: Iterable[str], tolerance: float) -> Predictor:
    """RK4 on the guard's nodes, or the cheapest of the implicit methods on few cells; see Guarded.exact."""
    plant, nx = guarded.plant, guarded.nx
    if _move(guarded, RK4(plant, nx), EXPLICIT) <= tolerance:
        return RK4(plant, nx)
    for _, name, count in _by_cost(plant, names):
        if _move(guarded, _method(name, plant), count) <= tolerance:
            return Coarse(plant, type(_method(name, plant)), 2 * count, nx)
    return RK4(plant, nx)


def chosen(guarded: Any, names: Iterable[str], passing: float, tolerance: float) -> tuple[str, tuple[int, int]]:
    """The method and the grids (2 N, N); see Guarded.reference.

    Where the shadow moves by no more than `passing` as its cells are halved, its R has to be that of `exact`: where the
    data's own inputs mislead it, an adversary finds many that do. The cost of a call is that of 3 N steps, and, for the
    share of the examples that does not pass, that of `exact`. A shadow that takes as long as `exact` is of no use: of
    those that take a share WORTH of that, if none will do, the guard has the one that is misled least.
    """
    X, u, D_hat, t = guarded.examples
    U, U_exact = (_law(guarded, predict(X, u, D_hat, t)[:, -1]) for predict in (guarded.model, guarded.exact))
    whole, finest = _fallback_cost(guarded), ("heun", (guarded.nx - 1, (guarded.nx - 1) // 2))
    right, least = (np.inf, finest), (np.inf, finest)
    for cost, name, count in _by_cost(guarded.plant, names):
        if cost >= right[0] or (cost > WORTH * whole and np.isfinite(least[0])):
            break
        B, A = (_law(guarded, _ends(guarded, _method(name, guarded.plant), k)) for k in (count, 2 * count))
        R = A + (A - B) / 3.0
        gap, error, noise = (np.abs(a).max(axis=-1) for a in (U - R, U_exact - R, A - B))
        passes = gap + noise <= passing
        if passes.any():
            misled, grids = error[noise <= passing].max(), (name, (2 * count, count))
            if misled <= tolerance:
                right = min(right, (cost + (1 - passes.mean()) * whole, grids))
            least = min(least, (misled, grids))
    return right[1] if np.isfinite(right[0]) else least[1]


def _by_cost(plant: Any, names: Iterable[str]) -> list[tuple[int, str, int]]:
    """The operations of N and 2 N steps of each method, its name and N, the cheapest first."""
    per_step = {name: _method(name, plant).operations(plant) for name in names}
    return sorted((3 * count * cost, name, count) for name, cost in per_step.items() for count in LADDER)


def _move(guarded: Any, predictor: OneStep, count: int) -> float:
    """How far U of the examples moves, for all but one of a hundred, as a method takes twice as many cells."""
    few, many = (_law(guarded, _ends(guarded, predictor, k)) for k in (count, 2 * count))
    with np.errstate(all="ignore"):
        moves = np.nan_to_num(np.abs(few - many).max(axis=-1), nan=np.inf)
    return float(np.quantile(moves, 0.99, method="higher"))


def _fallback_cost(guarded: Any) -> int:
    if isinstance(guarded.exact, Coarse):
        return guarded.exact.operations
    kind = guarded.exact if isinstance(guarded.exact, OneStep) else RK4
    return (guarded.nx - 1) * kind.operations(guarded.plant)


def _method(name: str, plant: Any) -> Any:
    return method(name)(plant)


def _ends(guarded: Any, predictor: OneStep, count: int) -> np.ndarray:
    X, u, D_hat, t = guarded.examples
    with np.errstate(all="ignore"):
        return ends(predictor, X, u, D_hat, count, t)


def _law(guarded: Any, P: np.ndarray) -> np.ndarray:
    _, _, D_hat, t = guarded.examples
    with np.errstate(all="ignore"):
        return guarded.plant.kappa(P, t + D_hat)
