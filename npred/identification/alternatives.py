"""Other explanations of a log: a first-order lag in place of a delay, a lag behind it, or no delay at all.

Two models that do not contain each other are compared segment by segment [Vuong, Econometrica 57 (1989) 307]: the
difference of their costs has to be large, and larger than its scatter over the segments.
"""

from dataclasses import dataclass, replace
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from npred.identification import search
from npred.identification.estimate import Delays
from npred.identification.fit import Prior, Problem, SegmentFit, better
from npred.identification.log import Segments, spread

NONE = 1e-9  # in sampling periods: a shorter lag is none
HELD_BACK = 0.25
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

    @property
    def explains(self) -> bool:
        """True if a lag that counts may stand in place of the delay."""
        return self.as_good and not self.short


class Validation(NamedTuple):
    """The rms errors of the model and its rivals on the held-back part, and the rival that is clearly better."""

    errors: dict[str, float]
    better: str | None


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
    as_good, behind = not better(delays.fit, instead.fit, delays.inflation), None
    if as_good or not delays.values[j] > 0:
        return Alternative(float(instead.lags[j]), as_good, bool(instead.lags[j] < period), 0.0, behind)
    fit, lagged = delays.fit, delays.problem.with_lag()
    best, best_tau, least = None, 0.0, float(delays.values[j])
    for share in SHARES:
        tau = np.full(len(fit.delays), NONE * period)
        tau[j] = share * max(fit.delays[j], period)

        def at(z: np.ndarray, start: SegmentFit | None, tau: np.ndarray = tau) -> SegmentFit:
            moved = fit.delays.copy()
            moved[j] = z[0]
            return lagged.fit(moved, start, 2, tau)

        z, longest = np.array([max(fit.delays[j] - tau[j], 0.0)]), np.array([fit.delays[j]])
        step = max(2 * delays.widths[j], 0.1 * tau[j])
        _, new, _ = search.descend(at, at(z, fit), z, np.zeros(1), longest, step, 0.02 * tau[j])
        if best is None or new.cost < best.cost:
            best, best_tau = new, float(tau[j])
        if not better(fit, new, delays.inflation):
            least = min(least, float(new.delays[j]))
    if best is not None and better(best, fit, delays.inflation):
        behind = float(best.delays[j]), best_tau
    return Alternative(float(instead.lags[j]), as_good, False, least, behind)


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
    none = min((train.fit(0 * z, start, 6) for start in (None, fit)), key=actual)
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
    return validated(squares, spread(segments.log.Y))


def validated(squares: dict[str, np.ndarray], wide: np.ndarray) -> Validation:
    """The rms of each candidate, of several outputs in their spreads (q,), and the rival that is clearly better."""
    unit = np.where(wide > 0, wide, np.inf) if len(wide) > 1 else np.ones(1)
    measured = max(int((wide > 0).sum()), 1)
    each = {name: (values / unit**2).sum(axis=1) / measured for name, values in squares.items()}  # (S,)
    errors = {name: float(np.sqrt(values.mean())) for name, values in each.items()}
    best = min(errors, key=errors.__getitem__)
    clear = errors["model"] > CLEARLY * errors[best] and (each["model"] > each[best]).mean() > MOSTLY
    return Validation(errors, best if clear else None)
