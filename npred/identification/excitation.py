"""How the commands of a recording move: alike, again and again, or after the outputs."""

from typing import NamedTuple

import numpy as np

from npred.identification.log import Log, Segments
from npred.identification.screening import GAP

GRID = 4000  # samples of the commands by which they are compared
SAME = 0.995  # correlation of two inputs that move together
SHARP = 0.5  # of an input's range in one step
REPEATED = 0.9  # correlation of an input with itself, a period later
TURNED = 0.5  # before that it has to fall below this, else it is only slow
MISSING = 1.5  # periods without a row: one is missing
REGULAR, OFF = 0.9, 0.2  # share of the rows that are so many periods off a regular clock at most
BEFORE = 9  # places in the span of a segment before a sample, whose commands may explain its error
LAGS = 3  # samples of the outputs that a law may take


def sampled(log: Log) -> tuple[np.ndarray, float]:
    """The commands (GRID, m) at equal steps, less their means; and the step."""
    t = np.linspace(log.begin, log.t[-1], GRID)
    U = log.arrived(t, np.zeros(log.U.shape[1]))
    return U - U.mean(axis=0), float(t[1] - t[0])


def alike(log: Log) -> list[tuple[int, int]]:
    """The pairs of inputs that move together, up to a factor."""
    U, m = sampled(log)[0], log.U.shape[1]
    size = np.sqrt((U**2).sum(axis=0))
    pairs = [(i, j) for j in range(m) for i in range(j) if size[i] > 0 and size[j] > 0]
    return [(i, j) for i, j in pairs if abs(U[:, i] @ U[:, j]) > SAME * size[i] * size[j]]


def still(log: Log) -> np.ndarray:
    """(m,) True for an input that changes in none of the recordings."""
    ends = log.t[np.searchsorted(log.t, np.append(log.starts[1:], np.inf)) - 1]
    parts = [(log.t_U >= begin) & (log.t_U < end) for begin, end in zip(log.starts, ends, strict=True)]
    return ~np.any([(log.U[part] != log.U[part][:1]).any(axis=0) for part in parts], axis=0)


def smooth(log: Log) -> np.ndarray:
    """(m,) True for an input without a sharp step: what disturbs the plant then looks much like another delay."""
    steps = np.abs(np.diff(log.U, axis=0, prepend=log.U[:1])).max(axis=0)
    return steps < SHARP * np.ptp(log.U, axis=0)


class BetweenRows(NamedTuple):
    """What a log does not show of its commands between two rows.

    `late` (m,) is how much older than its row a command may be in the mean, where rows of a regular clock are missing;
    `moving` is True if commands move in most rows, and so between them perhaps.
    """

    late: np.ndarray
    moving: bool


def between_rows(log: Log) -> BetweenRows:
    """What the log does not show of its commands between two rows."""
    gaps, steps = np.diff(log.t_U), np.abs(np.diff(log.U, axis=0))
    period = np.median(gaps[gaps < MISSING * np.quantile(gaps, 0.1)])
    count = gaps / period
    regular = np.mean(np.abs(count - np.round(count)) < OFF) > REGULAR
    older = np.where((count > MISSING) & (count < GAP) & regular, gaps - period, 0.0)
    total = np.maximum((steps**2).sum(axis=0), 1e-300)
    return BetweenRows(older @ steps**2 / total, bool(((steps > 0).mean(axis=0) > 0.5).any() and smooth(log).any()))


def recurring(log: Log, longest: np.ndarray) -> np.ndarray:
    """(m,) the time after which each input repeats itself, up to the longest delay; infinite where it does not."""
    U, step = sampled(log)
    periods = np.full(U.shape[1], np.inf)
    for j, u in enumerate(U.T):
        shares = np.ones(min(int(longest[j] / step) + 1, len(u) // 2))
        for k in range(1, len(shares)):
            one, other = u[k:] - u[k:].mean(), u[:-k] - u[:-k].mean()
            size = np.sqrt((one @ one) * (other @ other))
            shares[k] = one @ other / size if size > 0 else 0.0
        begin = np.argmax(shares < TURNED)  # 0 where it never turns
        high = np.flatnonzero(shares[begin:] > REPEATED) + begin
        if begin and len(high):
            first = high[: np.argmax(np.append(np.diff(high), 2) > 1) + 1]  # the first peak
            periods[j] = step * first[shares[first].argmax()]
    return periods


def followed(log: Log) -> float:
    """R² of the commands by the outputs, of their last samples and their sum, or of the steps of all these if that is
    less: near 1 where a law without a test signal gave the commands.

    A law passes the noise on, so that the steps of its commands follow those of the outputs; a plant does not.
    """
    parts = np.isfinite(log.Y).T
    Y = [np.interp(log.t_U, log.t[s], y[s]) for s, y in zip(parts, log.Y.T, strict=True) if s.sum() > 1]
    if not Y or len(log.t_U) < 4 * (LAGS + 2) * (len(Y) + 1):
        return 0.0
    spans = np.diff(log.t_U, prepend=log.t_U[0]), np.diff(log.t_U, append=log.t_U[-1])
    columns = [np.roll(y, k) for y in Y for k in range(LAGS)]
    columns += [np.cumsum((y - y.mean()) * span) for y in Y for span in spans]
    A, U = np.stack(columns, axis=1)[LAGS:], log.U[LAGS:]
    return min(_explained(U, A), _explained(np.diff(U, axis=0), np.diff(A, axis=0)))


def following(residuals: np.ndarray, segments: Segments, delays: np.ndarray) -> float:
    """R² of the errors (S, K, outputs) of a fit by the commands that arrived before, of segments that it is not fitted
    to: above 0 where the plant answers commands otherwise than the model.
    """
    spans = segments.t[:, -1] - segments.t[:, 0]
    steps = np.append(-delays.max() * np.array([0.75, 0.5, 0.25]), np.linspace(0.0, 1.0, BEFORE) * np.median(spans))
    A = np.concatenate([segments.log.arrived(segments.t, delays + step) for step in steps], axis=-1)
    present, errors = np.isfinite(residuals), np.nan_to_num(residuals)
    total, left, odd = 0.0, 0.0, np.arange(len(A)) % 2 == 1
    for k in range(errors.shape[-1]):
        rows = present[..., k]
        count = np.maximum(rows.sum(axis=1), 1)[:, None, None]
        within = np.where(rows[..., None], A - (A * rows[..., None]).sum(axis=1, keepdims=True) / count, 0.0)
        e = np.where(rows, errors[..., k] - errors[..., k].sum(axis=1, keepdims=True) / count[..., 0], 0.0)
        for part in (odd, ~odd):
            gains = np.linalg.lstsq(within[part].reshape(-1, A.shape[-1]), e[part].ravel(), rcond=1e-6)[0]
            left += ((e[~part] - within[~part] @ gains) ** 2).sum()
            total += (e[~part] ** 2).sum()
    return float(1 - left / total) if total > 0 else 0.0


def _explained(U: np.ndarray, Y: np.ndarray) -> float:
    """R² of U (N, m) by Y (N, q) and a constant."""
    A, U = np.column_stack([np.ones(len(Y)), Y]), U - U.mean(axis=0)
    if len(A) <= A.shape[1] + 2 or not U.any():
        return 0.0
    left = U - A @ np.linalg.lstsq(A, U, rcond=None)[0]
    return float(1 - (left**2).sum() / (U**2).sum())
