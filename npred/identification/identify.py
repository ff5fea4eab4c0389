"""`npred.identify`: from the arrays of a recording to the delays and parameters of a plant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from npred import array_checks, randomness
from npred.errors import ConfigError, similar
from npred.identification import alternatives, estimate, search
from npred.identification.alternatives import FittedModel
from npred.identification.estimate import Delays
from npred.identification.fit import Prior, Problem, SegmentFit
from npred.identification.identified import Alternative, Findings, Identified, Windows
from npred.identification.log import Log, Segments, spread
from npred.identification.model import MeasuredOutputs, RolloutModel
from npred.plants import Plant
from npred.symbolic import programs
from npred.symbolic.trace import Trace
from npred.terminal import waiting

MODEL_ERROR = 0.05
GAP = 20  # periods without a sample end a segment
RANGE = 5, 400  # by default delays up to a fifth of the log are tried, and up to so many periods
ROWS = 30, 8, 200  # a segment is a so-manieth part of the log, with so many samples at least and at most
GROWTH = 30.0  # of an error in a segment
HELD_BACK = 0.25
FINEST = 64  # steps of RK4 in a piece
SLIP = 0.02  # of the noise, that one step more may change
DECIDING = 8000  # samples, by which models are compared
WINDOW = 8, 20  # segments of a window, and windows, at most


@dataclass(frozen=True)
class Settings:
    """What is free, and what is known: see `identify`."""

    free: tuple[str, ...] = ()
    bounds: Mapping[str, tuple[float, float]] | None = None
    longest: float | None = None
    offset: bool = False
    time_varying: bool = False
    model_error: float = MODEL_ERROR
    seed: int = 0

    @property
    def wanted(self) -> tuple[str, ...]:
        """The parameters that are estimated: those that are free, or have a range."""
        return tuple(dict.fromkeys([*self.free, *(self.bounds or ())]))


def identify(
    plant: Plant, t: Any, U: Any, X: Any, *, free: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None, longest: float | None = None, offset: bool = False,
    time_varying: bool = False, model_error: float = MODEL_ERROR, seed: int = 0,
) -> Identified:  # fmt: skip
    """The delay of each input, and the parameters `free`, by a recording of the plant: what it tells, and what not.

    t (N,) are the times of the rows, U (N, m) the commands, each held until the next one, and X (N, n) the measured
    outputs: the states, or what the plant declares by output(x, t, p, M). NaN in U is no new command, NaN in X no
    sample; rows may be irregular, repeated and in any order, and inputs may come at other times than outputs.

    Delays from 0 to `longest` are tried, by default up to a fifth of the log. `bounds` has ranges of free parameters.
    Those that are not free are taken to be within about `model_error` of their value, relatively (0: they are exact),
    which widens the intervals; a black box's are taken to be exact. With `offset` a constant is added to each input and
    estimated. With `time_varying` the delays are estimated over windows of time as well (`windows`).

    The fit is by rollouts over short segments each with its initial state, by Gauss and Newton's method; delays by
    the profile of the cost, which has kinks; intervals by the profile and by drawing the segments anew.
    Raises ConfigError for arrays that do not fit together, an unknown parameter, a log that is too short, and a plant
    that declares its delay.
    """
    settings = Settings(tuple(free), bounds, longest, offset, time_varying, model_error, seed)
    log = Log.of(*_arrays(plant, t, U, X))
    with waiting.said("identifying: fits of many delays", 3e-5 * len(log.t) + 1.0):
        return of_log(plant, log, settings)


def of_log(plant: Plant, log: Log, settings: Settings) -> Identified:
    """What a log tells; see `identify`."""
    problem, high = prepared(plant, log, settings)
    low = np.zeros(plant.m)
    delays = estimate.estimate(problem, low, high, randomness.generator(settings.seed, "identify"))
    others = [_alternative(_thinned(delays), j, high[j]) for j in range(plant.m)]
    held_back, by_output = _held_back(delays, high)
    interval = delays.interval.copy()
    for j, (other, _) in enumerate(others):
        if other.as_good:
            interval[j, 0] = 0.0
        if other.behind:
            interval[j, 0] = min(interval[j, 0], other.behind[0])
    drawn = _parameters(delays, settings)
    named = [
        k for k, name in enumerate(_names(plant, problem)) if name in settings.wanted or k >= _count(plant, problem)
    ]
    findings = Findings(
        plant, delays.values, interval, low, high, log.period, [other for other, _ in others],
        np.ptp(log.U, axis=0) == 0, {_names(plant, problem)[k]: drawn[k] for k in named},
        _assumed(plant, delays, named), delays.inflation, _closed(log), held_back,
    )  # fmt: skip
    windows = _windows(delays, high, settings) if settings.time_varying else None
    details = {"estimate": delays, "others": others, "by_output": by_output, "log": log}
    parameters = findings.parameters
    return Identified(
        plant, delays.values, interval, findings.identifiable, {name: v[0] for name, v in parameters.items()},
        {name: (v[1], v[2]) for name, v in parameters.items()}, held_back, findings.sentences, windows, details,
    )  # fmt: skip


def prepared(plant: Plant, log: Log, settings: Settings) -> tuple[Problem, np.ndarray]:
    """The problem of a log, its steps fine enough, and the longest delays (m,)."""
    duration = log.t[-1] - log.begin
    longest = settings.longest or min(duration / RANGE[0], RANGE[1] * log.period)
    rows = log.between(log.begin + longest, np.inf)
    free, prior = _prior(plant, settings)
    model = RolloutModel(plant, free)
    if len(rows.t) < 4 * (plant.n + len(free) + 1):
        raise ConfigError(
            f"log: expected at least {4 * (plant.n + len(free) + 1)} samples later than the longest delay, "
            f"{plant.time_text(longest)}, after the first command, got {len(rows.t)}; record longer, or try shorter "
            "delays"
        )
    parts, least, most = ROWS
    count = int(np.clip(len(rows.t) / parts, max(least, 3 * plant.n), most))
    segments = Segments.of(rows, min(count, _bearable(plant, rows)), GAP * log.period)
    rough, wide = spread(np.diff(rows.Y, 2, axis=0)) / np.sqrt(6), spread(rows.Y)
    scale = np.where(rough > 0, rough, np.where(wide > 0, 1e-3 * wide, 1.0))
    problem = Problem(model, segments, scale, prior)
    return _fine_enough(problem, np.full(plant.m, longest / 2)), np.full(plant.m, longest)


def _arrays(plant: Plant, t: Any, U: Any, X: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    if plant.declares_delay:
        raise ConfigError(f"plant {plant.name}: expected a plant whose delay is unknown, it declares delay(x, t, p, M)")
    t, U, X = (array_checks.floats(name, value) for name, value in (("t", t), ("U", U), ("X", X)))
    U, X = (a[:, None] if a.ndim == 1 else a for a in (U, X))
    outputs = len(MeasuredOutputs(RolloutModel(plant, ())).names)
    if t.ndim != 1 or U.shape != (len(t), plant.m) or X.shape != (len(t), outputs):
        shapes = f"t (N,), U (N, {plant.m}), X (N, {outputs})"
        raise ConfigError(f"identify: expected {shapes}, got {t.shape}, {U.shape}, {X.shape}; give a row per time")
    return t, U, X


def _prior(plant: Plant, settings: Settings) -> tuple[tuple[int, ...], Prior]:
    """The places of what is estimated in (p, offsets), and what is known of it."""
    names, bounds = list(plant.parameters), settings.bounds or {}
    for name in settings.wanted:
        if name not in names:
            raise ConfigError(
                f"free: expected parameters of plant {plant.name}: {', '.join(names) or 'none'}, got {name!r}"
                f"{similar(name, names)}"
            )
    free = [k for k, name in enumerate(names) if name in settings.wanted]
    assumed = [k for k in _used(plant) if k not in free and plant.p[k] != 0 and settings.model_error > 0]
    offsets = [len(names) + j for j in range(plant.m)] if settings.offset else []
    places = [*free, *assumed, *offsets]
    mean = np.append(plant.p, np.zeros(plant.m))[places]
    deviation = np.where(np.isin(places, assumed), settings.model_error * np.abs(mean), np.inf)
    limits = [bounds.get(names[k], (-np.inf, np.inf)) if k < len(names) else (-np.inf, np.inf) for k in places]
    return tuple(places), Prior(mean, deviation, np.array(limits).reshape(-1, 2).T)


def _used(plant: Plant) -> list[int]:
    """The places of the parameters that f or the outputs depend on; none of a black box."""
    if not plant.traced:
        return []
    trace = Trace(plant)
    x, u, t = trace.symbols()
    outputs = [*trace.f(x, u, t), *(trace.output(x, t) if plant.declares_output else ())]
    return [k for k, symbol in enumerate(trace.parameters) if programs.depends(outputs, [symbol])]


def _bearable(plant: Plant, rows: Log) -> int:
    """The samples in which an error grows by at most GROWTH, by the eigenvalues of f_X along the log."""
    X = MeasuredOutputs(RolloutModel(plant, ())).states(rows.Y[:: max(1, len(rows.t) // 50)])
    with np.errstate(all="ignore"):
        matrices = plant.jacobians(X, np.broadcast_to(np.median(rows.U, axis=0), (len(X), plant.m)))[0]
    finite = np.isfinite(matrices).all(axis=(1, 2))
    rates = np.linalg.eigvals(matrices[finite]).real.max(axis=1) if finite.any() else np.zeros(1)
    fastest = float(np.quantile(rates, 0.9))
    return int(min(1e9, np.log(GROWTH) / (fastest * rows.period))) if fastest > 0 else 10**9


def _fine_enough(problem: Problem, delays: np.ndarray) -> Problem:
    """The problem with as many steps in a piece as the noise lets one see."""
    few = problem.some(500)
    X, theta = few.start()
    pieces = few.segments.pieces(delays)
    last, steps = None, 1
    while steps <= FINEST:
        model = replace(problem.model, steps=steps)
        with np.errstate(all="ignore"):
            x = model.states(X, theta, pieces)
            if last is not None and np.nanmean(np.abs(x - last) < SLIP * _noise(problem, x)) > 0.99:
                return replace(problem, model=replace(model, steps=steps // 2))
        last, steps = x, 2 * steps
    return replace(problem, model=replace(problem.model, steps=FINEST))


def _noise(problem: Problem, x: np.ndarray) -> np.ndarray | float:
    """The noise of each state, where states are measured; else that of a thousandth of its spread."""
    direct = problem.scale.shape == (x.shape[-1],)
    return problem.scale if direct else 0.05 * np.nanstd(x, axis=(0, 1)) + 1e-12


def _thinned(delays: Delays) -> Delays:
    """The same on as many samples as decide between models."""
    thinner = delays.problem.some(DECIDING)
    return delays if len(thinner.segments) == len(delays.problem.segments) else replace(
        delays, problem=thinner, fit=thinner.fit(delays.values)
    )  # fmt: skip


def _alternative(delays: Delays, j: int, high: float) -> tuple[Alternative, FittedModel]:
    """A lag in place of the delay of input j, and one behind it, beside the delay alone."""
    instead = alternatives.lag_instead(delays.problem, delays.values, [j], high)
    as_good = not alternatives.better(delays.fit, instead.fit, delays.inflation)
    behind = None
    if not as_good and delays.values[j] > 0:
        both = alternatives.lag_behind(delays.problem, delays.fit, j, delays.widths[j])
        if alternatives.better(both.fit, delays.fit, delays.inflation) and both.lags is not None:
            behind = float(both.fit.delays[j]), float(both.lags[j])
    assert instead.lags is not None
    return Alternative(float(instead.lags[j]), as_good, behind), instead


def _held_back(delays: Delays, high: np.ndarray) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """The errors on the last part of the log of models fitted to the rest; none for a log that is too short."""
    segments, problem = delays.problem.segments, delays.problem
    span = segments.log.t[-1] - segments.log.t[0]
    early = segments.t[:, -1] <= segments.log.t[0] + (1 - HELD_BACK) * span
    if early.sum() < 3 or (~early).sum() < 1 or segments.t.shape[1] < 4:
        return {}, {}
    train, later = (replace(problem, segments=segments.some(part)).some(DECIDING) for part in (early, ~early))

    def at(z: np.ndarray, fit: SegmentFit | None) -> SegmentFit:
        return train.fit(z, fit, 2)

    z, fit, _ = search.descend(
        at, at(delays.values, None), delays.values, np.zeros(len(high)), high, float(delays.widths.max()),
        0.2 * float(delays.widths.min()),
    )  # fmt: skip
    inputs = list(range(len(z)))
    candidates = {
        "model": FittedModel(train, fit),
        "no_delay": FittedModel(train, train.fit(np.zeros(len(z)), None, 4)),
        "first_order_lag": alternatives.lag_instead(train, z, inputs, float(high.max())),
    }
    errors = {name: alternatives.prediction_error(candidate, later.segments) for name, candidate in candidates.items()}
    wide = spread(segments.log.Y)
    unit = np.where(wide > 0, wide, np.inf) if len(wide) > 1 else np.ones(1)
    measured = max(int((wide > 0).sum()), 1)
    return {name: float(np.sqrt(((e / unit) ** 2).sum() / measured)) for name, e in errors.items()}, errors


def _parameters(delays: Delays, settings: Settings) -> list[tuple[float, float, float, float]]:
    """Of each theta its value, its interval, and the correlation of its error with that of the nearest delay."""
    rng = randomness.generator(settings.seed, "parameters")
    ones = np.ones((1, len(delays.fit.e)))
    value = delays.fit.thetas(ones)[0]
    if not len(value):
        return []
    covariance = np.linalg.pinv(delays.fit.H.sum(axis=0) + np.diag(delays.problem.prior.weight)) * delays.inflation
    draws, deviations = [value + 0 * value], []
    slopes = []
    for j, profile in enumerate(delays.profiles):
        drawn, thetas = estimate.drawn(profile, rng)
        draws += list(thetas)
        width = (delays.interval[j, 1] - delays.interval[j, 0]) / 3.92
        near = profile.costs - profile.costs.min() < 4 * delays.level
        if near.sum() > 2:
            line = np.polyfit(profile.values[near], [fit.thetas(ones)[0] for fit in np.array(profile.fits)[near]], 1)[0]
            slopes.append(line * width)
        deviations.append(drawn)
    by_delay = np.square(slopes).sum(axis=0) if slopes else np.zeros(len(value))
    size = np.sqrt(np.diag(covariance) + by_delay)
    low, high = np.quantile(draws, estimate.SHARES, axis=0)
    low, high = np.minimum(low, value - 1.96 * size), np.maximum(high, value + 1.96 * size)
    correlation = (slopes[int(np.argmax(np.abs(slopes).sum(axis=1)))] if slopes else 0 * value) / np.maximum(
        size, 1e-300
    )
    low, high = np.clip(low, *delays.problem.prior.limits), np.clip(high, *delays.problem.prior.limits)
    return [tuple(map(float, row)) for row in zip(value, low, high, correlation, strict=True)]  # type: ignore[misc]


def _names(plant: Plant, problem: Problem) -> list[str]:
    """The names of theta."""
    every = [*plant.parameters, *(f"offset of {name}" for name in plant.inputs)]
    return [every[k] for k in problem.model.free]


def _count(plant: Plant, problem: Problem) -> int:
    """How many of theta are parameters of the plant."""
    return sum(k < len(plant.p) for k in problem.model.free)


def _assumed(plant: Plant, delays: Delays, named: list[int]) -> dict[str, float]:
    """How far the parameters that were not freed are from the plant's, in what was allowed."""
    prior, theta = delays.problem.prior, delays.fit.thetas(np.ones((1, len(delays.fit.e))))[0]
    names = _names(plant, delays.problem)
    return {
        names[k]: float((theta[k] - prior.mean[k]) / prior.deviation[k]) for k in range(len(theta)) if k not in named
    }


def _closed(log: Log) -> float:
    """R² of the commands by the outputs at their time: near 1 where a law without a test signal gave them."""
    outputs = np.stack([np.interp(log.t_U, log.t[s], y[s]) for y in log.Y.T if (s := np.isfinite(y)).sum() > 1], axis=1)
    A, U = np.column_stack([np.ones(len(outputs)), outputs]), log.U - log.U.mean(axis=0)
    if len(A) <= A.shape[1] + 2 or not U.any():
        return 0.0
    left = U - A @ np.linalg.lstsq(A, U, rcond=None)[0]
    return float(1 - (left**2).sum() / (U**2).sum())


def _windows(delays: Delays, high: np.ndarray, settings: Settings) -> Windows:
    """The delays over windows of the log, each by itself."""
    segments, (least, most) = delays.problem.segments, WINDOW
    count = int(np.clip(len(segments) // least, 1, most))
    values = []
    for k, chosen in enumerate(np.array_split(np.arange(len(segments)), count)):
        part = segments.some(chosen)
        rng = randomness.generator(settings.seed, "window", k)
        one = estimate.estimate(replace(delays.problem, segments=part), 0 * high, high, rng)
        values.append(((part.t[0, 0] + part.t[-1, -1]) / 2, one.values, one.interval))
    return Windows(*(np.array(column) for column in zip(*values, strict=True)))
