"""`npred.identify`: from a recording, a file or arrays, to the delays and parameters of a plant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

import numpy as np

from npred import plants
from npred.base import array_checks, progress, randomness
from npred.base.errors import ConfigError, unlisted
from npred.formulas import programs
from npred.formulas.trace import Trace
from npred.identification import alternatives, excitation, recordings, screening, windows
from npred.identification.estimate import Delays, correlated_share, estimate, parameters
from npred.identification.excitation import BetweenRows
from npred.identification.fit import CHECKED, Prior, Problem
from npred.identification.identified import Findings, Identified
from npred.identification.log import Log, Segments, mean_square, spread
from npred.identification.model import RolloutModel
from npred.identification.objections import settled
from npred.identification.recordings import TimeSeries
from npred.plants import Plant
from npred.plants.base import require

SETTLING, LARGER = 10, 2.0  # periods of a begin, and mean squares of its errors, times those of the whole log
DEGREES = ("deg", "°")  # how a unit of angles begins
FAR = 3.0  # widths of the box beyond it
EARLY_SHARE = 0.5  # of the range of a command, within the longest delay: the answer may be there
MODEL_ERROR = 0.05
EARLY = 3  # periods before its command that an input is tried
RANGE = 5, 400  # by default delays up to a fifth of the log are tried, and up to so many periods
PARTS, ROWS = 30, (8, 200)  # a segment is this part of the log, with so many samples at least and at most
GROWTH = 30.0  # the largest growth of an error in a segment


@dataclass(frozen=True)
class Settings:
    """The free and the known parts: see `identify`."""

    free: Sequence[str] = ()
    bounds: Mapping[str, tuple[float, float]] | None = None
    longest: float | None = None
    offset: bool = False
    time_varying: bool = False
    model_error: float = MODEL_ERROR
    hold: str | None = None
    seed: int = 0


class Reading(TypedDict, total=False):
    """How a recording is read: see `identify`."""

    columns: Mapping[str, str]
    scale: Mapping[str, float]
    shift: Mapping[str, float]
    time: str | None
    time_unit: str | None
    period: float | None


def identify(
    plant: Plant, t: Any, U: Any = None, X: Any = None, *, free: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None, longest: float | None = None, offset: bool = False,
    time_varying: bool = False, model_error: float = MODEL_ERROR, hold: Literal["zero", "linear"] | None = None,
    **reading: Unpack[Reading],
) -> Identified:  # fmt: skip
    """The delay of each input, and the parameters `free`, by a recording of the plant: what it tells, and what not.

    The fit is by rollouts over short segments each with its initial state, by Gauss and Newton's method, where a slow
    plant's segments go on from each other; delays by the profile of the cost, which has kinks; intervals by the
    profile and by drawing the segments anew.

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
    hold : "zero" or "linear", optional
        How an input goes on between two commands: held, or in a straight line. By default it is held, unless an input
        would act before its command so and a straight line fits better.
    **reading : optional
        Of the file of a recording: `columns`, the names of its columns where they are not those of inputs and outputs,
        {"q": "Q1"}; `scale`, factors that bring columns to the plant's units; `shift`, numbers that are then added;
        `time`, the column of the times; `time_unit`, their unit; `period`, of a file without times.

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
    settings = Settings(tuple(free), bounds, longest, offset, time_varying, model_error, hold)
    is_file = isinstance(t, str | Path) or (isinstance(t, list | tuple) and bool(t) and isinstance(t[0], str | Path))
    if any((a is None) != is_file for a in (U, X)):
        got = "both" if is_file else f"no {'U' if U is None else 'X'}"
        raise ConfigError(f"identify: expected the path of a recording, or t, U and X, got {got}; give one of both")
    if is_file:
        log, notes = recorded(plant, t, **reading)
    elif reading:
        raise ConfigError(f"identify: expected {', '.join(reading)} with the path of a recording, got arrays; drop it")
    else:
        t, U, X = (array_checks.floats(name, value) for name, value in (("t", t), ("U", U), ("X", X)))
        U, X = (a[:, None] if a.ndim == 1 else a for a in (U, X))
        outputs = len(plant.outputs)
        if t.ndim != 1 or U.shape != (len(t), plant.m) or X.shape != (len(t), outputs):
            shapes = f"t (N,), U (N, {plant.m}), X (N, {outputs})"
            raise ConfigError(f"identify: expected {shapes}, got {t.shape}, {U.shape}, {X.shape}; give a row per time")
        log, notes = _built(plant, [_series(t, u) for u in U.T], [_series(t, x) for x in X.T])
    with progress.announce("identifying: fits of many delays", 3e-5 * len(log.t) + 1.0):
        return of_log(plant, log, settings, notes)


def _series(t: np.ndarray, values: np.ndarray) -> TimeSeries | None:
    rows = np.flatnonzero(np.isfinite(values) & np.isfinite(t))
    return TimeSeries(t[rows], values[rows], rows) if len(rows) else None


def _built(
    plant: Plant, inputs: Sequence[TimeSeries | None], outputs: Sequence[TimeSeries | None]
) -> tuple[Log, list[str]]:
    """The log of series, and what there is to say of their clock."""
    every = [series and screening.spaced(series) for series in (*inputs, *outputs)]
    present = [series for series in every if series]
    if not all(every[: plant.m]) or len(present) == plant.m:
        got = f"{len(present)} columns with numbers"
        cure = "check the columns"
        raise ConfigError(f"log: expected numbers and times for every input and an output, got {got}; {cure}")
    return Log.of_series(every[: plant.m], every[plant.m :]), screening.of_clock(present, plant.time_unit)


def of_log(plant: Plant, log: Log, settings: Settings, notes: Sequence[str] = ()) -> Identified:
    """The answer of a log; see `identify`. `notes` are said before it.

    What comes before the longest delay has passed is history of the commands only. If that leaves too little, the
    command before the log is taken for its first one, and all of it is used.
    """
    log, bad = screening.screened(log, plant.outputs)
    straight, rows = settings.hold == "linear", excitation.between_rows(log)
    rows = rows._replace(moving=rows.moving and settings.hold is None)
    with np.errstate(all="ignore"):  # a model that runs away is no fault of the program
        answer = _best(plant, log.as_lines() if straight else log.held(), settings, rows)
        other = None
        findings = answer.details["findings"]
        if settings.hold is None and ((findings.early < 0).any() or (findings.lines and findings.lines.better)):
            other = _best(plant, log.as_lines(), settings, rows._replace(moving=False))
    if other:
        sizes = [each.details["estimate"].size for each in (answer, other)]
        if sizes[1] < sizes[0] + (alternatives.ALIKE if (other.details["findings"].early >= 0).all() else 0.0):
            answer = other
            share = np.exp(sizes[1] - sizes[0])
            bad.append(f"Inputs in straight lines fit better than held ones, with errors {share:.2f} times as large.")
    return replace(answer, sentences=[*notes, *bad, *answer.sentences])


def _best(plant: Plant, log: Log, settings: Settings, rows: BetweenRows) -> Identified:
    """The answer by what comes after the longest delay; by all, if that leaves less open and commands move before."""
    begins = log.starts[:, None] + np.linspace(0.0, longest(log, settings), 100)
    moving = (np.ptp(log.arrived(begins, np.zeros(plant.m)), axis=1) > EARLY_SHARE * np.ptp(log.U, axis=0)).any()
    try:
        answer = _answer(plant, log, settings, rows, False)
    except ConfigError:
        if not moving:
            raise
        return _answer(plant, log, settings, rows, True)
    findings = answer.details["findings"]
    if not moving or answer.identifiable.all() or answer.refused or findings.varies.any() or findings.scatter.any():
        return answer
    whole = _answer(plant, log, settings, rows, True)
    if whole.refused or not _begins_held(whole):
        return answer
    return max(answer, whole, key=lambda each: (each.identifiable.sum(), -np.ptp(each.interval, axis=1).sum()))


def _begins_held(answer: Identified) -> bool:
    """True if the log does not contradict that its first command was held before: errors at its begin are no larger."""
    estimate, log = answer.details["estimate"], answer.details["log"]
    begin = estimate.problem.segments.t <= log.begin + max(answer.interval.max(), SETTLING * log.period)
    r = np.where(begin[..., None], estimate.fit.residuals, np.nan)
    return bool(mean_square(r).max() < LARGER * max(mean_square(estimate.fit.residuals).max(), 1e-300))


def _answer(plant: Plant, log: Log, settings: Settings, rows: BetweenRows, whole: bool) -> Identified:
    """The answer by the whole log, or by what comes after the longest delay."""
    problem, low, high = prepared(plant, log, settings, whole)
    delays = estimate(problem, low, high, randomness.generator(settings.seed, "identify"))
    segments = delays.problem.segments
    bad = screening.outside(delays.problem.tolerant(delays.fit) * delays.problem.scale, segments.Y)
    lines = []
    if bad.any():  # once more without them
        out = bad.any(axis=-1)
        names = [plant.outputs[k] for k in np.flatnonzero(bad.any(axis=(0, 1)))]
        lines.append(screening.left_out(", ".join(names), segments.rows[out]))
        out = np.isin(problem.segments.t, segments.t[out])[..., None]
        problem = replace(problem, segments=replace(problem.segments, Y=np.where(out, np.nan, problem.segments.Y)))
        delays = estimate(problem, low, high, randomness.generator(settings.seed, "identify"))
    fewer = alternatives.thinned(delays)
    others = [alternatives.of_input(fewer, j, high[j]) for j in range(plant.m)]
    recurring = excitation.recurring(log, high)
    recurring = np.where(alternatives.recurs(fewer, recurring, low, high), recurring, np.inf)
    early = np.where(delays.interval[:, 1] < 0, delays.values, 0.0)
    asked, assumed, combination = parameters(plant, delays, settings.seed)
    none = np.zeros(plant.m, dtype=bool)
    findings = settled(Findings(
        plant, delays.values, early, delays.interval, high, log.period, others,
        alternatives.in_lines(fewer, low, high) if rows.moving else None, rows.late,
        windows.over_time(delays, low, high, None if whole else _first(log, delays)),
        np.array([windows.scattered(delays, j) for j in range(plant.m)]), none, none,
        excitation.still(log), excitation.alike(log), recurring, asked, assumed, combination,
        delays.inflation, delays.lasting, correlated_share(delays),
        excitation.following(delays.fit.residuals, delays.problem.segments, delays.values), delays.accurate,
        bool(delays.others), excitation.followed(log), alternatives.held_back(delays, high),
    ))  # fmt: skip
    asked = {} if findings.silent else asked
    if whole:
        lines.append("Before the recording starts, its first command is assumed.")
    else:
        first = plant.time_text(high.max(), ".3g")
        lines.append(f"The first {first} give only commands, because commands from before may still act then.")
    if settings.time_varying:
        lines += [findings.windows.sentence(plant, j, delays.interval[j]) for j in range(plant.m)]
    return Identified(
        plant, findings.D, findings.interval, findings.identifiable, findings.silent,
        {name: row.value for name, row in asked.items()}, {name: (row.low, row.high) for name, row in asked.items()},
        findings.validation.errors, [*lines, *_far(plant, log), *findings.sentences],
        findings.windows if settings.time_varying or findings.varies.any() else None,
        {"estimate": delays, "log": log, "findings": findings, "combination": combination},
    )  # fmt: skip


def _first(log: Log, delays: Delays) -> Segments | None:
    """The part before that which the delays are of, from where on all commands are known that act by them; None if that
    is short.
    """
    used, rows = delays.problem.segments, log.later(float(delays.interval.max()))
    first, count = rows.some(rows.t < used.t[0, 0]), int(used.mask.sum(axis=1).max())
    return Segments.of(first, count, screening.GAP * log.period) if len(first.t) > 2 * count else None


def _far(plant: Plant, log: Log) -> list[str]:
    """Sentences about measured states far from the plant's box: their unit is another, perhaps."""
    lines = []
    for name, y in () if plant.declares_output else zip(plant.states, log.Y.T, strict=True):
        if name in plant.box and np.isfinite(y).any():
            (low, high), (least, most) = plant.box[name], np.nanquantile(y, [0.1, 0.9])
            if max(low - least, most - high) > FAR * (high - low):
                span = f"{low:g} to {high:g} in the plant's box"
                both = f"{name} is {least:.3g} to {most:.3g} in the recording, and {span}"
                angle = plant.units.get(name, "").startswith("rad")
                cure = f", from degrees by the factor {np.pi / 180:.6g}" if angle else ""
                lines.append(f"{both}: if the units differ, scale its column{cure}.")
    return lines


def recorded(
    plant: Plant, paths: str | Path | Sequence[str | Path], columns: Mapping[str, str] = {},
    scale: Mapping[str, float] = {}, shift: Mapping[str, float] = {}, time: str | None = None,
    time_unit: str | None = None, period: float | None = None,
) -> tuple[Log, list[str]]:  # fmt: skip
    """The log in a file, or in several of one plant; a column c is scale[c] c + shift[c] in the plant's unit.

    An output that the recording does not have, and that `columns` does not name, is not measured. Returns sentences
    about the reading, too. Raises ConfigError where an input has no column, or no output has one.
    """
    every = {name: columns.get(name, name) for name in (*plant.inputs, *plant.outputs)}
    for name in columns:
        if name not in every:
            raise ConfigError(unlisted("columns", name, every, f"inputs or outputs of plant {plant.name},"))
    logs, notes = [], []
    for path in map(Path, [paths] if isinstance(paths, str | Path) else paths):
        file = recordings.opened(path)
        names = file.columns()
        unmeasured = [name for name in plant.outputs if every[name] not in names and name not in columns]
        if len(unmeasured) == len(plant.outputs):
            cure = f"map one by columns or --state, as {plant.outputs[0]}={names[-1] if names else 'y'}"
            one = f"a column for one of {', '.join(plant.outputs)}"
            raise ConfigError(f"{path}: expected {one}, found {', '.join(names)}; {cure}")
        chosen = {name: column for name, column in every.items() if name not in unmeasured}
        for key in (*scale, *shift):
            if key not in chosen.values():
                raise ConfigError(unlisted("scale, shift", key, chosen.values(), "columns that are read,"))
        read = recordings.read(
            path, list(chosen.values()), time, time_unit, period=period, unit=plant.time_unit, file=file
        )
        in_units, hints = {}, []
        for name, c in chosen.items():
            t, values, rows = read.series[c]
            in_units[name] = TimeSeries(t, scale.get(c, 1.0) * values + shift.get(c, 0.0), rows)
            units = read.units.get(c, ""), plant.units.get(name, "")
            if units[0].startswith(DEGREES) and units[1].startswith("rad") and c not in scale:
                factor = f"{np.pi / 180:.6g}"
                hints.append(f"{c} is in degrees, {name} of the plant in rad: scale it by --scale {c}={factor}.")
        outputs = [in_units.get(name) for name in plant.outputs]
        log, clock = _built(plant, [in_units[name] for name in plant.inputs], outputs)
        logs.append(log)
        notes += [*read.notes, *hints, *clock]
    return (Log.joined(logs) if len(logs) > 1 else logs[0]), notes


def prepared(plant: Plant, log: Log, settings: Settings, whole: bool = False) -> tuple[Problem, np.ndarray, np.ndarray]:
    """The problem of a log, or of its part after the longest delay, and the least and longest delays (m,)."""
    if plant.declares_delay:
        raise ConfigError(f"plant {plant.name}: expected a plant whose delay is unknown, it declares delay(x, t, p, M)")
    most_delay = longest(log, settings)
    rows = log.later(0.0 if whole else most_delay)
    names, bounds, free_range = list(plant.p_names), settings.bounds or {}, (-np.inf, np.inf)
    for name in (*settings.free, *bounds):
        if name not in plant.parameters:
            raise ConfigError(unlisted("free", name, plant.parameters, f"parameters of plant {plant.name}:"))
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
    ranges = {k: bounds[names[k]] if names[k] in bounds else _one_sign(plant, k) for k in free if k < len(names)}
    limits = [ranges.get(k, free_range) for k in free]
    prior, model = Prior(mean, deviation, np.array(limits).reshape(-1, 2).T), RolloutModel(plant, tuple(free))
    if len(rows.t) < (enough := 4 * (plant.n + len(free) + 1)):
        later = f"samples later than the longest delay, {plant.time_text(most_delay)}, after the first command"
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
    segments = Segments.of(rows, count, screening.GAP * log.period)
    rough, wide = spread(np.diff(rows.Y, 2, axis=0)) / np.sqrt(6), spread(rows.Y)
    scale = np.where(rough > 0, rough, np.where(wide > 0, 1e-3 * wide, 1.0))
    problem = Problem(model, segments, scale, prior)
    low = np.full(plant.m, -EARLY * log.period)
    first = problem.some(CHECKED)
    problem = replace(problem, model=first.refined(first.fit(low * 0, None, 0)).model)
    return problem.softened(problem.fit(low * 0, None, 0)), low, np.full(plant.m, most_delay)


def longest(log: Log, settings: Settings) -> float:
    """The longest delay that is tried."""
    return settings.longest or min(log.span / RANGE[0], RANGE[1] * log.period)


def _one_sign(plant: Plant, k: int) -> tuple[float, float]:
    """The limits of parameter k: those of its sign where the plant cannot have a zero there, as a time constant."""
    at_zero = plants.varied(
        plant, tuple((name, 0.0 if j == k else value) for j, (name, value) in enumerate(plant.parameters.items()))
    )
    with np.errstate(all="ignore"):
        try:
            finite = np.isfinite(at_zero.f(plant.guess[None], np.ones((1, plant.m)), 0.0)).all()
        except (ArithmeticError, ValueError):
            finite = False
    value = plant.p[k]
    if finite or value == 0:
        return -np.inf, np.inf
    return (1e-9 * value, np.inf) if value > 0 else (-np.inf, 1e-9 * value)
