"""What is wrong with a recording before it is used: its clock, single bad samples, sensors that stick.

A sample that is left out is named by its row in the file.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from npred.identification.log import Log, restarts
from npred.identification.recordings import TimeSeries

GAP = 20  # periods without a sample, which end a segment
COARSE = 0.3  # share of rows with the stamp of the row before: the clock is coarse
WINDOW = 5  # samples, by whose median each is judged
FAR = 20.0  # sizes of the noise, and more than the spread of the log, that a bad sample is off
RARE = 0.02  # share of the samples that may be bad
OUTSIDE = 8.0  # sizes of the residuals of a fit that a bad sample is off
STUCK = 15  # equal samples of a sensor that sticks
ALIVE = 0.05  # share of equal neighbours in a log with noise
NAMED = 5  # rows in a sentence


def spaced(series: TimeSeries) -> TimeSeries:
    """The series with rows of one coarse stamp spread evenly up to the next one; else as it is."""
    t = series.t
    begins = np.flatnonzero(np.append(True, np.diff(t) != 0))
    if len(t) - len(begins) <= COARSE * len(t) or len(begins) < 2:
        return series
    counts = np.diff(np.append(begins, len(t)))
    spans = np.append(np.diff(t[begins]), np.median(np.diff(t[begins])))
    place = np.arange(len(t)) - np.repeat(begins, counts)
    return TimeSeries(t + place * np.repeat(spans / counts, counts), series.values, series.rows)


def of_clock(series: Sequence[TimeSeries], unit: str) -> list[str]:
    """Sentences about the clock of the longest series: coarse, begun anew, doubled, without samples."""
    t, _, rows = max(series, key=lambda each: len(each.t))
    same, notes, run = np.diff(t) == 0, [], restarts(t)
    if same.sum() > COARSE * len(t):
        notes.append(f"The stamps are coarse: {same.mean():.0%} of the rows have that of the row before. "
                     "Rows between two stamps are spread evenly.")  # fmt: skip
    elif same.any():
        first = rows[np.argmax(same) + 1]
        which = f"Row {first} has" if same.sum() == 1 else f"{same.sum()} rows, as row {first}, have"
        notes.append(f"{which} the stamp of the row before: the later one counts.")
    if run[-1]:
        begins = _listed(rows[np.flatnonzero(np.diff(run)) + 1])
        notes.append(f"The clock restarts at {begins}: each part is taken as a recording.")
    step = np.where(np.diff(run) > 0, 0.0, np.diff(t))
    gaps = np.flatnonzero(step > GAP * np.median(step[step > 0])) if (step > 0).any() else np.zeros(0, dtype=int)
    if len(gaps):
        longest = gaps[step[gaps].argmax()]
        more = "" if len(gaps) == 1 else f", and {len(gaps) - 1} shorter times"
        notes.append(f"There is no sample for {step[longest]:.4g} {unit} after row {rows[longest]}{more}: "
                     "the last command is taken as held.")  # fmt: skip
    return notes


def screened(log: Log, outputs: Sequence[str]) -> tuple[Log, list[str]]:
    """The log without bad samples and stuck stretches, and sentences about these."""
    Y, notes = log.Y.copy(), []
    for column, name in zip(Y.T, outputs, strict=True):
        places = np.flatnonzero(np.isfinite(column))
        if len(places) < 4 * WINDOW:
            continue
        y = column[places]
        off = np.abs(
            y - np.median(np.lib.stride_tricks.sliding_window_view(np.pad(y, WINDOW // 2, "reflect"), WINDOW), 1)
        )
        wide = np.subtract(*np.quantile(y, [0.99, 0.01]))
        bad = off > max(FAR * 1.4826 * np.median(off), wide)
        if wide > 0 and 0 < bad.sum() <= max(RARE * len(y), 1):
            notes.append(left_out(name, log.rows[places[bad]], y[bad]))
            column[places[bad]] = np.nan
        begins = np.flatnonzero(np.append(True, np.diff(y) != 0))
        counts = np.diff(np.append(begins, len(y)))
        stuck = counts >= STUCK
        moving = len(y) - counts[stuck].sum()
        if stuck.any() and moving > len(y) / 4 and (counts[~stuck] - 1).sum() < ALIVE * moving:
            for begin, count in zip(begins[stuck], counts[stuck], strict=True):
                value = y[begin]
                end = ", its smallest value" if value == y.min() else ", its largest value" if value == y.max() else ""
                first, last = log.rows[places[[begin, begin + count - 1]]]
                notes.append(f"{name} stays at {value:.4g}{end} from row {first} to row {last}: these are left out.")
                column[places[begin + 1 : begin + count]] = np.nan
    return replace(log, Y=Y).some(np.flatnonzero(np.isfinite(Y).any(axis=1))), notes


def outside(residuals: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """(S, K, q) True for samples that a fit misses by far, where they, and even more their runs, are rare.

    Residuals are in the unit of Y. Segments follow each other in time. A fit that follows a bad sample, as by an
    initial state, misses its neighbours.
    """
    finite = np.isfinite(residuals) & np.isfinite(Y)
    columns = zip(np.abs(residuals).T, finite.T, strict=True)
    size = np.array([1.4826 * np.median(r[measured]) if measured.any() else 0.0 for r, measured in columns])
    bad = finite & (np.abs(residuals) > OUTSIDE * size)
    runs = bad.sum() - (bad[:, 1:] & bad[:, :-1]).sum()
    if bad.sum() > RARE * finite.sum() or runs > RARE * finite.sum() / 2:
        return np.zeros_like(bad)
    for k in range(bad.shape[-1]):
        measured = finite[..., k]
        bad[measured, k] = _excursions(bad[measured, k], Y[measured, k], OUTSIDE * size[k])
    return bad


def _excursions(bad: np.ndarray, y: np.ndarray, least: float) -> np.ndarray:
    """The runs of samples (N,) that are `bad`, each moved by up to its length to where y goes away and comes back.

    That is where the path of the others, the sum of |y_k+1 - y_k|, is the shortest. A run that does not make the path
    longer by `least` is none: there the model is wrong.
    """
    shifted, places = np.zeros_like(bad), np.flatnonzero(bad)
    for run in np.split(places, np.flatnonzero(np.diff(places) > 1) + 1) if len(places) else ():
        count = len(run)
        low, high = max(run[0] - count - 1, 0), min(run[-1] + count + 2, len(y))
        shifts = sorted(range(-count, count + 1), key=abs)
        begins = [run[0] + shift for shift in shifts if 0 <= run[0] + shift <= len(y) - count]
        paths = [np.abs(np.diff(np.delete(y[low:high], np.arange(count) + b - low))).sum() for b in begins]
        begin = begins[int(np.argmin(paths))]
        shifted[begin : begin + count] = np.abs(np.diff(y[low:high])).sum() - min(paths) > least
    return shifted


def left_out(name: str, rows: np.ndarray, values: Sequence[float] | np.ndarray = ()) -> str:
    """The sentence about bad samples of an output."""
    one, shown = len(rows) == 1, ", ".join(f"{value:.4g}" for value in values[:NAMED])
    bad = f"{name} has {'a bad sample' if one else f'{len(rows)} bad samples'} at {_listed(rows)}"
    return f"{bad}{f' ({shown})' if shown else ''}; {'it is' if one else 'they are'} left out."


def _listed(rows: np.ndarray) -> str:
    more = f" and {len(rows) - NAMED} more" if len(rows) > NAMED else ""
    return f"row{'s' * (len(rows) > 1)} {', '.join(map(str, rows[:NAMED]))}{more}"
