"""The delays and the parameters of a log with intervals of 95 %: by profiles, and by drawing the segments anew."""

from dataclasses import dataclass, replace
from itertools import permutations
from typing import NamedTuple

import numpy as np

from npred.base import randomness
from npred.identification import excitation, search
from npred.identification.fit import CLEAR, LEAST, STEPS, Problem, SegmentFit, better
from npred.identification.log import spread
from npred.identification.search import LEVEL, Profile
from npred.plants import Plant

COARSE = 2500  # samples of the first scan
ROUGH = 600  # samples by which first values of the parameters are chosen
FACTORS = 0.25, 4.0  # of each free parameter, from which the search starts too
STARTS, LOWER = 3, 0.05  # first values that are tried to the end; how much lower the log of their errors comes
RECENTRED = 3  # times that the search goes on from a place of its profile that is lower
PLACES = 8  # local minima of a scan that are looked at again
TETHER = 0.3  # how far, relatively, a free parameter goes in the first scan, where the delay is still wrong
APART = 2.0  # deviations by which one minimum is better than another
MISSING = 2.0  # correlation time of residuals, in samples or segments, from which on the model misses something
UNSHARP = 4.0  # times the level, for an input without sharp steps
FEW = 5.0  # times CLEAR: so much worse by few segments alone is worse all the same
NEARBY = 4.0  # times the least cost: minima of a grid that are looked at
ALIKE = 0.15  # share of the cost that another delay may add if the model misses something
RIVAL = 2.0  # times the least cost: another minimum of a model that misses something may be the right one
FINEST = 2e-3  # in sampling periods
SEARCHED = 15000  # samples by which the least cost is searched first
DRAWS = 400
SHARES = 0.025, 0.975
NORMAL = 1.96  # deviations of 95 %
WIDE = 0.1  # relative deviation from which on an interval is by the profile
TIGHT = 0.02  # share of the variance of the parameters, in their deviations, that a combination that is known has


@dataclass(frozen=True)
class Delays:
    """Delays (m,), their intervals (m, 2), and the profiles that these come from.

    `others` are the parameters at other minima that the data do not tell from the best; `grid` are fits of part of the
    samples all over the range; `accurate` is False where RK4's steps cannot be made fine enough; `drift` is the
    correlation time, in segments, of what joined segments tell anew.
    """

    problem: Problem
    values: np.ndarray
    interval: np.ndarray
    fit: SegmentFit
    profiles: list[Profile]
    widths: np.ndarray
    inflation: float
    others: list[np.ndarray]
    grid: list[SegmentFit]
    accurate: bool
    drift: float

    @property
    def size(self) -> float:
        """The logarithm of the errors."""
        return self.problem.size_of(self.fit)

    @property
    def lasting(self) -> float:
        """For how long the plant goes one way against the model; 0 if that is for no longer than MISSING segments."""
        t = self.problem.segments.t
        return float(self.drift * np.median(t[:, -1] - t[:, 0])) if self.drift > MISSING else 0.0

    @property
    def levels(self) -> np.ndarray:
        """How far above the least cost a fit may be that the data do not tell from the best, by delay (m,)."""
        return levels_of(self.fit, self.inflation, self.problem)


def levels_of(fit: SegmentFit, inflation: float, problem: Problem) -> np.ndarray:
    """(m,) LEVEL times the correlation time, or ALIKE of the cost if the model misses something, which may move the
    minimum; UNSHARP times as much for an input without sharp steps.
    """
    level = max(LEVEL * inflation, ALIKE * fit.cost if inflation > MISSING else 0.0)
    return level * np.where(excitation.smooth(problem.segments.log), UNSHARP, 1.0)


def estimate(problem: Problem, low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> Delays:
    """The delays between `low` and `high` (m,)."""
    begins = [_begin(begun, low, high) for begun in _starts(problem, low, high)]
    sizes = np.array([few.size_of(fit) for _, few, fit in begins])
    sizes[1:] += LOWER  # parameters that may be exchanged are taken as the first values have them
    problem, few, fit = begins[sizes.argmin()]
    problem, fit, widths, accurate = _minimum(problem, few, fit, low, high)
    if problem.jump is not None:
        problem = problem.joined(fit)
        step, least = float(widths.max()), FINEST * problem.segments.log.period
        _, fit, widths = search.descend(problem.at, problem.fit(fit.delays, fit, 6), fit.delays, low, high, step, least)
    minimum = profiled(problem, fit, widths, low, high)
    problem, fit, inflation, profiles = minimum.problem, minimum.fit, minimum.inflation, minimum.profiles
    ends = np.empty((len(fit.delays), 2))
    for j, p in enumerate(profiles):  # the least interval around that by costs and that by segments drawn anew
        low_draw, high_draw = np.quantile(drawn(p, rng)[0], SHARES)
        ends[j] = min(minimum.interval[j, 0], low_draw), max(minimum.interval[j, 1], high_draw)
    others, grid = _other_minima(minimum, low, high)
    for place, rise, _ in others:
        if rise < FEW * CLEAR * inflation:
            ends = np.stack([np.minimum(ends[:, 0], place), np.maximum(ends[:, 1], place)], axis=1)
    drift, thetas = correlation_time(problem.surprises(fit)[None]), [theta for *_, theta in others]
    widths = minimum.widths
    return Delays(problem, fit.delays, ends, fit, profiles, widths, inflation, thetas, grid, accurate, drift)


@dataclass(frozen=True)
class Minimum:
    """A minimum: its problem with residuals of their size, its fit, and the profiles of the delays around it.

    `interval` (m, 2) is that by costs; a width (m,) is where the cost rises by about 1.
    """

    problem: Problem
    fit: SegmentFit
    widths: np.ndarray
    inflation: float
    profiles: list[Profile]

    @property
    def levels(self) -> np.ndarray:
        return levels_of(self.fit, self.inflation, self.problem)

    @property
    def interval(self) -> np.ndarray:
        pairs = zip(self.profiles, self.levels, strict=True)
        return np.array([search.interval(p.values, p.costs - p.costs.min(), level) for p, level in pairs])


def profiled(problem: Problem, fit: SegmentFit, widths: np.ndarray, low: np.ndarray, high: np.ndarray) -> Minimum:
    """The minimum near a fit; the search goes on from a place of its profile that is lower."""
    z = fit.delays
    for left in reversed(range(RECENTRED)):
        problem = problem.rescaled(fit)
        fit = problem.fit(z, fit)
        scale = np.sqrt(max(fit.cost / max(fit.count, 1), 1e-12))
        inflation = correlation_time(fit.residuals)
        if inflation > MISSING:  # what is missing decides, not the number of samples
            problem = problem.some(SEARCHED)
            fit = problem.fit(z, problem.begun(fit))
        levels = levels_of(fit, inflation, problem)
        far = max(float(levels.max()) + search.FAR, 4 * LEVEL * inflation)
        profiles = [search.profile(problem.at, fit, z, j, low, high, widths * scale, far) for j in range(len(z))]
        best = min((each for p in profiles for each in p.fits), key=lambda each: each.cost)
        if not left or not best.cost < fit.cost - 0.1 * LEVEL:  # the profiles are those of the fit
            break
        z, fit, step = best.delays, problem.fit(best.delays, best, 6), float(widths.max())
        period = problem.segments.log.period
        z, fit, widths = search.descend(problem.at, fit, z, low, high, step, FINEST * period)
    return Minimum(problem, fit, widths, inflation, profiles)


def _begin(problem: Problem, low: np.ndarray, high: np.ndarray) -> tuple[Problem, Problem, SegmentFit]:
    """The problem with residuals of their size, the same on part of the samples, and the best fit of a scan to that."""
    coarse, period = tethered(problem.some(COARSE), problem.prior.mean), problem.segments.log.period
    places = search.scan(lambda z, start: coarse.fit(z, start, 1), low, high, period)
    problem = problem.rescaled(problem.fit(places[0][0]))
    coarse = tethered(problem.some(COARSE), problem.prior.mean)  # once more, with the size of the residuals
    places = sorted(((z, coarse.fit(z, None, 2).cost) for z, _ in places[:PLACES]), key=lambda pair: pair[1])
    few = problem.some(SEARCHED)
    fits = sorted((few.fit(z) for z, _ in places[:3]), key=lambda fit: fit.cost)
    if problem.jump is None:
        return problem, few, fits[0]
    begun = problem.begun(fits[0])
    problem = problem.joined(problem.fit(begun.delays, begun, 6))
    few = problem.some(SEARCHED)
    return problem, few, min((few.fit(fit.delays, few.begun(fit), 6) for fit in fits), key=lambda fit: fit.cost)


def _minimum(
    problem: Problem, few: Problem, fit: SegmentFit, low: np.ndarray, high: np.ndarray
) -> tuple[Problem, SegmentFit, np.ndarray, bool]:
    """The problem with steps fine enough at its minimum, the fit there, the widths; whether they are."""
    z, period = fit.delays, problem.segments.log.period
    step = period
    while True:
        z, fit, widths = search.descend(few.at, fit, z, low, high, step, FINEST * period)
        finer = few.refined(fit)
        if finer.model.steps == few.model.steps or finer.model.steps > STEPS:
            break
        problem, few = replace(problem, model=finer.model), finer
        fit, step = few.fit(z, fit, 6), max(float(widths.max()), period / 4)
    if few.segments is not problem.segments:
        fit = problem.fit(z, problem.begun(fit))
        z, fit, widths = search.descend(problem.at, fit, z, low, high, float(widths.max()), FINEST * period)
    return problem, fit, widths, finer.model.steps <= STEPS


def _starts(problem: Problem, low: np.ndarray, high: np.ndarray) -> list[Problem]:
    """The problem, and it with other first values of the free parameters if a few rough fits from there come lower."""
    free = np.flatnonzero(np.isinf(problem.prior.deviation))
    rough, mean, rows = problem.some(ROUGH), problem.prior.mean, []
    for place, factor in [(0, 1.0), *((k, factor) for k in free for factor in FACTORS)] if len(free) else []:
        start = mean.copy()
        start[place] *= factor
        begun = replace(rough, prior=replace(rough.prior, mean=start))
        for share in (0.1, 0.3, 0.5, 0.8):
            fit = begun.fit(low + share * (high - low), None, 4)
            begun = begun.refined(fit)
            fit = begun.fit(fit.delays, fit, 4)
            if np.isfinite(size := begun.size_of(fit)):
                rows.append((size, factor == 1.0, fit.theta, begun.model))
    starts, least = [problem], min((size for size, first, *_ in rows if first), default=np.inf)
    for size, _, theta, model in sorted(rows, key=lambda row: row[0]):
        far = [np.abs(theta - each.prior.mean)[free].max() > TETHER * np.abs(theta)[free].max() for each in starts]
        if size < least - LOWER and all(far) and len(starts) < STARTS:
            theta = np.where(np.isinf(problem.prior.deviation), theta, mean)
            starts.append(replace(problem, model=model, prior=replace(problem.prior, mean=theta)))
    return starts


def _other_minima(
    minimum: Minimum, low: np.ndarray, high: np.ndarray
) -> tuple[list[tuple[np.ndarray, float, np.ndarray]], list[SegmentFit]]:
    """Delays of local minima beyond the profiles, anywhere in the range, that are not clearly worse than the best, or
    by few segments alone; by how much; and the parameters there. Behind these, the fits of the scan.
    """
    problem, fit, inflation, grid = minimum.problem, minimum.fit, minimum.inflation, []
    coarse, period = problem.some(COARSE), problem.segments.log.period
    best = coarse.fit(fit.delays, replace(coarse.begun(fit), theta=fit.best_theta))
    ends = np.array([[p.values[0], p.values[-1]] for p in minimum.profiles]).T
    inner, outer = np.minimum(ends[0], fit.delays - period), np.maximum(ends[1], fit.delays + period)

    def at(z: np.ndarray, _: SegmentFit | None) -> SegmentFit:
        grid.append(coarse.fit(z, best, 1))
        return grid[-1]

    minima = search.scan(at, low, high, 2 * period)[: 2 * PLACES]
    places = [z for z, cost in minima if cost < NEARBY * best.cost]
    places += [fit.delays[list(order)] for order in permutations(range(len(low)))][1:]
    others = []
    for place in places:
        z, other = search.nearby(coarse.at, coarse.fit(place, best, 4), low, high, period, 16)
        if ((inner <= z) & (z <= outer)).all():
            continue
        wrong = inflation > MISSING and other.cost < RIVAL * best.cost
        if wrong or not better(best, other, inflation, APART):
            others.append((z, 0.0 if wrong else other.cost - best.cost, other.best_theta))
    return others, grid


def tethered(problem: Problem, theta: np.ndarray) -> Problem:
    """The problem with free parameters held near theta (q,)."""
    prior = problem.prior
    mean = np.where(np.isinf(prior.deviation), theta, prior.mean)
    near = np.where(mean == 0, np.inf, TETHER * np.abs(mean))
    return replace(problem, prior=replace(prior, mean=mean, deviation=np.minimum(prior.deviation, near)))


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
    for k in range(1, max(2, (r.shape[1] - 1) // 3)):
        pairs = (present[:, k:] * present[:, :-k]).sum()
        rho = (r[:, k:] * r[:, :-k]).sum() / max(pairs, 1) / max(variance, 1e-300)
        if rho <= 0:
            break
        total += 2 * rho
    return total


def correlated_share(delays: Delays) -> float:
    """The size of errors that keep their sign from one sample to the next, in spreads of the output; of the worst."""
    errors, Y = delays.fit.residuals * delays.problem.scale, delays.problem.segments.Y
    products = errors[:, 1:] * errors[:, :-1]
    mean = np.nansum(products, axis=(0, 1)) / np.maximum(np.isfinite(products).sum(axis=(0, 1)), 1)
    wide = spread(Y.reshape(-1, Y.shape[-1]))
    return float(np.sqrt(np.max(mean / np.where(wide > 0, wide, np.inf) ** 2, initial=0.0)))


class Parameter(NamedTuple):
    """A value with its interval of 95 %, and the correlation of its error with that of the nearest delay."""

    value: float
    low: float
    high: float
    correlation: float


class Combination(NamedTuple):
    """Names of parameters, their factors, and the value of the sum, which the log tells, with its deviation."""

    names: list[str]
    factors: list[float]
    value: float
    deviation: float


def parameters(
    plant: Plant, delays: Delays, seed: int
) -> tuple[dict[str, Parameter], dict[str, float], Combination | None]:
    """The free parameters by name; how far the other ones are from the plant's, in shares of the allowed error; and a
    combination of the free ones that alone is known.

    An interval is the least one around four: those of the cost's curvature at each delay that is possible, that of
    drawing the segments anew, the values at other minima, and, where it is wide, that of the profile over the other
    parameters and the delay. It is `drift` times as wide: the few swings of a slow disturbance do not average out.
    """
    problem, names = delays.problem, [*plant.p_names, *(f"offset of {name}" for name in plant.inputs)]
    prior, theta = problem.prior, delays.fit.best_theta
    if not len(theta):
        return {}, {}, None
    rng, low, high = randomness.generator(seed, "parameters"), theta.copy(), theta.copy()
    bounds, moved = (
        (theta, theta),
        [],
    )  # theta where other delays are possible; how theta moves as a delay goes by its deviation
    for j, profile in enumerate(delays.profiles):
        rises = profile.costs - profile.costs.min()
        level = float(delays.levels[j])
        near = np.flatnonzero(rises < max(level, 4 * LEVEL * delays.inflation))
        thetas = np.array([profile.fits[k].best_theta for k in near])
        for at, rise, fit in zip(thetas, rises[near], (profile.fits[k] for k in near), strict=True):
            if rise < level:
                variance = np.diag(_covariance(fit.H.sum(axis=0) + np.diag(prior.weight)))
                room = np.sqrt(variance * (level - rise))
                low, high = np.minimum(low, at - room), np.maximum(high, at + room)
                bounds = np.minimum(bounds[0], at), np.maximum(bounds[1], at)
        ends = np.quantile(drawn(profile, rng)[1], SHARES, axis=0)
        low, high = np.minimum(low, ends[0]), np.maximum(high, ends[1])
        slope = np.polyfit(profile.values[near], thetas, 1)[0] if len(near) > 2 else np.zeros(len(theta))
        moved.append(delays.drift * slope * np.ptp(delays.interval[j]) / (2 * NORMAL))
    for other in delays.others:
        bounds = np.minimum(bounds[0], other), np.maximum(bounds[1], other)
    low, high = np.minimum(low, bounds[0]), np.maximum(high, bounds[1])
    covariance = _covariance(delays.fit.H.sum(axis=0) + np.diag(prior.weight)) * delays.inflation * delays.drift**2
    covariance = covariance + sum(np.outer(each, each) for each in moved)
    size, free = np.sqrt(np.diag(covariance)), np.isinf(prior.deviation)
    for k in np.flatnonzero(free & (high - low > 2 * NORMAL * WIDE * np.abs(theta))):
        ends = _profiled(delays, theta, int(k), float(high[k] - low[k]) / (2 * NORMAL))
        low[k], high[k] = min(ends[0], bounds[0][k]), max(ends[1], bounds[1][k])
    low, high = (np.clip(theta + delays.drift * (ends - theta), *prior.limits) for ends in (low, high))
    nearest = np.take_along_axis(np.array(moved), np.abs(moved).argmax(axis=0)[None], axis=0)[0]
    correlation = nearest / np.maximum(size, 1e-300)
    rows = [Parameter(*map(float, row)) for row in zip(theta, low, high, correlation, strict=True)]
    deviations = (theta - prior.mean) / prior.deviation
    label = [names[place] for place in problem.model.free]
    return (
        {label[k]: rows[k] for k in np.flatnonzero(free)},
        {label[k]: float(deviations[k]) for k in np.flatnonzero(~free)},
        _combination(label, theta, covariance, np.flatnonzero(free & (size > WIDE * np.abs(theta)))),
    )


def _covariance(H: np.ndarray) -> np.ndarray:
    """H⁻¹, large but finite along the combinations that H does not show."""
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    values, vectors = np.linalg.eigh(np.nan_to_num(H / np.outer(size, size), posinf=0.0, neginf=0.0))
    return (vectors / np.maximum(values, LEAST)) @ vectors.T / np.outer(size, size)


def _profiled(delays: Delays, theta: np.ndarray, k: int, size: float) -> tuple[float, float]:
    """The values of parameter k whose cost, over all others and the delays, is not clearly above the least one.

    Infinite where the cost does not rise as the parameter grows a hundredfold.
    """
    few, limits = delays.problem.some(COARSE), delays.problem.prior.limits[:, k]
    first = few.fit(delays.values, few.begun(delays.fit), 4)
    reach = [(p.values[0], p.values[-1]) for p in delays.profiles]
    low, high = np.array(reach).T
    step_D, ends = float(np.ptp(delays.interval, axis=1).max()) / 4 + 1e-9 * few.segments.log.period, []
    for side in (-1.0, 1.0):
        step, value, root, fit = min(size, 0.5 * abs(theta[k]) + 1e-9), float(theta[k]), 0.0, first
        while True:
            beyond = value + side * step
            pinned, there = few.pinned(k, clipped := float(np.clip(beyond, *limits))), fit
            there = pinned.fit(fit.delays, fit, 4)
            there = search.descend(pinned.at, there, fit.delays, low, high, step_D, step_D / 4)[1]
            rise = max(there.cost - first.cost, 0.0) / delays.inflation
            reached = np.sqrt(rise) if np.isfinite(rise) else np.inf
            if reached >= np.sqrt(LEVEL):
                share = (np.sqrt(LEVEL) - root) / max(reached - root, 1e-12)
                ends.append(value + share * (clipped - value))
                break
            if clipped != beyond or abs(clipped - theta[k]) > 100 * (abs(theta[k]) + min(size, 1e9)):
                ends.append(clipped if clipped != beyond else side * np.inf)
                break
            value, root, step, fit = clipped, float(reached), 2 * step, there
    return ends[0], ends[1]


def _combination(names: list[str], theta: np.ndarray, covariance: np.ndarray, wide: np.ndarray) -> Combination | None:
    """The sum of the parameters `wide`, none of which is known, that is known best; None if it is not much better."""
    if len(wide) < 2:
        return None
    part = covariance[np.ix_(wide, wide)]
    size = np.sqrt(np.diag(part))
    values, vectors = np.linalg.eigh(part / np.outer(size, size))
    if values[0] > TIGHT:
        return None
    factors = vectors[:, 0] / size
    factors = factors / factors[np.abs(vectors[:, 0]).argmax()]
    kept = np.abs(factors * size) > 0.05 * np.abs(factors * size).max()
    factors, wide = factors[kept], wide[kept]
    if len(wide) < 2:
        return None
    deviation = np.sqrt(max(factors @ covariance[np.ix_(wide, wide)] @ factors, 0.0))
    if not deviation < WIDE * np.abs(factors * theta[wide]).max():
        return None
    return Combination([names[k] for k in wide], factors.tolist(), float(factors @ theta[wide]), float(deviation))
