"""A recording: measured outputs at their times, and commands that are held; its segments, and the pieces between them.

A piece is a time without a sample or a command inside it: there the delayed input is constant.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from npred.base.errors import ConfigError
from npred.identification.recordings import TimeSeries

PARTS = 4  # steps of a straight line between two commands
BACK = 20  # periods by which a clock goes back that begins anew


@dataclass(frozen=True)
class Log:
    """Samples Y (N, q) at times t (N,), NaN where an output has none; commands U (K, m), held from their times on.

    `starts` (R,) are the times at which its recordings begin; `rows` (N,) are the numbers of the samples in the file.
    """

    t: np.ndarray
    Y: np.ndarray
    t_U: np.ndarray
    U: np.ndarray
    starts: np.ndarray
    rows: np.ndarray

    @classmethod
    def of(cls, t: np.ndarray, U: np.ndarray, Y: np.ndarray, rows: np.ndarray | None = None) -> "Log":
        """The log of one table: rows (N,) with commands (N, m) and outputs (N, q), NaN where a row brings nothing new.

        Rows are put in order; of rows with one stamp the last one counts. Raises ConfigError where nothing is left.
        """
        rows = np.arange(len(t)) + 1 if rows is None else rows
        order = np.argsort(t, kind="stable")
        t, U, Y, rows = t[order], U[order], Y[order], rows[order]
        places = np.where(np.isfinite(U), np.arange(len(U))[:, None], 0)
        U = np.take_along_axis(U, np.maximum.accumulate(places, axis=0), axis=0)  # a command holds until the next one
        whole = np.isfinite(t) & np.isfinite(U).all(axis=1)
        last = np.append(np.diff(t) > 0, True)
        commands = whole & last
        samples = np.isfinite(t) & last & np.isfinite(Y).any(axis=1)
        if commands.sum() < 2 or samples.sum() < 2:
            got = f"{int(samples.sum())} samples and {int(commands.sum())} commands; check the columns' names and units"
            raise ConfigError(f"log: expected rows with a time, every input and an output, got {got}")
        return cls(t[samples], Y[samples], t[commands], U[commands], t[commands][:1], rows[samples])

    @classmethod
    def of_series(cls, inputs: Sequence[TimeSeries | None], outputs: Sequence[TimeSeries | None]) -> "Log":
        """The log of series, one per input and output, each with its times; None of an output is not measured."""
        every = [*inputs, *outputs]
        runs = [restarts(series.t) if series else None for series in every]
        counts = {int(run[-1]) for run in runs if run is not None}
        if len(counts) == 1 and counts != {0}:  # each series begins anew as often
            parts = (
                [series and TimeSeries(*(a[run == k] for a in series)) for series, run in zip(every, runs, strict=True)]
                for k in range(counts.pop() + 1)
            )
            long = (part for part in parts if all(series is None or len(series.t) > BACK for series in part))
            return cls.joined([cls.of_series(part[: len(inputs)], part[len(inputs) :]) for part in long])
        t = np.unique(np.concatenate([series.t for series in every if series]))
        columns, rows = np.full((len(t), len(every)), np.nan), np.zeros(len(t), dtype=int)
        for column, series in zip(columns.T, every, strict=True):
            if series:
                order = np.argsort(series.t, kind="stable")
                places = np.searchsorted(t, series.t[order])
                column[places] = series.values[order]  # for one stamp the last sample counts
                rows[places] = series.rows[order]
        return cls.of(t, columns[:, : len(inputs)], columns[:, len(inputs) :], rows)

    @classmethod
    def joined(cls, logs: Sequence["Log"]) -> "Log":
        """Recordings one behind the other, as far apart as the longest one takes, so that no command reaches the next.

        The first command of each is held before it.
        """
        if not logs:
            raise ConfigError("log: expected samples in the order of their times, got a clock that always goes back")
        apart = max(log.span for log in logs)
        moved, end = [], 0.0
        for k, log in enumerate(logs):
            shift = end + apart - log.begin if k else 0.0
            t_U = np.append(end - shift, log.t_U) if k else log.t_U
            U = np.append(log.U[:1], log.U, axis=0) if k else log.U
            moved.append(Log(log.t + shift, log.Y, t_U + shift, U, log.starts + shift, log.rows))
            end = moved[-1].t[-1]
        return cls(*(np.concatenate([getattr(log, one.name) for log in moved]) for one in fields(cls)))

    @cached_property
    def period(self) -> float:
        """The median time between two samples."""
        return float(np.median(np.diff(self.t)))

    @property
    def begin(self) -> float:
        """The time from which on the commands are known."""
        return float(self.t_U[0])

    @cached_property
    def span(self) -> float:
        """The time that the longest of the recordings takes."""
        ends = np.append(self.starts[1:], np.inf)
        last = self.t[np.searchsorted(self.t, ends) - 1]
        return float((last - self.starts).max())

    def later(self, wait: float) -> "Log":
        """The samples that come `wait` after the begin of their recording, with all commands."""
        since = self.t - self.starts[np.maximum(np.searchsorted(self.starts, self.t, side="right") - 1, 0)]
        return self.some(since >= wait)

    def some(self, chosen: np.ndarray) -> "Log":
        """Some of the samples, with all commands."""
        return replace(self, t=self.t[chosen], Y=self.Y[chosen], rows=self.rows[chosen])

    def arrived(self, t: np.ndarray, delays: np.ndarray) -> np.ndarray:
        """The inputs (..., m) at times t (...) where input j arrives delays[j] late."""
        places = [np.maximum(np.searchsorted(self.t_U + D, t, side="right") - 1, 0) for D in delays]
        return np.stack([self.U[place, j] for j, place in enumerate(places)], axis=-1)

    def as_lines(self) -> "Log":
        """The same with commands that go on in straight lines, of which each is made of PARTS steps."""
        share = np.arange(PARTS) / PARTS
        t = self.t_U[:-1, None] + np.diff(self.t_U)[:, None] * share
        U = self.U[:-1, None] + np.diff(self.U, axis=0)[:, None] * (share + 0.5 / PARTS)[:, None]
        U = np.append(U.reshape(-1, self.U.shape[1]), self.U[-1:], axis=0)
        return replace(self, t_U=np.append(t, self.t_U[-1]), U=U)

    def held(self) -> "Log":
        """The same without the commands that repeat the last one, which say nothing."""
        new = np.append(True, (np.diff(self.U, axis=0) != 0).any(axis=1))
        return replace(self, t_U=self.t_U[new], U=self.U[new])


def restarts(t: np.ndarray) -> np.ndarray:
    """(N,) how often the clock began anew before each row: it goes back by more than BACK periods, and then goes on."""
    step = np.diff(t)
    forward = step[step > 0]
    back = step < -BACK * (np.median(forward) if len(forward) else np.inf)
    rare = back.sum() < len(t) / BACK  # else the rows are in any order
    return np.append(0, np.cumsum(back & rare))


def mean_square(values: np.ndarray) -> np.ndarray:
    """The mean of squares (q,) of the finite values of (..., q); 0 of a column without."""
    flat = values.reshape(-1, values.shape[-1])
    finite = np.isfinite(flat)
    return (np.where(finite, flat, 0.0) ** 2).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)


def spread(values: np.ndarray) -> np.ndarray:
    """The standard deviation (q,) of the finite values of (N, q); 0 of a column without."""
    finite = np.isfinite(values)
    mean = np.where(finite, values, 0.0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)
    return np.sqrt(mean_square(values - mean))


@dataclass(frozen=True)
class Segments:
    """Runs of samples (S, K), each with its initial state; `mask` says which places hold a sample.

    Y is NaN where an output has no sample. The last place has the time at which the next one begins, if that goes on.
    """

    log: Log
    t: np.ndarray
    Y: np.ndarray
    mask: np.ndarray
    rows: np.ndarray

    @classmethod
    def of(cls, log: Log, rows: int, gap: float) -> "Segments":
        """Segments of about so many samples, none over a time longer than `gap` without a sample."""
        breaks = np.flatnonzero(np.diff(log.t) > gap) + 1
        groups: list[np.ndarray] = []
        after: list[int] = []
        for run in np.split(np.arange(len(log.t)), breaks):
            parts = [part for part in np.array_split(run, max(1, round(len(run) / rows))) if len(part) > 1]
            groups += parts
            after += [part[0] for part in parts[1:]] + [part[-1] for part in parts[-1:]]
        if not groups:
            raise ConfigError(f"log: expected samples closer than {gap:g} to each other, got none; check their times")
        most = max(map(len, groups))
        places = np.array([[*g, *[g[-1]] * (most - len(g)), k] for g, k in zip(groups, after, strict=True)])
        mask = np.arange(most + 1) < np.array([len(g) for g in groups])[:, None]
        return cls(log, log.t[places], np.where(mask[..., None], log.Y[places], np.nan), mask, log.rows[places])

    def __len__(self) -> int:
        return len(self.t)

    def some(self, chosen: np.ndarray | slice) -> "Segments":
        """Some of the segments."""
        return Segments(self.log, self.t[chosen], self.Y[chosen], self.mask[chosen], self.rows[chosen])

    def sparser(self, every: int) -> "Segments":
        """Every so many of the samples, in all segments."""
        places = np.append(np.arange(0, self.t.shape[1] - 1, every), -1)
        return Segments(self.log, *(a[:, places] for a in (self.t, self.Y, self.mask, self.rows)))

    def apart(self) -> "Segments":
        """The same, none of which goes on to the next."""
        return replace(self, t=np.append(self.t[:, :-1], self.t[:, -2:-1], axis=1))

    @cached_property
    def joins(self) -> np.ndarray:
        """(S,) True where the log goes on from the end of a segment to the next one."""
        return self.t[:, -1] > np.where(self.mask, self.t, -np.inf).max(axis=1)

    @cached_property
    def follows(self) -> np.ndarray:
        """(S,) True where a segment begins at the end of the one before it."""
        return np.append(False, self.joins[:-1] & (self.t[:-1, -1] == self.t[1:, 0]))

    def pieces(self, delays: Sequence[float] | np.ndarray) -> "Pieces":
        """The pieces of each segment where input j arrives delays[j] late."""
        log, starts, ends = self.log, self.t[:, 0], self.t[:, -1]
        asked = self.mask | (self.joins[:, None] & (np.arange(self.t.shape[1]) == self.t.shape[1] - 1))
        arrivals = log.t_U[:, None] + np.asarray(delays, dtype=float)  # (K, m)
        samples = self.t[asked]
        events = np.unique(np.concatenate([samples, *(_between(column, starts, ends) for column in arrivals.T)]))
        owner = np.searchsorted(starts, events, side="left") - 1  # the segment that began before the event
        inside = (owner >= 0) & (events <= ends[np.maximum(owner, 0)])
        events, owner = events[inside], owner[inside]
        counts = np.bincount(owner, minlength=len(self))
        row = np.arange(len(events)) - (np.cumsum(counts) - counts)[owner]
        begins = np.where(row == 0, starts[owner], np.append(0.0, events[:-1]))
        middle = (begins + events) / 2
        places = (np.maximum(np.searchsorted(a, middle, side="right") - 1, 0) for a in arrivals.T)
        held = np.stack([log.U[place, j] for j, place in enumerate(places)], 1)
        most, S = int(counts.max()), len(self)
        u, spans, moments = np.zeros((most, held.shape[1], S)), np.zeros((most, S)), np.zeros((most, S))
        u[row, :, owner], spans[row, owner], moments[row, owner] = held, events - begins, begins
        place = np.searchsorted(events, samples)
        rows = np.zeros(self.t.shape, dtype=int)  # 0 is the initial state
        rows[asked] = row[np.minimum(place, len(events) - 1)] + 1
        rows[:, 0] = 0
        return Pieces(u, spans, moments, rows)


def _between(times: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """The sorted times that lie in one of the segments."""
    first, last = np.searchsorted(times, starts, side="right"), np.searchsorted(times, ends, side="right")
    counts = last - first
    return times[np.arange(counts.sum()) + np.repeat(first - np.cumsum(counts) + counts, counts)]


@dataclass(frozen=True)
class Pieces:
    """Held inputs (rows, m, S), spans and begins (rows, S); and the row of each sample (S, K), 0 for the first one."""

    held: np.ndarray
    spans: np.ndarray
    moments: np.ndarray
    rows: np.ndarray
