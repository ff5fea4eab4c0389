"""Other explanations of a log: a first-order lag in place of a delay, a lag behind it, or no delay at all.

Two models that do not contain each other are compared segment by segment [Vuong, Econometrica 57 (1989) 307]: the
difference of their costs has to be large, and larger than its scatter over the segments.
"""

from dataclasses import dataclass, replace

import numpy as np

from npred.identification import search
from npred.identification.estimate import Delays
from npred.identification.fit import Prior, Problem, SegmentFit, better
from npred.identification.log import Segments, mean_square, spread

NONE = 1e-9  # in sampling periods: a shorter lag is none
HELD_BACK = 0.25
DECIDING = 8000  # samples, by which models are compared
SHARES = 0.15, 0.3, 0.5, 0.75, 1.0  # lags to try, as shares of the delay


@dataclass(frozen=True)
class Alternative:
    """The best lag of input j in place of its delay, or behind it."""

    lag: float  # s, of a first-order lag in place of the delay
    as_good: bool  # the log does not prefer the delay
    behind: tuple[float, float] | None  # a delay and a lag that are clearly better than the delay alone


@dataclass(frozen=True)
class FittedModel:
    """A model with delays and lags (m,), fitted; `lags` is None where it has none."""

    problem: Problem
    fit: SegmentFit
    lags: np.ndarray | None = None


def lag_instead(problem: Problem, delays: np.ndarray, inputs: list[int], longest: float) -> FittedModel:
    """The best fit with first-order lags in place of the delays of these inputs."""
    lagged, period = problem.with_lag(), problem.segments.log.period
    D, tau = delays.copy(), np.full(len(delays), NONE * period)
    D[inputs] = 0.0

    def at(z: np.ndarray, start: SegmentFit | None) -> SegmentFit:
        tau[inputs] = np.exp(z)
        return lagged.fit(D, start, 2, tau)

    low, high = (np.full(len(inputs), np.log(end)) for end in (0.2 * period, max(longest, period)))
    z, _ = search.scan(at, low, high, 0.3)[0]
    z, fit, _ = search.descend(at, at(z, None), z, low, high, 0.15, 0.01)
    at(z, fit)
    return FittedModel(lagged, fit, tau.copy())


def prediction_error(candidate: FittedModel, segments: Segments) -> np.ndarray:
    """The rms of each output (outputs,) over the last two thirds of segments that the model was not fitted to.

    Their first thirds give the initial states.
    """
    fit, third = candidate.fit, max(2, segments.t.shape[1] // 3)
    head = segments.Y.copy()
    head[:, third:] = np.nan
    theta = fit.thetas(np.ones((1, len(fit.e))))[0]
    fixed = Prior(theta, np.ones(len(theta)), np.stack([theta, theta]))
    problem = replace(candidate.problem, segments=replace(segments, Y=head), prior=fixed)
    start = problem.fit(fit.delays, None, 4, candidate.lags)
    r = (segments.Y - problem.outputs(start, candidate.lags))[:, third:]
    return np.sqrt(mean_square(r))


def thinned(delays: Delays) -> Delays:
    """The same on as many samples as decide between models."""
    thinner = delays.problem.some(DECIDING)
    if len(thinner.segments) == len(delays.problem.segments):
        return delays
    return replace(delays, problem=thinner, fit=thinner.fit(delays.values))


def of_input(delays: Delays, j: int, high: float) -> Alternative:
    """A lag in place of the delay of input j, and one behind it, against the delay alone."""
    instead = lag_instead(delays.problem, delays.values, [j], high)
    assert instead.lags is not None
    as_good, behind = not better(delays.fit, instead.fit, delays.inflation), None
    if as_good or not delays.values[j] > 0:
        return Alternative(float(instead.lags[j]), as_good, behind)
    fit, lagged, period = delays.fit, delays.problem.with_lag(), delays.problem.segments.log.period
    best, best_tau = None, 0.0
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
    if best is not None and better(best, fit, delays.inflation):
        behind = float(best.delays[j]), best_tau
    return Alternative(float(instead.lags[j]), as_good, behind)


def held_back(delays: Delays, high: np.ndarray) -> dict[str, float]:
    """The errors on the last part of the log of models fitted to the rest; none for a log that is too short."""
    segments, problem = delays.problem.segments, delays.problem
    span = segments.log.t[-1] - segments.log.t[0]
    early = segments.t[:, -1] <= segments.log.t[0] + (1 - HELD_BACK) * span
    if early.sum() < 3 or (~early).sum() < 1 or segments.t.shape[1] < 4:
        return {}
    train, later = (replace(problem, segments=segments.some(part)).some(DECIDING) for part in (early, ~early))

    def at(z: np.ndarray, fit: SegmentFit | None) -> SegmentFit:
        return train.fit(z, fit, 2)

    step, least = float(delays.widths.max()), 0.2 * float(delays.widths.min())
    first = at(delays.values, None)
    z, fit, _ = search.descend(at, first, delays.values, np.zeros(len(high)), high, step, least)
    inputs = list(range(len(z)))
    candidates = {
        "model": FittedModel(train, fit),
        "no_delay": FittedModel(train, train.fit(np.zeros(len(z)), None, 4)),
        "first_order_lag": lag_instead(train, z, inputs, float(high.max())),
    }
    errors = {name: prediction_error(candidate, later.segments) for name, candidate in candidates.items()}
    wide = spread(segments.log.Y)
    unit = np.where(wide > 0, wide, np.inf) if len(wide) > 1 else np.ones(1)
    measured = max(int((wide > 0).sum()), 1)
    return {name: float(np.sqrt(((e / unit) ** 2).sum() / measured)) for name, e in errors.items()}
