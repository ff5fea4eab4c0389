"""The delays and the parameters of a log with intervals of 95 %: by profiles, and by drawing the segments anew."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from npred.base import randomness
from npred.identification import search
from npred.identification.fit import Problem, SegmentFit, better
from npred.identification.search import LEVEL, Profile
from npred.plants import Plant

COARSE = 2500  # samples of the first scan
PLACES = 8  # local minima of it that are looked at again
TETHER = 0.3  # how far, relatively, a free parameter goes in the first scan, where the delay is still wrong
APART = 2.0  # deviations by which one minimum is better than another
FINEST = 2e-3  # in sampling periods
SEARCHED = 15000  # samples by which the least cost is searched first
DRAWS = 400
SHARES = 0.025, 0.975
NORMAL = 1.96  # deviations of 95 %


@dataclass(frozen=True)
class Delays:
    """Delays (m,), their intervals (m, 2), and the profiles that these come from."""

    problem: Problem
    values: np.ndarray
    interval: np.ndarray
    fit: SegmentFit
    profiles: list[Profile]
    widths: np.ndarray
    inflation: float

    @property
    def level(self) -> float:
        """How far above the least cost a fit may be that the data do not tell from the best."""
        return LEVEL * self.inflation


def estimate(problem: Problem, low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> Delays:
    """The delays between `low` and `high` (m,)."""
    period = problem.segments.log.period
    coarse = _tethered(problem.some(COARSE))
    places = search.scan(lambda z, start: coarse.fit(z, start, 1), low, high, period)
    problem = problem.rescaled(problem.fit(places[0][0]))
    coarse = _tethered(problem.some(COARSE))  # once more, with the size of the residuals
    places = sorted(((z, coarse.fit(z, None, 2).cost) for z, _ in places[:PLACES]), key=lambda pair: pair[1])

    few = problem.some(SEARCHED)
    z, fit = min(((z, few.fit(z)) for z, _ in places[:3]), key=lambda pair: pair[1].cost)
    z, fit, widths = search.descend(_at(few), fit, z, low, high, period, FINEST * period)
    if len(few.segments) < len(problem.segments):
        z, fit, widths = search.descend(
            _at(problem), problem.fit(z), z, low, high, float(widths.max()), FINEST * period
        )
    problem = problem.rescaled(fit)
    fit = problem.fit(z, fit)
    scale = np.sqrt(max(fit.cost / max(fit.count, 1), 1e-12))
    inflation = correlation_time(fit.residuals)
    profiles = [search.profile(_at(problem), fit, z, j, low, high, widths * scale) for j in range(len(z))]
    ends = np.empty((len(z), 2))
    for j, p in enumerate(profiles):  # the least interval around that by costs and that by segments drawn anew
        by_cost = search.interval(p.values, p.costs - p.costs.min(), LEVEL * inflation)
        low_draw, high_draw = np.quantile(drawn(p, rng)[0], SHARES)
        ends[j] = min(by_cost[0], low_draw), max(by_cost[1], high_draw)
    for place, _ in places:  # other minima that may be as good: of a periodic input, say
        beyond = any(not p.values[0] <= end <= p.values[-1] for p, end in zip(profiles, place, strict=True))
        if beyond and not better(fit, problem.fit(place), inflation, APART):
            ends = np.stack([np.minimum(ends[:, 0], place), np.maximum(ends[:, 1], place)], axis=1)
    return Delays(problem, z, ends, fit, profiles, widths, inflation)


def _at(problem: Problem) -> search.At:
    """The fit of a problem with given delays, from another one."""
    return lambda z, start: problem.fit(z, start, 2)


def _tethered(problem: Problem) -> Problem:
    """The problem with free parameters held near their values."""
    prior = problem.prior
    near = np.where(prior.mean == 0, np.inf, TETHER * np.abs(prior.mean))
    deviation = np.minimum(prior.deviation, near)
    return replace(problem, prior=replace(prior, deviation=deviation))


def drawn(profile: Profile, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The place of the least cost for DRAWS sets of weights of the segments (DRAWS,), and theta (DRAWS, q) there."""
    S = len(profile.fits[0].e)
    weights = rng.standard_exponential((DRAWS, S))
    weights *= S / weights.sum(axis=1, keepdims=True)
    costs = np.stack([fit.costs(weights) for fit in profile.fits], axis=1)
    lowest, rows = costs.argmin(axis=1), np.arange(DRAWS)
    thetas = np.stack([fit.thetas(weights) for fit in profile.fits], axis=1)[rows, lowest]
    if len(profile.values) < 3:
        return profile.values[lowest], thetas
    k = np.clip(lowest, 1, len(profile.values) - 2)
    x = np.stack([profile.values[k + i] for i in (-1, 0, 1)])
    y = np.stack([costs[rows, k + i] for i in (-1, 0, 1)])
    with np.errstate(all="ignore"):  # the parabola through three points; their lowest where it opens downwards
        d1, d2 = (y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1])
        curve = (d2 - d1) / (x[2] - x[0])
        vertex = (x[0] + x[1]) / 2 - d1 / (2 * curve)
    least = np.take_along_axis(x, np.nan_to_num(y, nan=np.inf).argmin(axis=0)[None], axis=0)[0]
    return np.clip(np.where((curve > 0) & np.isfinite(vertex), vertex, least), x[0], x[2]), thetas


def correlation_time(residuals: np.ndarray) -> float:
    """1 + 2 Σ ρ_k of the residuals along their segments, up to the first k where ρ_k is below 0; 1 at least."""
    r = np.where(np.isfinite(residuals), residuals, 0.0)
    present = np.isfinite(residuals).astype(float)
    total, variance = 1.0, (r * r).sum() / max(present.sum(), 1)
    for k in range(1, max(2, r.shape[1] // 3)):
        pairs = (present[:, k:] * present[:, :-k]).sum()
        rho = (r[:, k:] * r[:, :-k]).sum() / max(pairs, 1) / max(variance, 1e-300)
        if rho <= 0:
            break
        total += 2 * rho
    return total


class Parameter(NamedTuple):
    """A value with its interval of 95 %, and the correlation of its error with that of the nearest delay."""

    value: float
    low: float
    high: float
    correlation: float


def parameters(plant: Plant, delays: Delays, seed: int) -> tuple[dict[str, Parameter], dict[str, float]]:
    """The free parameters by name; and how far the other ones are from the plant's, in shares of the allowed error.

    An interval is the least one around two: that of the cost's curvature, which what the delays leave open widens, and
    that of drawing the segments anew.
    """
    problem, names = delays.problem, [*plant.parameters, *(f"offset of {name}" for name in plant.inputs)]
    prior, all_segments = problem.prior, np.ones((1, len(delays.fit.e)))
    theta = delays.fit.thetas(all_segments)[0]
    if not len(theta):
        return {}, {}
    rng = randomness.generator(seed, "parameters")
    draws, moved = [], []  # theta for each draw; how theta moves as a delay goes by its deviation
    for j, profile in enumerate(delays.profiles):
        draws += list(drawn(profile, rng)[1])
        near = np.flatnonzero(profile.costs - profile.costs.min() < 4 * delays.level)
        thetas = np.array([profile.fits[k].thetas(all_segments)[0] for k in near])
        slope = np.polyfit(profile.values[near], thetas, 1)[0] if len(near) > 2 else np.zeros(len(theta))
        moved.append(slope * np.ptp(delays.interval[j]) / (2 * NORMAL))
    covariance = np.linalg.pinv(delays.fit.H.sum(axis=0) + np.diag(prior.weight)) * delays.inflation
    size = np.sqrt(np.diag(covariance) + np.square(moved).sum(axis=0))
    low, high = np.quantile(draws, SHARES, axis=0)
    low, high = np.minimum(low, theta - NORMAL * size), np.maximum(high, theta + NORMAL * size)
    low, high = (np.clip(ends, *prior.limits) for ends in (low, high))
    nearest = np.take_along_axis(np.array(moved), np.abs(moved).argmax(axis=0)[None], axis=0)[0]
    correlation = nearest / np.maximum(size, 1e-300)
    rows = [Parameter(*map(float, row)) for row in zip(theta, low, high, correlation, strict=True)]
    free, deviations = np.isinf(prior.deviation), (theta - prior.mean) / prior.deviation
    label = [names[place] for place in problem.model.free]
    return (
        {label[k]: rows[k] for k in np.flatnonzero(free)},
        {label[k]: float(deviations[k]) for k in np.flatnonzero(~free)},
    )
