"""Newton's method for points of rest, measured by its corrections in sizes of the states and inputs.

So neither the unit of time nor those of the states matter [Deuflhard, Newton Methods for Nonlinear Problems, 2011,
2.1]; npred/kernels/c/rest.h is the same for set-points while a loop runs.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

CORRECTIONS, TRIES = 500, 50  # in all, and for one s
SHORTEST = 1e-6  # step of s
SMALL, ARRIVED = 0.01, 1e-8  # corrections: one that need not halve, and one after which the next is rounding
SINGULAR = 1e-11  # share of the largest singular value


@np.errstate(all="ignore")
def scales(plant: Any) -> np.ndarray:
    """How large a change of each state and input counts as one, (n + m,).

    It is half the box, half the input's bounds, or |guess|; where none is known, what moves f as much as the known
    ones do, by its derivatives at `guess`; else 1.
    """
    pairs = [*(plant.box.get(name, (0.0, 0.0)) for name in plant.states), *(plant.input_bounds or [(0, 0)] * plant.m)]
    sizes = np.ptp(np.array(pairs, dtype=float), axis=1) / 2
    declared = np.isfinite(sizes) & (sizes > 0)
    sizes = np.where(declared, sizes, np.append(np.abs(plant.guess), np.zeros(plant.m)))
    if (sizes > 0).all() or not plant.traced:
        return np.where(sizes > 0, sizes, 1.0)
    at = [*plant.guess, *np.zeros(plant.m), 0.0, *plant.p_declared]
    try:
        columns = [plant.derivatives[name](*at) for name in ("f_x", "f_u")]
    except (ArithmeticError, ValueError):  # floats raise where arrays give NaN
        return np.where(sizes > 0, sizes, 1.0)
    slopes = np.abs(np.concatenate(columns).astype(float)).reshape(-1, plant.n).T
    slopes[~np.isfinite(slopes)] = 0.0  # that of a root at 0, say: it tells no size
    for _ in sizes:  # from the known ones to their neighbours
        moved = slopes @ sizes
        for k in np.flatnonzero(sizes == 0):
            rows = (slopes[:, k] > 0) & (moved > 0)
            sizes[k] = (moved[rows] / slopes[rows, k]).min(initial=np.inf)
        sizes[np.isinf(sizes)] = 0.0
    return np.where(sizes > 0, sizes, 1.0)


@np.errstate(all="ignore")  # F may overflow on the way: a step to where it is not finite is refused
def search(
    F: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], z: np.ndarray, units: np.ndarray
) -> tuple[np.ndarray, bool]:
    """z (k,) with F(z) = 0, followed along F(z) = (1 - s) F(z at the start), s from 0 to 1, and whether s came to 1.

    F gives its value (r,) and its Jacobian (r, k), NaN where it has none. A correction is the shortest one in `units`
    (k,), of which 0 holds its component. A step of s is halved where corrections do not halve, unless they are small,
    as next to a kink of F, and doubled where they do.
    """
    start, s, share, left = F(z)[0], 0.0, 1.0, CORRECTIONS
    if not start.any():  # there already, with a derivative or without
        return z, True
    while s < 1 and share > SHORTEST and left > 0:
        there = min(s + share, 1.0)
        moved, spent, arrived = _corrected(F, (1.0 - there) * start, z, units, min(TRIES, left))
        left -= spent
        if arrived:
            z, s, share = moved, there, 2 * share
        else:
            share = (there - s) / 2
    return z, s >= 1


def best_input(f: np.ndarray, f_U: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """The change of inputs (m,) with the least f (n,), in states' sizes, by a Gauss-Newton step with f_U (n, m)."""
    f, f_U = f / sizes, f_U / sizes[:, None]
    if not (np.isfinite(f).all() and np.isfinite(f_U).all()):
        return np.zeros(f_U.shape[1])
    return -np.linalg.lstsq(f_U, f, rcond=None)[0]


def _corrected(
    F: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], goal: np.ndarray, z: np.ndarray, units: np.ndarray,
    tries: int,
) -> tuple[np.ndarray, int, bool]:  # fmt: skip
    """z with F(z) = goal, the number of corrections, and whether they ended in rounding."""
    before = np.inf
    for k in range(tries):
        value, jacobian = F(z)
        step, size = _correction(value - goal, jacobian * units)
        halves = size <= before / 2
        if not (np.isfinite(size) and (halves or size <= SMALL)):
            return z, k + 1, False
        if before <= ARRIVED and not (halves and size > 0):
            return z, k + 1, True
        z, before = z - units * step, size
    return z, tries, before <= ARRIVED


def _correction(g: np.ndarray, A: np.ndarray) -> tuple[np.ndarray, float]:
    """The shortest v with A v = g by least squares, rows scaled to 1; |v|, what is left of g; NaN if not finite."""
    rows = np.abs(A).max(axis=1)
    if not np.isfinite(rows).all() or not np.isfinite(g).all() or (g[rows == 0] != 0).any():
        return g, np.nan
    rows[rows == 0] = 1.0
    A, g = A / rows[:, None], g / rows
    v = np.linalg.lstsq(A, g, rcond=SINGULAR)[0]
    return v, float(np.sqrt(v @ v + np.sum((g - A @ v) ** 2)))
