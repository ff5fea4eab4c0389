"""The minimum of a cost over a few coordinates, delays or lags, with its profile along each of them.

The cost has kinks where commands cross samples, and no derivative there: it is searched by values alone.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from npred.identification.fit import SegmentFit

At = Callable[[np.ndarray, SegmentFit | None], SegmentFit]  # the fit at some coordinates, from another one
LEVEL = 3.84  # chi² with one degree of freedom at 95 %
FAR = 30.0  # above the least cost a profile may end
EQUAL = 3  # places where all coordinates are equal, from which each is searched by itself
GROWTH = 1.5
FALL = 1e-3  # of a cost, below which it is one more iteration of a fit, and no better place: descents walked in circles


@dataclass(frozen=True)
class Profile:
    """Values of one coordinate, sorted, and the fit at each, the other coordinates being optimal there."""

    values: np.ndarray
    fits: list[SegmentFit]

    @property
    def costs(self) -> np.ndarray:
        return np.array([fit.cost for fit in self.fits])


def scan(at: At, low: np.ndarray, high: np.ndarray, spacing: float, most: int = 400) -> list[tuple[np.ndarray, float]]:
    """The places of local minima on a grid, the best first: all coordinates equal, then each by itself."""
    count = int(np.clip(np.ceil((high - low).max() / spacing), 8, most if len(low) == 1 else most // 4)) + 1
    shares = np.linspace(0.0, 1.0, count)
    minima = _minima(at, [low + share * (high - low) for share in shares])
    if len(low) == 1:
        return minima
    places = []
    for best in minima[:EQUAL]:
        for _ in range(2):
            for j in range(len(low)):
                grid = np.tile(best[0], (count, 1))
                grid[:, j] = low[j] + shares * (high[j] - low[j])
                best = min([best, *_minima(at, list(grid))], key=lambda pair: pair[1])
        places.append(best)
    return sorted(places, key=lambda pair: pair[1])


def _minima(at: At, grid: list[np.ndarray]) -> list[tuple[np.ndarray, float]]:
    fit, costs = None, []
    for z in grid:
        fit = at(z, fit if fit is not None and np.isfinite(fit.cost) else None)
        costs.append(fit.cost)
    padded = np.concatenate([[np.inf], costs, [np.inf]])
    lower = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:]) & np.isfinite(padded[1:-1])
    places = sorted(np.flatnonzero(lower), key=lambda k: costs[k])
    return [(grid[k], costs[k]) for k in places] or [(grid[0], np.inf)]


def descend(
    at: At, fit: SegmentFit, z: np.ndarray, low: np.ndarray, high: np.ndarray, step: float, least: float
) -> tuple[np.ndarray, SegmentFit, np.ndarray]:
    """The coordinates of the least cost from z on, by steps that are halved down to `least`; the fit, and its widths.

    A width (m,) is the distance at which the cost rises by about 1.
    """
    widths, z = np.full(len(z), step), np.array(z, dtype=float)
    while step >= least:
        moved = False
        for j in range(len(z)):
            for side in (-1.0, 1.0):
                there = z.copy()
                there[j] = np.clip(z[j] + side * step, low[j], high[j])
                if there[j] == z[j]:
                    continue
                new = at(there, fit)
                rise = new.cost - fit.cost
                if rise < -FALL:
                    z, fit, moved = there, new, True
                    break
                if np.isfinite(rise) and rise > 0.05:
                    widths[j] = abs(there[j] - z[j]) / np.sqrt(rise)
        if not moved:
            if step < 0.2 * widths.min():
                break
            step /= 2
    return z, fit, widths


def nearby(
    at: At, fit: SegmentFit, low: np.ndarray, high: np.ndarray, spacing: float, finest: float
) -> tuple[np.ndarray, SegmentFit]:
    """The least cost within two steps of a grid, `spacing` wide, about a fit, down to spacing / `finest`."""
    z = fit.delays
    ends = np.maximum(z - 2 * spacing, low), np.minimum(z + 2 * spacing, high)
    return descend(at, fit, z, *ends, spacing, spacing / finest)[:2]


def profile(
    at: At, fit: SegmentFit, z: np.ndarray, j: int, low: np.ndarray, high: np.ndarray, widths: np.ndarray,
    far: float = FAR,
) -> Profile:  # fmt: skip
    """The costs along coordinate j, outwards to where they are `far` above the least one, or to an end of the range."""
    fits = {float(z[j]): fit}
    first = min(max(0.4 * widths[j], 1e-6 * (high[j] - low[j])), (high[j] - low[j]) / 20)
    for side in (-1.0, 1.0):
        there, step, last = z.copy(), first, fit
        while low[j] < there[j] < high[j] or there[j] == z[j]:
            there = there.copy()
            there[j] = np.clip(there[j] + side * step, low[j], high[j])
            if there[j] == z[j]:
                break
            there, last = _others(at, there, last, j, low, high, widths)
            fits[float(there[j])] = last
            if not last.cost - fit.cost < far:
                break
            step = min(step * GROWTH, (high[j] - low[j]) / 12)
    values = np.array(sorted(fits))
    return Profile(values, [fits[value] for value in values.tolist()])


def _others(
    at: At, z: np.ndarray, start: SegmentFit, j: int, low: np.ndarray, high: np.ndarray, widths: np.ndarray
) -> tuple[np.ndarray, SegmentFit]:
    """The other coordinates at the least cost, by a parabola along each."""
    fit = at(z, start)
    for i in range(len(z)):
        if i == j:
            continue
        ends = [np.clip(z[i] + side * widths[i], low[i], high[i]) for side in (-1.0, 1.0)]
        sides = []
        for end in ends:
            there = z.copy()
            there[i] = end
            sides.append(at(there, fit))
        a, b = sides[0].cost - fit.cost, sides[1].cost - fit.cost
        there = z.copy()
        share = 0.5 * (a - b) / (a + b) if a + b > 0 else np.sign(a - b)
        there[i] = np.clip(z[i] + widths[i] * share, low[i], high[i])
        new = at(there, fit)
        fit, z = min([(fit, z), (new, there)], key=lambda pair: pair[0].cost)
    return z, fit


def interval(values: np.ndarray, rises: np.ndarray, level: float) -> tuple[float, float]:
    """The hull of the values whose cost is at most `level` above the least one, by lines between the roots of rises."""
    roots = np.sqrt(np.clip(np.nan_to_num(rises, posinf=1e12), 0.0, 1e12))
    inside = np.flatnonzero(roots <= np.sqrt(level))
    ends = []
    for k, side in ((inside[0], -1), (inside[-1], 1)):
        beyond = k + side
        if not 0 <= beyond < len(values):
            ends.append(float(values[k]))
            continue
        share = (np.sqrt(level) - roots[k]) / max(roots[beyond] - roots[k], 1e-12)
        ends.append(float(values[k] + share * (values[beyond] - values[k])))
    return ends[0], ends[1]
