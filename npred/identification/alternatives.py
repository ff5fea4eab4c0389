"""Other explanations of a log: a first-order lag in place of a delay, a lag behind it, or no delay at all.

Two models that do not contain each other are compared segment by segment [Vuong, Econometrica 57 (1989) 307]: the
difference of their costs has to be large, and larger than its scatter over the segments.
"""

from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from npred.identification import search
from npred.identification.estimate import FINEST, Delays, correlation_time, levels_of, profiled
from npred.identification.fit import Prior, Problem, SegmentFit, better
from npred.identification.log import Segments, spread

NONE = 1e-9  # in sampling periods: a shorter lag is none
HELD_BACK = 0.25
ALIKE = 0.05  # of the logarithm of errors: two ways to hold an input fit alike
DECIDING = 6500  # samples, by which models are compared
CLEARLY, MOSTLY = 1.25, 0.6  # a rival errs so much less, in this share of the segments: the model is contradicted
ORDER = 4.0  # times the least cost: a fit that is not of another order
HUGE = 1e60  # square of an error at which a model has run away
SHARES = 0.15, 0.3, 0.5, 0.75, 1.0  # lags to try, as shares of the delay


@dataclass(frozen=True)
class Alternative:
    """The best lag of input j in place of its delay, or behind it."""

    lag: float  # s, of a first-order lag in place of the delay
    as_good: bool  # the log does not prefer the delay
    short: bool  # the lag is shorter than a sampling period, which is as good as none
    least: float  # the shortest delay with a lag behind it that is not clearly worse than the delay alone
    behind: tuple[float, float] | None  # a delay and a lag that are clearly better than the delay alone
    interval: tuple[float, float] | None  # of that delay, by its profile

    @property
    def explains(self) -> bool:
        """True if a lag that counts may stand in place of the delay."""
        return self.as_good and not self.short


class Lines(NamedTuple):
    """The delays (m,) and intervals (m, 2) with commands in straight lines; whether these fit alike, and better."""

    D: np.ndarray
    interval: np.ndarray
    alike: bool
    better: bool


class Validation(NamedTuple):
    """The rms errors of the model and its rivals on the held-back part, and the rival that is clearly better.

    `delays` are those by which they predict, `lags` those of lags; errors are in the unit of output `single`, or of
    several outputs (None) in their standard deviations.
    """

    errors: dict[str, float]
    better: str | None
    samples: int = 0
    single: int | None = 0
    delays: dict[str, np.ndarray] = {}
    lags: dict[str, np.ndarray] = {}


@dataclass(frozen=True)
class FittedModel:
    """A model with delays and lags (m,), fitted; `lags` is None where it has none."""

    problem: Problem
    fit: SegmentFit
    lags: np.ndarray | None = None


def lag_instead(problem: Problem, model: SegmentFit, inputs: list[int], longest: float) -> FittedModel:
    """The best fit with first-order lags in place of the delays that these inputs have in the fit of the model."""
    lagged, period = problem.with_lag(), problem.segments.log.period
    D, tau = model.delays.copy(), np.full(len(model.delays), NONE * period)
    D[inputs] = 0.0

    def at(z: np.ndarray, start: SegmentFit | None) -> SegmentFit:
        tau[inputs] = np.exp(z)
        return lagged.fit(D, start or model, 2, tau)

    low, high = (np.full(len(inputs), np.log(end)) for end in (0.2 * period, max(longest, period)))
    z, _ = search.scan(at, low, high, 0.3)[0]
    z, fit, _ = search.descend(at, at(z, None), z, low, high, 0.15, 0.01)
    at(z, fit)
    return FittedModel(lagged, fit, tau.copy())


def prediction_error(candidate: FittedModel, segments: Segments, later: np.ndarray) -> np.ndarray:
    """Mean squares (later, outputs) over the last two thirds of the segments `later` (S,), which were not fitted to;
    their first thirds, and what goes before them, give x(0).
    """
    fit, third, Y = candidate.fit, _third(segments), segments.Y.copy()
    Y[later, third:] = np.nan
    theta = fit.best_theta
    fixed = Prior(theta, np.ones(len(theta)), np.stack([theta, theta]))
    problem = replace(candidate.problem, segments=replace(segments, Y=Y), prior=fixed)
    start = problem.fit(fit.delays, None, 4, candidate.lags)
    outputs = problem.outputs(replace(start, X=start.filtered), candidate.lags)
    return _squares((segments.Y - np.where(np.isnan(outputs), np.inf, outputs))[later, third:])


def static_error(train: Segments, later: Segments, delays: list[np.ndarray]) -> np.ndarray:
    """The same of constant gains, y = a + b u(t - D), with the best of these delays (m,), fitted to `train`."""
    best: tuple[float, np.ndarray] = np.inf, np.zeros((1, 1))
    Y, third = train.Y[train.mask], _third(later)
    unit = np.where(spread(Y) > 0, spread(Y), 1.0)  # of an output that never moves the gains are exact
    for D in delays:
        A, B = (np.concatenate([np.ones((*s.t.shape, 1)), s.log.arrived(s.t, D)], axis=-1) for s in (train, later))
        gains = np.zeros((A.shape[-1], Y.shape[1]))
        for k, y in enumerate(Y.T):
            rows = np.isfinite(y)
            gains[:, k] = np.linalg.lstsq(A[train.mask][rows], y[rows], rcond=None)[0]
        cost = float(np.nansum(((Y - A[train.mask] @ gains) / unit) ** 2))
        if cost <= best[0]:
            best = cost, (later.Y - B @ gains)[:, third:]
    return _squares(best[1])


def _third(segments: Segments) -> int:
    return max(2, (segments.t.shape[1] - 1) // 3)


def _squares(r: np.ndarray) -> np.ndarray:
    """The means (S, outputs) of the squares of finite r (S, K, outputs); infinite where a model has run away."""
    with np.errstate(all="ignore"):
        squares, finite = np.minimum(r**2, HUGE), ~np.isnan(r)
    return np.where(finite, squares, 0.0).sum(axis=1) / np.maximum(finite.sum(axis=1), 1)


def recurs(delays: Delays, periods: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(m,) True where the delay of an input may as well be one of its `periods` (m,) longer or shorter: the cost there
    is not of another order. `delays` are of as many samples as decide.
    """
    few, best, recurring = delays.problem, delays.fit, np.zeros(len(low), dtype=bool)
    for j in np.flatnonzero(periods < high):
        for side in (-1.0, 1.0):
            place = delays.values.copy()
            place[j] += side * periods[j]
            if low[j] <= place[j] <= high[j]:
                _, other = search.nearby(few.at, few.at(place, best), low, high, few.segments.log.period, 8)
                recurring[j] |= other.cost < ORDER * best.cost
    return recurring


def thinned(delays: Delays) -> Delays:
    """The same on as many samples as decide between models."""
    thinner = delays.problem.some(DECIDING)
    if thinner is delays.problem:
        return delays
    return replace(delays, problem=thinner, fit=thinner.fit(delays.values, thinner.begun(delays.fit), 6))


def of_input(delays: Delays, j: int, high: float) -> Alternative:
    """A lag in place of the delay of input j, and one behind it, against the delay alone."""
    instead, period = lag_instead(delays.problem, delays.fit, [j], high), delays.problem.segments.log.period
    assert instead.lags is not None
    as_good = not better(delays.fit, instead.fit, delays.inflation)
    if as_good or not delays.values[j] > 0:
        return Alternative(float(instead.lags[j]), as_good, bool(instead.lags[j] < period), 0.0, None, None)
    return Alternative(float(instead.lags[j]), as_good, False, *_lag_behind(delays, j, high))


def _lag_behind(
    delays: Delays, j: int, high: float
) -> tuple[float, tuple[float, float] | None, tuple[float, float] | None]:
    """What `Alternative` calls `least`, `behind` and `interval`: that by the profile of the delay, over all lags."""
    fit, lagged, period, rivals = delays.fit, delays.problem.with_lag(), delays.problem.segments.log.period, []

    def at(z: np.ndarray, start: SegmentFit | None, unit: float, problem: Problem = lagged) -> SegmentFit:
        """The fit with z: a delay, and the logarithm of a lag times `unit`."""
        moved, tau = fit.delays.copy(), np.full(len(fit.delays), NONE * period)
        moved[j], tau[j] = z[0], np.exp(z[1] / unit)
        return problem.fit(moved, start, 2, tau)

    least = float(delays.values[j])
    for share in SHARES:
        tau = share * max(fit.delays[j], period)
        z = np.array([max(fit.delays[j] - tau, 0.0), tau * np.log(tau)])
        bottom, top = np.array([0.0, z[1]]), np.array([fit.delays[j], z[1]])
        step = max(2 * delays.widths[j], 0.1 * tau)
        z, new, _ = search.descend(partial(at, unit=tau), at(z, fit, tau), z, bottom, top, step, 0.02 * tau)
        rivals.append((new, z, tau))
        if not better(fit, new, delays.inflation):
            least = min(least, float(new.delays[j]))
    new, z, tau = min(rivals, key=lambda rival: rival[0].cost)
    if not better(new, fit, delays.inflation):
        return least, None, None
    problem = lagged.rescaled(new)
    rival = partial(at, unit=tau, problem=problem)
    bottom, top = np.array([0.0, tau * np.log(0.2 * period)]), np.array([high, tau * np.log(max(high, period))])
    z, new, widths = search.descend(rival, rival(z, new), z, bottom, top, 0.1 * tau, 0.02 * tau)
    level = float(levels_of(new, correlation_time(new.residuals), problem)[j])
    profile = search.profile(rival, new, z, 0, bottom, top, widths, level + search.FAR)
    interval = search.interval(profile.values, profile.costs - profile.costs.min(), level)
    return least, (float(z[0]), float(np.exp(z[1] / tau))), interval


def in_lines(delays: Delays, low: np.ndarray, high: np.ndarray) -> Lines:
    """The fit with commands in straight lines between the rows, and the intervals of its delays."""
    segments, fit = delays.problem.segments, delays.fit
    problem = replace(delays.problem, segments=replace(segments, log=segments.log.as_lines()))
    begin = problem.fit(fit.delays + np.median(np.diff(segments.log.t_U)) / 2, fit, 4)  # held ones lag by that
    step, least = float(delays.widths.max()), FINEST * segments.log.period
    _, begin, widths = search.descend(problem.at, begin, begin.delays, low, high, step, least)
    minimum = profiled(problem, begin, widths, low, high)
    alike = problem.size_of(begin) < delays.problem.size_of(fit) + ALIKE
    return Lines(minimum.fit.delays, minimum.interval, alike, better(begin, fit, delays.inflation))


def held_back(delays: Delays, high: np.ndarray) -> Validation:
    """The errors on the last part of the log of models fitted to the rest; none for a log that is too short."""
    problem = delays.problem.some(DECIDING)
    segments, span = problem.segments, problem.segments.log.t[-1] - problem.segments.log.t[0]
    early = segments.t[:, -1] <= segments.log.t[0] + (1 - HELD_BACK) * span
    if early.sum() < 3 or (~early).sum() < 1 or segments.t.shape[1] < 4:
        return Validation({}, None)
    train = replace(problem, segments=segments.some(early))
    step, least = float(delays.widths.max()), 0.2 * float(delays.widths.min())
    first = train.fit(delays.values, replace(delays.fit, X=train.start()[0]), 6)
    z, fit, _ = search.descend(train.at, first, delays.values, np.zeros(len(high)), high, step, least)
    inputs, actual = list(range(len(z))), attrgetter("actual")
    none = min((train.fit(np.zeros(len(z)), start, 6) for start in (None, fit)), key=actual)
    for start in (first, none):  # a search that was lost is no model
        fit = min(fit, train.fit(delays.values, start, 6), key=actual)
    lag, behind = lag_instead(train, fit, inputs, float(high.max())), None
    for share in SHARES:  # a lag, and what is left of the delay
        tau = np.maximum(share * z, 0.2 * problem.segments.log.period)
        new = train.with_lag().fit(np.maximum(z - tau, 0.0), fit, 6, tau)
        if behind is None or new.cost < behind.fit.cost:
            behind = FittedModel(train.with_lag(), new, tau)
    assert behind is not None
    candidates = {
        "model": FittedModel(train, fit),
        "no_delay": FittedModel(train, none),
        "first_order_lag": lag,
        "lag_and_delay": behind,
    }
    squares = {name: prediction_error(candidate, segments, ~early) for name, candidate in candidates.items()}
    grid = [share * high for share in np.linspace(0.0, 1.0, 25)]
    squares["static"] = static_error(train.segments, segments.some(~early), [z, *grid])
    validation = validated(squares, spread(segments.log.Y))
    lags = {name: each.lags for name, each in candidates.items() if each.lags is not None}
    judged = np.isfinite(segments.Y[~early, _third(segments) :]).any(axis=-1)
    return validation._replace(
        samples=int(judged.sum()),
        delays={name: np.maximum(each.fit.delays, 0.0) for name, each in candidates.items()}, lags=lags,
    )  # fmt: skip


def validated(squares: dict[str, np.ndarray], wide: np.ndarray) -> Validation:
    """The rms of each candidate, of several outputs in their spreads (q,), and the rival that is clearly better."""
    moving = np.flatnonzero(wide > 0)
    single = int(moving[0]) if len(moving) == 1 else 0 if len(wide) == 1 else None
    unit = np.where(wide > 0, wide if single is None else 1.0, np.inf) if len(moving) else np.ones(len(wide))
    each = {name: (values / unit**2).sum(axis=1) / max(len(moving), 1) for name, values in squares.items()}  # (S,)
    errors = {name: float(np.sqrt(values.mean())) for name, values in each.items()}
    best = min(errors, key=errors.__getitem__)
    clear = errors["model"] > CLEARLY * errors[best] and (each["model"] > each[best]).mean() > MOSTLY
    return Validation(errors, best if clear else None, single=single)
