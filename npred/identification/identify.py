"""`npred.identify`: from a recording, a file or arrays, to the delays and parameters of a plant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np

from npred.base import array_checks, progress, randomness
from npred.base.errors import ConfigError, unlisted
from npred.formulas import programs
from npred.formulas.trace import Trace
from npred.identification import alternatives, recordings
from npred.identification.estimate import estimate, parameters
from npred.identification.fit import Prior, Problem
from npred.identification.identified import Findings, Identified, Windows
from npred.identification.log import Log, Segments, spread
from npred.identification.model import RolloutModel
from npred.plants import Plant
from npred.plants.base import require

FAR = 3.0  # widths of the box beyond it
WINDOW = 8, 20  # segments of a window, and windows, at most
MODEL_ERROR = 0.05
GAP = 20  # periods without a sample end a segment
RANGE = 5, 400  # by default delays up to a fifth of the log are tried, and up to so many periods
PARTS, ROWS = 30, (8, 200)  # a segment is this part of the log, with so many samples at least and at most
GROWTH = 30.0  # the largest growth of an error in a segment
FINEST = 64  # steps of RK4 in a piece
SLIP = 0.02  # share of the noise that twice as many steps may change


@dataclass(frozen=True)
class Settings:
    """The free and the known parts: see `identify`."""

    free: Sequence[str] = ()
    bounds: Mapping[str, tuple[float, float]] | None = None
    longest: float | None = None
    offset: bool = False
    time_varying: bool = False
    model_error: float = MODEL_ERROR
    seed: int = 0


class Reading(TypedDict, total=False):
    """How a recording is read: see `identify`."""

    columns: Mapping[str, str]
    scale: Mapping[str, float]
    shift: Mapping[str, float]
    time: str | None
    time_unit: str | None


def identify(
    plant: Plant, t: Any, U: Any = None, X: Any = None, *, free: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None, longest: float | None = None, offset: bool = False,
    time_varying: bool = False, model_error: float = MODEL_ERROR, seed: int = 0, **reading: Unpack[Reading],
) -> Identified:  # fmt: skip
    """The delay of each input, and the parameters `free`, by a recording of the plant: what it tells, and what not.

    The fit is by rollouts over short segments each with its initial state, by Gauss and Newton's method; delays by
    the profile of the cost, which has kinks; intervals by the profile and by drawing the segments anew.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    t : array (N,), in the plant's unit of time, or str or Path
        Times of the rows, which may be irregular, repeated and in any order; or, in place of t, U and X, a
        recording: a table "log.csv", or a format of an extra.
    U : array (N, m), in the plant's units, optional
        Commands, each held until the next one; NaN is no new command.
    X : array (N, n), optional
        Measured states, or what the plant declares by output(x, t, p, M); NaN is no sample.
    free : list of str, optional
        Parameters of the plant that are estimated.
    bounds : dict of (low, high), optional
        Ranges of free parameters.
    longest : float, in the plant's unit of time, optional
        Longest delay that is tried; by default up to a fifth of the recording.
    offset : bool, default False
        Whether a constant is added to each input and estimated.
    time_varying : bool, default False
        Whether delays are estimated over windows of time as well.
    model_error : float, default 0.05
        How far, relatively, parameters that are not free may be from their value; that widens the intervals. 0 says
        that they are exact, as those of a black box are taken to be.
    seed : int, default 0
        Seed of the random numbers.
    **reading : optional
        Of the file of a recording: `columns`, the names of its columns where they are not those of inputs and outputs,
        {"q": "Q1"}; `scale`, factors that bring columns to the plant's units; `shift`, numbers that are then added;
        `time`, the column of the times; `time_unit`, their unit.

    Returns
    -------
    Identified
        Delays D (m,) with intervals of 95 % (m, 2); the parameters that were freed; errors on what was held back.

    Raises
    ------
    ConfigError
        For arrays that do not fit together, a file or a column that is not there, an unknown parameter, a log that
        is too short, and a plant that declares its delay.
    """
    if isinstance(t, Plant):
        plant, t = t, plant
    require(plant)
    settings = Settings(tuple(free), bounds, longest, offset, time_varying, model_error, seed)
    is_file = isinstance(t, str | Path)
    if any((a is None) != is_file for a in (U, X)):
        got = "both" if is_file else f"no {'U' if U is None else 'X'}"
        raise ConfigError(f"identify: expected the path of a recording, or t, U and X, got {got}; give one of both")
    if is_file:
        log = recorded(plant, Path(t), **reading)
    elif reading:
        raise ConfigError(f"identify: expected {', '.join(reading)} with the path of a recording, got arrays; drop it")
    else:
        t, U, X = (array_checks.floats(name, value) for name, value in (("t", t), ("U", U), ("X", X)))
        U, X = (a[:, None] if a.ndim == 1 else a for a in (U, X))
        outputs = len(plant.outputs)
        if t.ndim != 1 or U.shape != (len(t), plant.m) or X.shape != (len(t), outputs):
            shapes = f"t (N,), U (N, {plant.m}), X (N, {outputs})"
            raise ConfigError(f"identify: expected {shapes}, got {t.shape}, {U.shape}, {X.shape}; give a row per time")
        log = Log.of(t, U, X)
    with progress.announce("identifying: fits of many delays", 3e-5 * len(log.t) + 1.0):
        return of_log(plant, log, settings)


def of_log(plant: Plant, log: Log, settings: Settings) -> Identified:
    """The answer of a log; see `identify`."""
    problem, high = prepared(plant, log, settings)
    delays = estimate(problem, 0 * high, high, randomness.generator(settings.seed, "identify"))
    fewer = alternatives.thinned(delays)
    others = [alternatives.of_input(fewer, j, high[j]) for j in range(plant.m)]
    interval = delays.interval.copy()
    for ends, other in zip(interval, others, strict=True):
        ends[0] = 0.0 if other.as_good else min(ends[0], other.behind[0] if other.behind else np.inf)
    asked, assumed = parameters(plant, delays, settings.seed)
    findings = Findings(
        plant, delays.values, interval, high, log.period, others, np.ptp(log.U, axis=0) == 0, asked, assumed,
        delays.inflation, _closed(log), alternatives.held_back(delays, high),
    )  # fmt: skip
    far = []  # measured states far from the plant's box: their unit is another, perhaps
    for name, y in () if plant.declares_output else zip(plant.states, log.Y.T, strict=True):
        if name not in plant.box or not np.isfinite(y).any():
            continue
        (low, end), middle = plant.box[name], np.nanmedian(y)
        if max(low - middle, middle - end) > FAR * (end - low):
            log_and_box = f"{name} is about {middle:.3g} in the recording, and {low:g} to {end:g} in the plant's box"
            far.append(f"{log_and_box}: if the units differ, scale its column.")
    windows = None
    if settings.time_varying:  # each by itself
        segments, (least, most), rows = problem.segments, WINDOW, []
        count = int(np.clip(len(segments) // least, 1, most))
        for k, chosen in enumerate(np.array_split(np.arange(len(segments)), count)):
            part, rng = segments.some(chosen), randomness.generator(settings.seed, "window", k)
            one = estimate(replace(delays.problem, segments=part), 0 * high, high, rng)
            rows.append(((part.t[0, 0] + part.t[-1, -1]) / 2, one.values, one.interval))
        windows = Windows(*(np.array(column) for column in zip(*rows, strict=True)))
    return Identified(
        plant, delays.values, interval, findings.identifiable, {name: row.value for name, row in asked.items()},
        {name: (row.low, row.high) for name, row in asked.items()}, findings.held_back, [*far, *findings.sentences],
        windows, {"estimate": delays, "log": log},
    )  # fmt: skip


def _closed(log: Log) -> float:
    """R² of the commands by the outputs at their time: near 1 where a law without a test signal gave them."""
    outputs = np.stack([np.interp(log.t_U, log.t[s], y[s]) for y in log.Y.T if (s := np.isfinite(y)).sum() > 1], axis=1)
    A, U = np.column_stack([np.ones(len(outputs)), outputs]), log.U - log.U.mean(axis=0)
    if len(A) <= A.shape[1] + 2 or not U.any():
        return 0.0
    left = U - A @ np.linalg.lstsq(A, U, rcond=None)[0]
    return float(1 - (left**2).sum() / (U**2).sum())


def recorded(
    plant: Plant, path: Path, columns: Mapping[str, str] = {}, scale: Mapping[str, float] = {},
    shift: Mapping[str, float] = {}, time: str | None = None, time_unit: str | None = None,
) -> Log:  # fmt: skip
    """The log in a file; a column c is scale[c] c + shift[c] in the plant's unit.

    An output that the recording does not have, and that `columns` does not name, is not measured. Raises ConfigError
    where an input has no column, or no output has one.
    """
    every = {name: columns.get(name, name) for name in (*plant.inputs, *plant.outputs)}
    for name in columns:
        if name not in every:
            raise ConfigError(unlisted("columns", name, every, f"inputs or outputs of plant {plant.name},"))
    names = recordings.columns(path)
    unmeasured = [name for name in plant.outputs if every[name] not in names and name not in columns]
    if len(unmeasured) == len(plant.outputs):
        cure = f"map one by columns or --state, as {plant.outputs[0]}={names[-1] if names else 'y'}"
        one = f"a column for one of {', '.join(plant.outputs)}"
        raise ConfigError(f"{path}: expected {one}, found {', '.join(names)}; {cure}")
    chosen = {name: column for name, column in every.items() if name not in unmeasured}
    for key in (*scale, *shift):
        if key not in chosen.values():
            raise ConfigError(unlisted("scale, shift", key, chosen.values(), "columns that are read,"))
    series = recordings.read(path, list(chosen.values()), time, time_unit)
    in_units = {}
    for name, c in chosen.items():
        in_units[name] = series[c].t, scale.get(c, 1.0) * series[c].values + shift.get(c, 0.0)
    return Log.of_series([in_units[name] for name in plant.inputs], [in_units.get(name) for name in plant.outputs])


def prepared(plant: Plant, log: Log, settings: Settings) -> tuple[Problem, np.ndarray]:
    """The problem of a log, its steps fine enough, and the longest delays (m,)."""
    if plant.declares_delay:
        raise ConfigError(f"plant {plant.name}: expected a plant whose delay is unknown, it declares delay(x, t, p, M)")
    duration = log.t[-1] - log.begin
    longest = settings.longest or min(duration / RANGE[0], RANGE[1] * log.period)
    rows = log.between(log.begin + longest, np.inf)
    names, bounds, free_range = list(plant.parameters), settings.bounds or {}, (-np.inf, np.inf)
    for name in (*settings.free, *bounds):
        if name not in names:
            raise ConfigError(unlisted("free", name, names, f"parameters of plant {plant.name}:"))
    chosen = [k for k, name in enumerate(names) if name in settings.free or name in bounds]
    used: list[int] = []  # by f or the outputs; nobody knows of a plant that is called
    if plant.traced:
        trace = Trace(plant)
        x, u, t = trace.symbols()
        formulas = [*trace.f(x, u, t), *(trace.output(x, t) if plant.declares_output else ())]
        used = [k for k, symbol in enumerate(trace.parameters) if programs.depends(formulas, [symbol])]
    assumed = [k for k in used if k not in chosen and plant.p[k] != 0 and settings.model_error > 0]
    free = [*chosen, *assumed, *(len(names) + j for j in range(plant.m * settings.offset))]  # places in (p, offsets)
    mean = np.append(plant.p, np.zeros(plant.m))[free]
    deviation = np.where(np.isin(free, assumed), settings.model_error * np.abs(mean), np.inf)
    limits = [bounds.get(names[k], free_range) if k < len(names) else free_range for k in free]
    prior, model = Prior(mean, deviation, np.array(limits).reshape(-1, 2).T), RolloutModel(plant, tuple(free))
    if len(rows.t) < (enough := 4 * (plant.n + len(free) + 1)):
        later = f"samples later than the longest delay, {plant.time_text(longest)}, after the first command"
        got = f"got {len(rows.t)}; record longer, or try shorter delays"
        raise ConfigError(f"log: expected at least {enough} {later}, {got}")
    least, most = ROWS
    count = int(np.clip(len(rows.t) / PARTS, max(least, 3 * plant.n), most))
    # An error grows by at most GROWTH in a segment, by the eigenvalues of f_X along the log.
    X = model.measured_states(rows.Y[:: max(1, len(rows.t) // 50)])
    with np.errstate(all="ignore"):
        matrices = plant.jacobians(X, np.broadcast_to(np.median(rows.U, axis=0), (len(X), plant.m)))[0]
    finite = np.isfinite(matrices).all(axis=(1, 2))
    rates = np.linalg.eigvals(matrices[finite]).real.max(axis=1) if finite.any() else np.zeros(1)
    if (fastest := float(np.quantile(rates, 0.9))) > 0:
        count = min(count, int(min(1e9, np.log(GROWTH) / (fastest * rows.period))))
    segments = Segments.of(rows, count, GAP * log.period)
    rough, wide = spread(np.diff(rows.Y, 2, axis=0)) / np.sqrt(6), spread(rows.Y)
    scale = np.where(rough > 0, rough, np.where(wide > 0, 1e-3 * wide, 1.0))
    problem = Problem(model, segments, scale, prior)
    return _fine_enough(problem, np.full(plant.m, longest / 2)), np.full(plant.m, longest)


def _fine_enough(problem: Problem, delays: np.ndarray) -> Problem:
    """The problem with as many steps in a piece as the noise lets one see; where outputs are measured instead of
    states, the noise of a state is taken for a twentieth of its spread.
    """
    few = problem.some(500)
    X, theta = few.start()
    pieces = few.segments.pieces(delays)
    last, steps = None, 1
    while steps <= FINEST:
        model = replace(problem.model, steps=steps)
        with np.errstate(all="ignore"):
            x = model.states(X, theta, pieces)
            noise = problem.scale if problem.scale.shape == (x.shape[-1],) else 0.05 * np.nanstd(x, axis=(0, 1)) + 1e-12
            if last is not None and np.nanmean(np.abs(x - last) < SLIP * noise) > 0.99:
                return replace(problem, model=replace(model, steps=steps // 2))
        last, steps = x, 2 * steps
    return replace(problem, model=replace(problem.model, steps=FINEST))
