"""The problem of a log: what is free, what is known of it, segments that are short enough, and fine enough steps."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from npred import array_checks
from npred.errors import ConfigError, unlisted
from npred.identification.fit import Prior, Problem
from npred.identification.log import Log, Segments, spread
from npred.identification.model import MeasuredOutputs, RolloutModel
from npred.plants import Plant
from npred.symbolic import programs
from npred.symbolic.trace import Trace

MODEL_ERROR = 0.05
GAP = 20  # periods without a sample end a segment
RANGE = 5, 400  # by default delays up to a fifth of the log are tried, and up to so many periods
PARTS, ROWS = 30, (8, 200)  # a segment is this part of the log, with so many samples at least and at most
GROWTH = 30.0  # of an error in a segment
FINEST = 64  # steps of RK4 in a piece
SLIP = 0.02  # of the noise, that twice as many steps may change


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


def prepared(plant: Plant, log: Log, settings: Settings) -> tuple[Problem, np.ndarray]:
    """The problem of a log, its steps fine enough, and the longest delays (m,)."""
    if plant.declares_delay:
        raise ConfigError(f"plant {plant.name}: expected a plant whose delay is unknown, it declares delay(x, t, p, M)")
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
    least, most = ROWS
    count = int(np.clip(len(rows.t) / PARTS, max(least, 3 * plant.n), most))
    segments = Segments.of(rows, min(count, _bearable(plant, rows)), GAP * log.period)
    rough, wide = spread(np.diff(rows.Y, 2, axis=0)) / np.sqrt(6), spread(rows.Y)
    scale = np.where(rough > 0, rough, np.where(wide > 0, 1e-3 * wide, 1.0))
    problem = Problem(model, segments, scale, prior)
    return _fine_enough(problem, np.full(plant.m, longest / 2)), np.full(plant.m, longest)


def arrays(plant: Plant, t: Any, U: Any, X: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The rows as arrays t (N,), U (N, m) and X (N, outputs). Raises ConfigError as `identify` does."""
    t, U, X = (array_checks.floats(name, value) for name, value in (("t", t), ("U", U), ("X", X)))
    U, X = (a[:, None] if a.ndim == 1 else a for a in (U, X))
    outputs = len(plant.outputs)
    if t.ndim != 1 or U.shape != (len(t), plant.m) or X.shape != (len(t), outputs):
        shapes = f"t (N,), U (N, {plant.m}), X (N, {outputs})"
        raise ConfigError(f"identify: expected {shapes}, got {t.shape}, {U.shape}, {X.shape}; give a row per time")
    return t, U, X


def _prior(plant: Plant, settings: Settings) -> tuple[tuple[int, ...], Prior]:
    """The places of what is estimated in (p, offsets), and what is known of it."""
    names, bounds = list(plant.parameters), settings.bounds or {}
    for name in settings.wanted:
        if name not in names:
            raise ConfigError(unlisted("free", name, names, f"parameters of plant {plant.name}:"))
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
