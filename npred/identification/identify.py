"""`npred.identify`: from a recording, a file or arrays, to the delays and parameters of a plant."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from npred import progress, randomness
from npred.errors import ConfigError
from npred.identification import alternatives, estimate, parameters, recorded
from npred.identification.estimate import Delays
from npred.identification.identified import Findings, Identified, Windows
from npred.identification.log import Log
from npred.identification.preparation import MODEL_ERROR, Settings, arrays, prepared
from npred.plants import Plant
from npred.plants.base import require

FAR = 3.0  # widths of the box beyond it
WINDOW = 8, 20  # segments of a window, and windows, at most


def identify(
    plant: Plant, t: Any, U: Any = None, X: Any = None, *, columns: Mapping[str, str] = {},
    scale: Mapping[str, float] = {}, shift: Mapping[str, float] = {}, time: str | None = None,
    time_unit: str | None = None, free: Sequence[str] = (), bounds: Mapping[str, tuple[float, float]] | None = None,
    longest: float | None = None, offset: bool = False, time_varying: bool = False,
    model_error: float = MODEL_ERROR, seed: int = 0,
) -> Identified:  # fmt: skip
    """The delay of each input, and the parameters `free`, by a recording of the plant: what it tells, and what not.

    The fit is by rollouts over short segments each with its initial state, by Gauss and Newton's method; delays by
    the profile of the cost, which has kinks; intervals by the profile and by drawing the segments anew.

    Raises ConfigError for arrays that do not fit together, a file or a column that is not there, an unknown parameter,
    a log that is too short, and a plant that declares its delay.
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
        log = recorded.read(plant, Path(t), columns, scale, shift, time, time_unit)
    else:
        log = Log.of(*arrays(plant, t, U, X))
    with progress.announce("identifying: fits of many delays", 3e-5 * len(log.t) + 1.0):
        return of_log(plant, log, settings)


def of_log(plant: Plant, log: Log, settings: Settings) -> Identified:
    """What a log tells; see `identify`."""
    problem, high = prepared(plant, log, settings)
    delays = estimate.estimate(problem, 0 * high, high, randomness.generator(settings.seed, "identify"))
    fewer = alternatives.thinned(delays)
    others = [alternatives.of_input(fewer, j, high[j]) for j in range(plant.m)]
    interval = delays.interval.copy()
    for ends, other in zip(interval, others, strict=True):
        ends[0] = 0.0 if other.as_good else min(ends[0], other.behind[0] if other.behind else np.inf)
    asked, assumed = parameters.estimated(plant, delays, settings)
    findings = Findings(
        plant, delays.values, interval, 0 * high, high, log.period, others, np.ptp(log.U, axis=0) == 0, asked, assumed,
        delays.inflation, _closed(log), alternatives.held_back(delays, high),
    )  # fmt: skip
    return Identified(
        plant, delays.values, interval, findings.identifiable, {name: row.value for name, row in asked.items()},
        {name: (row.low, row.high) for name, row in asked.items()}, findings.held_back,
        [*_units(plant, log), *findings.sentences],
        _windows(delays, high, settings) if settings.time_varying else None, {"estimate": delays, "log": log},
    )  # fmt: skip


def _units(plant: Plant, log: Log) -> list[str]:
    """One sentence for each measured state that lies far from the plant's box: its unit is another, perhaps."""
    said = []
    for name, y in () if plant.declares_output else zip(plant.states, log.Y.T, strict=True):
        if name not in plant.box or not np.isfinite(y).any():
            continue
        (low, high), middle = plant.box[name], np.nanmedian(y)
        if max(low - middle, middle - high) > FAR * (high - low):
            log_and_box = f"{name} is about {middle:.3g} in the recording, and {low:g} to {high:g} in the plant's box"
            said.append(f"{log_and_box}: if the units differ, scale its column.")
    return said


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
