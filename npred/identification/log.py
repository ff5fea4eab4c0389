"""A recording: measured outputs at their times, and commands that are held; its segments, and the pieces between them.

A piece is a time without a sample or a command inside it: there the delayed input is constant.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from npred.base.errors import ConfigError

Series = tuple[np.ndarray, np.ndarray]  # times and values


@dataclass(frozen=True)
class Log:
    """Samples Y (N, q) at times t (N,), NaN where an output has none; commands U (K, m), held from their times on."""

    t: np.ndarray
    Y: np.ndarray
    t_U: np.ndarray
    U: np.ndarray

    @classmethod
    def of(cls, t: np.ndarray, U: np.ndarray, Y: np.ndarray) -> "Log":
        """The log of one table: rows (N,) with commands (N, m) and outputs (N, q), NaN where a row brings nothing new.

        Rows are put in order; of rows with one stamp the last one counts. Raises ConfigError where nothing is left.
        """
        order = np.argsort(t, kind="stable")
        t, U, Y = t[order], U[order], Y[order]
        rows = np.where(np.isfinite(U), np.arange(len(U))[:, None], 0)
        U = np.take_along_axis(U, np.maximum.accumulate(rows, axis=0), axis=0)  # a command holds until the next one
        whole = np.isfinite(t) & np.isfinite(U).all(axis=1)
        last = np.append(np.diff(t) > 0, True)
        commands = whole & last
        samples = np.isfinite(t) & last & np.isfinite(Y).any(axis=1)
        if commands.sum() < 2 or samples.sum() < 2:
            got = f"{int(samples.sum())} samples and {int(commands.sum())} commands; check the columns' names and units"
            raise ConfigError(f"log: expected rows with a time, every input and an output, got {got}")
        t_U, U = t[commands], U[commands]
        new = np.append(True, (np.diff(U, axis=0) != 0).any(axis=1))  # a command that repeats the last one says nothing
        return cls(t[samples], Y[samples], t_U[new], U[new])

    @classmethod
    def of_series(cls, inputs: Sequence[Series], outputs: Sequence[Series | None]) -> "Log":
        """The log of series (t, values), one per input and output, each with its times; None is not measured."""
        every = [*inputs, *outputs]
        t = np.unique(np.concatenate([series[0] for series in every if series]))
        columns = np.full((len(t), len(every)), np.nan)
        for column, series in zip(columns.T, every, strict=True):
            if series:
                order = np.argsort(series[0], kind="stable")
                column[np.searchsorted(t, series[0][order])] = series[1][order]  # for one stamp the last sample counts
        return cls.of(t, columns[:, : len(inputs)], columns[:, len(inputs) :])

    @cached_property
    def period(self) -> float:
        """The median time between two samples."""
        return float(np.median(np.diff(self.t)))

    @property
    def begin(self) -> float:
        """The time from which on the commands are known."""
        return float(self.t_U[0])

    def between(self, start: float, end: float) -> "Log":
        """The samples of a span of time, with all commands."""
        inside = (self.t >= start) & (self.t <= end)
        return Log(self.t[inside], self.Y[inside], self.t_U, self.U)


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

    Y is NaN where an output has no sample.
    """

    log: Log
    t: np.ndarray
    Y: np.ndarray
    mask: np.ndarray

    @classmethod
    def of(cls, log: Log, rows: int, gap: float) -> "Segments":
        """Segments of about so many samples, none over a time longer than `gap` without a sample."""
        breaks = np.flatnonzero(np.diff(log.t) > gap) + 1
        groups: list[np.ndarray] = []
        for run in np.split(np.arange(len(log.t)), breaks):
            groups += [part for part in np.array_split(run, max(1, round(len(run) / rows))) if len(part) > 1]
        if not groups:
            raise ConfigError(f"log: expected samples closer than {gap:g} to each other, got none; check their times")
        longest = max(map(len, groups))
        places = np.array([np.append(g, np.full(longest - len(g), g[-1])) for g in groups])
        mask = np.arange(longest) < np.array([len(g) for g in groups])[:, None]
        return cls(log, log.t[places], np.where(mask[..., None], log.Y[places], np.nan), mask)

    def __len__(self) -> int:
        return len(self.t)

    def some(self, chosen: np.ndarray | slice) -> "Segments":
        """Some of the segments."""
        return Segments(self.log, self.t[chosen], self.Y[chosen], self.mask[chosen])

    def pieces(self, delays: Sequence[float] | np.ndarray) -> "Pieces":
        """The pieces of each segment where input j arrives delays[j] late."""
        log, starts, ends = self.log, self.t[:, 0], self.t[:, -1]
        arrivals = log.t_U[:, None] + np.asarray(delays, dtype=float)  # (K, m)
        samples = self.t[self.mask]
        events = np.unique(np.concatenate([samples, *(_between(column, starts, ends) for column in arrivals.T)]))
        owner = np.searchsorted(starts, events, side="left") - 1  # the segment that began before the event
        inside = (owner >= 0) & (events <= ends[np.maximum(owner, 0)])
        events, owner = events[inside], owner[inside]
        counts = np.bincount(owner, minlength=len(self))
        row = np.arange(len(events)) - (np.cumsum(counts) - counts)[owner]
        begins = np.where(row == 0, starts[owner], np.append(0.0, events[:-1]))
        middle = (begins + events) / 2
        held = np.stack(
            [log.U[np.maximum(np.searchsorted(a, middle, side="right") - 1, 0), j] for j, a in enumerate(arrivals.T)], 1
        )
        most, S = int(counts.max()), len(self)
        u, spans, moments = np.zeros((most, held.shape[1], S)), np.zeros((most, S)), np.zeros((most, S))
        u[row, :, owner], spans[row, owner], moments[row, owner] = held, events - begins, begins
        place = np.searchsorted(events, samples)
        rows = np.zeros(self.t.shape, dtype=int)  # 0 is the initial state
        rows[self.mask] = row[np.minimum(place, len(events) - 1)] + 1
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
