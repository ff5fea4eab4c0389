"""The delay over time: the windows of a log, each by itself, agree on one delay or not."""

from dataclasses import dataclass, replace

import numpy as np

from npred.identification import search
from npred.identification.estimate import COARSE, FINEST, MISSING, NORMAL, Delays, profiled, tethered
from npred.identification.fit import CLEAR, Problem, SegmentFit, better
from npred.identification.log import Segments, mean_square
from npred.identification.search import LEVEL
from npred.plants import Plant

SEGMENTS, MOST = 6, 20  # of a window, at least; windows, at most
APART = 5.0  # deviations by which windows may scatter more than they would by chance [Cochran's Q]
OTHER = 2.0  # times CLEAR: the best of many delays, by few samples
FINE = 0.05  # sampling periods, which the delay of a window is not known better than
LARGER = 2.0  # mean squares of errors, times those of the whole log: a delay there is another
SCATTER = 4.0  # deviations by which segments may differ by chance, together and each
GROWING = 0.15  # share of the errors' variance that is larger where outputs move with the delay
TELLING = 0.5  # share of the range of delays: a window with a wider interval tells nothing


@dataclass(frozen=True)
class Windows:
    """Delays over time: the middle t (W,) of each window, D (W, m) and its interval of 95 % (W, m, 2)."""

    t: np.ndarray
    D: np.ndarray
    interval: np.ndarray
    period: float
    longest: np.ndarray  # (m,) delays that were tried

    def telling(self, j: int) -> np.ndarray:
        """(W,) True for a window that tells the delay of input j."""
        return np.ptp(self.interval[:, j], axis=-1) < TELLING * self.longest[j]

    def others(self, j: int, whole: np.ndarray) -> np.ndarray:
        """(W,) True where the delay of input j is not the one that the whole log has, its interval being (2,)."""
        low, high = self.interval[:, j].T
        return self.telling(j) & ((low > whole[1]) | (high < whole[0]))

    def vary(self, j: int, whole: np.ndarray) -> bool:
        """True if no constant delay fits the whole log and all windows."""
        D, ends = (each[self.telling(j), j] for each in (self.D, self.interval))
        weight = np.maximum(np.ptp(ends, axis=-1) / (2 * NORMAL), FINE * self.period) ** -2
        more = len(D) - 1
        Q = weight @ (D - weight @ D / weight.sum()) ** 2 if more > 0 else 0.0
        return more > 0 and bool(self.others(j, whole).any() or more + APART * np.sqrt(2 * more) < Q)

    def seen(self, j: int) -> tuple[np.ndarray, float]:
        """(2,) all delays that windows tell, at the first one's begin and behind the last one if they go on so; and the
        delay of the last one. At least two have to tell it.
        """
        D, (low, high) = self.D[self.telling(j), j], self.interval[self.telling(j), j].T
        ends = 1.5 * D[0] - 0.5 * D[1], 2 * D[-1] - D[-2]
        return np.clip([min(low.min(), *ends), max(high.max(), *ends)], 0.0, self.longest[j]), float(D[-1])

    def sentence(self, plant: Plant, j: int, whole: np.ndarray) -> str:
        """How the delay of input j goes over the windows."""
        name, time, others = plant.inputs[j], plant.time_text, int(self.others(j, whole).sum())
        least, most = (time(D, ".3g") for D in (self.D[:, j].min(), self.D[:, j].max()))
        fits = f"in {others} of them the delay is another than in the whole log" if others else (
            "they differ" if self.vary(j, whole) else "a constant delay fits all of them")  # fmt: skip
        return f"In {len(self.t)} windows of time the delay of {name} is {least} to {most}: {fits}."


def over_time(delays: Delays, low: np.ndarray, high: np.ndarray, first: Segments | None) -> Windows:
    """The delays of parts of the log, each by itself, with parameters near those of the whole log.

    A window begins where the scan of the whole range was lowest in it. `first` is the part of the log before that which
    the delays are of: a window where the delays of the whole log err by more there.
    """
    problem = tethered(delays.problem.some(COARSE), delays.fit.best_theta)
    S, period = len(problem.segments), problem.segments.log.period
    rows = [
        _window(replace(problem, segments=problem.segments.some(chosen)), delays.grid, chosen, delays, low, high)
        for chosen in np.array_split(np.arange(S), int(np.clip(S // SEGMENTS, 1, MOST)))
    ]
    part = replace(problem, segments=first) if first else problem
    errors = mean_square(part.fit(delays.values, None, 4).residuals).max()
    if first and errors > LARGER * mean_square(delays.fit.residuals).max():
        grid: list[SegmentFit] = []

        def at(z: np.ndarray, start: SegmentFit | None) -> SegmentFit:
            grid.append(part.fit(z, start, 1))
            return grid[-1]

        search.scan(at, low, high, 2 * period)
        rows.insert(0, _window(part, grid, np.arange(len(first)), delays, low, high))
    t, D, interval = (np.array(column) for column in zip(*rows, strict=True))
    return Windows(t, D, interval, period, high)


def _window(
    part: Problem, grid: list[SegmentFit], chosen: np.ndarray, delays: Delays, low: np.ndarray, high: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """The middle of a part of the log, its delays, and their intervals; it has the segments `chosen` of the `grid`."""
    weights, t, period = np.zeros((1, len(grid[0].e))), part.segments.t, part.segments.log.period
    weights[:, chosen] = 1.0
    costs, places = np.array([fit.costs(weights)[0] for fit in grid]), np.array([fit.delays for fit in grid])
    begin = grid[int(costs.argmin())]
    fit = part.fit(begin.delays, replace(begin, X=begin.X[chosen], theta=part.prior.mean), 4)
    _, fit, widths = search.descend(part.at, fit, fit.delays, low, high, period, FINEST * period)
    minimum = profiled(part, fit, widths, low, high)
    ends = minimum.interval
    rises = (costs - costs.min()) * max(minimum.fit.count, 1) / max(costs.min(), 1e-300)  # in sizes of the errors
    reach = np.array([[p.values[0], p.values[-1]] for p in minimum.profiles]).T
    beyond = ((places < reach[0]) | (places > reach[1])).any(axis=1) & (rises <= minimum.levels.min())
    constant = minimum.problem.fit(delays.values, minimum.fit, 4)
    clear = constant.cost - minimum.fit.cost > OTHER * CLEAR * minimum.inflation
    before = grid is not delays.grid  # where errors speak against the constant delay by themselves
    alike = [] if clear and (before or better(minimum.fit, constant, minimum.inflation)) else [delays.values]
    for place in [*places[beyond], *alike]:
        ends = np.stack([np.minimum(ends[:, 0], place), np.maximum(ends[:, 1], place)], axis=1)
    return (t[0, 0] + t[-1, -1]) / 2, minimum.fit.delays, ends


def scattered(delays: Delays, j: int) -> float:
    """The standard deviation by which the delay of input j differs from command to command; 0 where no errors say so.

    Errors that come of it are larger where the outputs move with the delay [Breusch and Pagan, Econometrica 47 (1979)
    1287], those of most disturbances are not. Of errors that are noise else, the delays that each segment would have
    tell more [DerSimonian and Laird, Control. Clin. Trials 7 (1986) 177].
    """
    profile, r = delays.profiles[j], delays.fit.residuals
    best = int(profile.costs.argmin())
    far = np.flatnonzero(profile.costs - profile.costs[best] > LEVEL * delays.inflation)
    low, high = max([0, *far[far < best]]), min([len(profile.values) - 1, *far[far > best]])
    if low == high:
        return 0.0
    slope = (profile.fits[high].residuals - profile.fits[low].residuals) / (profile.values[high] - profile.values[low])
    measured = np.isfinite(r) & np.isfinite(slope)
    r, slope = np.where(measured, r, 0.0), np.where(measured, slope, 0.0)
    if delays.inflation > MISSING:
        x, y = slope[measured] ** 2, r[measured] ** 2
        variance = (x - x.mean()) @ y / max((x - x.mean()) @ x, 1e-300)
        return float(np.sqrt(variance)) if variance * x.mean() > GROWING * y.mean() else 0.0
    weight = np.maximum((slope**2).sum(axis=(1, 2)), 1e-300) / delays.inflation
    moved, more = (slope * r).sum(axis=(1, 2)) / delays.inflation / weight, len(r) - 1
    each = weight * (moved - weight @ moved / weight.sum()) ** 2
    variance = (each.sum() - more) / (weight.sum() - weight @ weight / weight.sum())
    unlike = each.sum() > more + SCATTER * np.sqrt(2 * more) or each.max() > SCATTER**2
    return float(np.sqrt(max(variance, 0.0))) if unlike else 0.0
