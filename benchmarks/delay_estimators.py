"""Three estimators of a delay that are in use elsewhere, re-implemented from their descriptions.

Each takes the nominal plant, t (N,), U (N, m), X (N, n), the input's number and the longest delay. It gives D, the
ends of an interval of 95 %, and whether it accepts its own answer. Logs are read on a grid of the median period:
commands held, samples by lines between them. Where a description has no interval, the answers for
blocks of the log give it, by Student's t.
"""

from collections.abc import Callable

import numpy as np
from scipy.signal import savgol_filter
from scipy.stats import t as student

from npred.plants import Plant

Found = tuple[float, float, float, bool]
WINDOWS, CORRELATION, CONFIDENCE, BLOCKS, SPREAD = (
    8,
    0.95,
    0.7,
    50,
    2.0,
)  # spread: .1 s of openpilot's 20 Hz, in periods
VIABLE = 0.9  # of the range of correlations: a lag that is as likely as the best one
SMOOTHING = 5, 11, 21, 41  # samples of a filter without lag, before correlation
PARTS = 5
ORDERS = (1, 1), (2, 1), (2, 2), (3, 2), (4, 3)  # na, nb of ARX


def on_grid(t: np.ndarray, U: np.ndarray, X: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """The median period, and commands and samples on a grid of it."""
    period = float(np.median(np.diff(t)))
    grid = np.arange(t[0], t[-1], period)
    held = U[np.searchsorted(t, grid + 1e-9 * period, side="right") - 1]
    return period, held, np.stack([np.interp(grid, t, x) for x in X.T], axis=1)


def peak(values: np.ndarray, k: int) -> float:
    """The place of the extremum near k by a parabola through three values."""
    if not 0 < k < len(values) - 1:
        return float(k)
    a, b, c = values[k - 1 : k + 2]
    bend = a - 2 * b + c
    return k + float(np.clip(0.5 * (a - c) / bend, -0.5, 0.5)) if bend else float(k)


def correlations(u: np.ndarray, y: np.ndarray, most: int) -> np.ndarray:
    """Normalised cross-correlation of u, held back by 0 to `most` samples, with y, over the samples that both have."""
    values = []
    for lag in range(most + 1):
        a, b = u[: len(u) - lag], y[lag:]
        a, b = a - a.mean(), b - b.mean()
        size = np.sqrt((a @ a) * (b @ b))
        values.append(a @ b / size if size > 0 else 0.0)
    return np.array(values)


def motions(plant: Plant, U: np.ndarray, X: np.ndarray, j: int, period: float) -> list[np.ndarray]:
    """The input that the measured motion asks for, by the nominal plant and a smoothed derivative; f is affine in u."""
    found, rest = [], np.median(U, axis=0)
    for width in SMOOTHING:
        x = np.asarray(savgol_filter(X, width, 2, axis=0))
        slopes = savgol_filter(X, width, 2, deriv=1, delta=period, axis=0)
        times, held = np.zeros(len(x)), np.tile(rest, (len(x), 1))
        base = plant.f(x, held, times)
        B = np.stack([plant.f(x, held + unit, times) - base for unit in np.eye(len(rest))], axis=-1)
        found.append((np.linalg.pinv(B) @ (slopes - base)[..., None])[:, j, 0])
    return found


def openpilot(plant: Plant, t: np.ndarray, U: np.ndarray, X: np.ndarray, j: int, longest: float) -> Found:
    """Masked normalised cross-correlation in windows, accepted by correlation and confidence, averaged over blocks."""
    period, held, Y = on_grid(t, U, X)
    most, u = round(longest / period), held[:, j]
    motion = max(motions(plant, held, Y, j, period), key=lambda y: correlations(u, y, most).max())
    length = max(len(u) // WINDOWS, 3 * most, 60)
    answers: list[tuple[float, bool]] = []
    for begin in range(0, max(len(u) - length, 0) + 1, max(length // 4, 1)):
        a, b = u[begin : begin + length], motion[begin : begin + length]
        if np.ptp(a) == 0:
            continue
        ncc = correlations(a, b, most)
        k = int(ncc.argmax())
        viable = ncc >= ncc.min() + VIABLE * (ncc.max() - ncc.min())
        group = np.cumsum(np.append(True, np.diff(viable.astype(int)) != 0))
        confidence = (group == group[k]).sum() / max(viable.sum(), 1)
        answers.append((peak(ncc, k), bool(ncc[k] > CORRELATION and confidence > CONFIDENCE)))
    accepted = [lag for lag, good in answers if good][-BLOCKS:]
    ncc = correlations(u, motion, most)
    used = accepted or [peak(ncc, int(ncc.argmax()))]
    D, spread = float(np.mean(used)), float(np.std(used, ddof=1)) if len(used) > 1 else np.nan
    half = 1.96 * spread  # of the blocks, which overlap
    return D * period, (D - half) * period, (D + half) * period, bool(accepted) and spread < SPREAD


def by_blocks(estimate: Callable[..., float], period: float, u: np.ndarray, X: np.ndarray, j: int, most: int) -> Found:
    """The answer for the whole log, with an interval by the answers for its blocks."""
    D = estimate(u, X, j, most)
    size = len(u) // PARTS
    parts = [estimate(u[k * size :][:size], X[k * size :][:size], j, min(most, size // 3)) for k in range(PARTS)]
    half = student.ppf(0.975, PARTS - 1) * np.std(parts, ddof=1) / np.sqrt(PARTS)
    return D * period, (D - half) * period, (D + half) * period, True


def autoware(plant: Plant, t: np.ndarray, U: np.ndarray, X: np.ndarray, j: int, longest: float) -> Found:
    """A grid over dead time and time constant of first-order models by least squares, for the state that fits best."""
    period, held, Y = on_grid(t, U, X)
    return by_blocks(_first_order, period, held, Y, j, round(longest / period))


def _first_order(U: np.ndarray, X: np.ndarray, j: int, most: int) -> float:
    """The dead time in samples of gain / (tau s + 1) from input j; offset and first value are fitted as well.

    Very long time constants make it an integrator. The other inputs pass the same filter without a dead time.
    """
    best, answer, N = np.inf, 0.0, len(U)
    spread = X.var(axis=0) + 1e-300
    for tau in np.geomspace(1, 30 * N, 30):
        share, y = np.exp(-1 / tau), np.zeros_like(U)
        for k in range(1, N):
            y[k] = share * y[k - 1] + (1 - share) * U[k - 1]
        others, decay = np.delete(y, j, axis=1), share ** np.arange(N)
        losses = np.empty((most + 1, X.shape[1]))
        for d in range(most + 1):
            late = np.append(np.full(d, y[0, j]), y[: N - d, j])
            A = np.column_stack([late, others, np.ones(N), decay])[most:]
            left = X[most:] - A @ np.linalg.lstsq(A, X[most:], rcond=None)[0]
            losses[d] = left.var(axis=0) / spread
        d, i = np.unravel_index(losses.argmin(), losses.shape)
        if losses[d, i] < best:
            best, answer = losses[d, i], peak(losses[:, i], int(d))
    return answer


def delayest(plant: Plant, t: np.ndarray, U: np.ndarray, X: np.ndarray, j: int, longest: float) -> Found:
    """A scan of ARX orders and delays, least loss with Akaike's price of a parameter."""
    period, held, Y = on_grid(t, U, X)
    return by_blocks(_arx, period, held, Y, j, round(longest / period))


def _arx(U: np.ndarray, X: np.ndarray, j: int, most: int) -> float:
    """The delay in samples of y_k = Σ a_i y_{k-i} + Σ b_i u_{k-d-i} + c; the other inputs' delays by turns."""
    N, m, n = len(U), U.shape[1], X.shape[1]
    best, answer = np.inf, 0.0
    for na, nb in ORDERS:
        first, delays = most + na + nb + 1, [0] * m
        if N - first < 4 * (n * na + m * nb + 1):
            continue
        rows = np.arange(first, N)
        past = np.column_stack([X[rows - i] for i in range(1, na + 1)] + [np.ones(len(rows))])
        losses = np.zeros(most + 1)
        for _ in range(2 if m > 1 else 1):
            for i in [*(k for k in range(m) if k != j), j] if m > 1 else [j]:
                rest = [U[rows - 1 - delays[k] - b, k] for k in range(m) if k != i for b in range(nb)]
                A = np.column_stack([past, *rest])
                Q = np.linalg.qr(A)[0]
                Y = X[rows] - Q @ (Q.T @ X[rows])
                for d in range(most + 1):
                    B = np.column_stack([U[rows - 1 - d - b, i] for b in range(nb)])
                    B = B - Q @ (Q.T @ B)
                    left = Y - B @ np.linalg.lstsq(B, Y, rcond=None)[0]
                    losses[d] = np.log(left.var(axis=0) + 1e-300).sum()
                delays[i] = int(losses.argmin())
        price = losses.min() + 2 * n * (n * na + m * nb + 1) / len(rows)
        if price < best:
            best, answer = price, peak(losses, delays[j]) + nb / 2  # the middle of what nb commands reach
    return answer


ESTIMATORS = {"openpilot": openpilot, "autoware": autoware, "delayest": delayest}
