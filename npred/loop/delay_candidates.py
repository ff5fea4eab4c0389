"""Which candidate of the delay is the best: what npred.loop.delay_observer decides from the errors of its observers.

K candidates, n states, m inputs, B loops. Of each candidate the squared errors are summed with two forgetting times,
`long` and `short` (K, n, B). The same for every kind of plant; compiled once per machine.
"""

import math

import numpy as np
from numba import njit, types
from numba.extending import register_jitable

from npred.symbolic.compile_cache import jit
from npred.symbolic.kernels import FASTMATH

ROUNDING = 1e-12  # of a state's largest value: errors below it say nothing
DIFFER = 4.0  # the worst candidate's cost over the best one's from which on the estimate moves
RISES = 4.0  # the errors over their level, and over those of the best candidate, from which on the delay has changed
PACE = 2.0  # times what the window tells over what the memory tells is the pace of the memory, 1 at most
FEW = 20.0  # samples that the window has at least: where they come more rarely, it and the memory are longer
TIED = 1.0001  # costs this close to the smallest are as good

# The settings, `law`; behind them the delays of the candidates in control steps (K, m), and in seconds (K,).
NUMBERS = 8
COUNT, INJECT, PUSH, LEAK, FADE, PATIENCE, LOW, HIGH = range(NUMBERS)

FLAGS = {"error_model": "numpy", "fastmath": set(FASTMATH)}
inlined = njit(**FLAGS)
LANE, ROWS, SUMS = (types.Array(types.float64, axes, "C") for axes in (1, 2, 3))
# X (n, B), long, short (K, n, B), floor, level, scale (n, B), calls, pace (B,), gains (4, B), law, thetas (K,)
# -> D_hat (B,)
DECIDE = types.void(ROWS, SUMS, SUMS, ROWS, ROWS, ROWS, LANE, LANE, ROWS, LANE, LANE, LANE)


def size(count: int, n: int, m: int) -> int:
    """The numbers that are remembered per loop."""
    return count * (3 * n + m) + 3 * n + 3


@register_jitable
def parts(memory: np.ndarray, count: int, n: int, m: int) -> tuple[np.ndarray, ...]:
    """Of a memory: x (K, n, B), d (K, m, B), long, short (K, n, B), floor, level, scale (n, B), calls, pace, gap (B,)

    of which `gap` is the control steps since the last sample, and `calls` those up to the last sample.
    """
    lanes, i = memory.shape[1], count * n
    j = i + count * m
    x, d = memory[:i].reshape((count, n, lanes)), memory[i:j].reshape((count, m, lanes))
    long = memory[j : j + i].reshape((count, n, lanes))
    short = memory[j + i : j + 2 * i].reshape((count, n, lanes))
    rest = memory[j + 2 * i :]
    floor, level, scale = rest[:n], rest[n : 2 * n], rest[2 * n : 3 * n]
    return x, d, long, short, floor, level, scale, rest[3 * n], rest[3 * n + 1], rest[3 * n + 2]


@register_jitable
def begin(X: np.ndarray, memory: np.ndarray, count: int, n: int, m: int) -> None:
    """Start every observer at X (n, B), without errors."""
    memory[:] = 0.0
    x, _, _, _, floor, _, scale, calls, pace, _ = parts(memory, count, n, m)
    for c in range(n):
        for l in range(X.shape[1]):
            scale[c, l] = abs(X[c, l])
            for i in range(count):
                x[i, c, l] = X[c, l]
    floor[:] = 1.0
    calls[:] = 1.0
    pace[:] = 1.0


@register_jitable
def gains(X: np.ndarray, dt: float, law: np.ndarray, calls: np.ndarray, gap: np.ndarray, gain: np.ndarray) -> None:
    """Count a control step, and write the gains (4, B) of the samples X (n, B): inject, push, leak, fade.

    Over the T seconds since the sample before, the errors of x and d get the poles e^{sT}, s² + L s + L ω = 0:
        inject = 1 - e^{-LT},   push = (1 + e^{-LT} - 2 e^{-LT/2} cos(T √(L ω - L²/4))) / T,
    of which L ω is the limit of push / T for small T. What is forgotten is that of T seconds, but at most of a share
    1 / FEW of the window. A loop without a sample, NaN, forgets and corrects nothing.
    """
    gap += 1.0
    for l in range(X.shape[1]):
        for j in range(4):
            gain[j, l] = law[INJECT + j]
        if np.isnan(X[0, l]):
            gain[0, l], gain[1, l], gain[2, l], gain[3, l] = 0.0, 0.0, 0.0, 1.0
            continue
        if gap[l] > 1.0:
            stay, T = math.exp(gap[l] * math.log(1.0 - law[INJECT])), gap[l] * dt
            square = law[PUSH] / dt - (math.log(1.0 - law[INJECT]) / dt) ** 2 / 4.0
            root = math.sqrt(abs(square)) * T
            swing = math.cos(root) if square > 0.0 else 0.5 * (math.exp(root) + math.exp(-root))
            gain[0, l], gain[1, l] = 1.0 - stay, (1.0 + stay - 2.0 * math.sqrt(stay) * swing) / T
        counted = min(gap[l], max(law[PATIENCE] / (2.0 * FEW), 1.0))
        if counted > 1.0:
            gain[2, l] = 1.0 - math.exp(counted * math.log(1.0 - law[LEAK]))
            gain[3, l] = math.exp(counted * math.log(law[FADE]))
        calls[l] += counted
        gap[l] = 0.0


@inlined
def smallest(sums: np.ndarray, scale: np.ndarray, c: int, l: int) -> float:
    """The smallest sum of all candidates for state c: over it errors of different units and noise are compared."""
    least = np.inf
    for i in range(len(sums)):
        least = min(least, sums[i, c, l])
    return least + (ROUNDING * scale[c, l]) ** 2 + 1e-300


@inlined
def compare(sums: np.ndarray, unit: np.ndarray, l: int, cost: np.ndarray) -> tuple[int, float]:
    """The cost (K,) of the candidates in loop l, their sums over a unit; the best candidate and the largest cost."""
    best, least, most = 0, np.inf, 0.0
    for i in range(len(cost)):
        cost[i] = 0.0
        for c in range(len(unit)):
            cost[i] += sums[i, c, l] / unit[c, l]
        most = max(most, cost[i])
        if cost[i] < least:
            best, least = i, cost[i]
    return best, most


@inlined
def nearest(cost: np.ndarray, k: int) -> float:
    """The smallest cost of candidate k and its neighbours."""
    least = np.inf
    for i in range(max(k - 1, 0), min(k + 2, len(cost))):
        least = min(least, cost[i])
    return least


@inlined
def estimate(cost: np.ndarray, best: int, thetas: np.ndarray, D_hat: float) -> float:
    """The minimum of the parabola through the best three candidates; of several as good, the one next to D_hat."""
    tied, spacing = TIED * cost[best], thetas[1] - thetas[0]
    if 0 < best < len(cost) - 1 and cost[best - 1] > tied and cost[best + 1] > tied:
        a, b, c = cost[best - 1], cost[best], cost[best + 1]
        return thetas[best] + 0.5 * (a - c) / (a - 2.0 * b + c) * spacing
    theta = np.inf
    for i in range(len(cost)):
        if cost[i] <= tied and abs(thetas[i] - D_hat) < abs(theta - D_hat):
            theta = thetas[i]
    return D_hat if abs(theta - D_hat) <= 0.5 * spacing else theta


@inlined
def weigh(
    X: np.ndarray, long: np.ndarray, short: np.ndarray, floor: np.ndarray, level: np.ndarray, scale: np.ndarray,
    first: bool, leak: float, l: int,
) -> None:  # fmt: skip
    """The units of the costs of loop l, by state: `floor`, the smallest of the long sums, and `level`.

    That is the mean over the memory of the smallest short sum, in which a value counts RISES times the level at most:
    after a jump of the delay the errors of all candidates are large, before those of the right one are small again.
    """
    for c in range(len(X)):
        scale[c, l] = max(scale[c, l], abs(X[c, l]))
        floor[c, l], error = smallest(long, scale, c, l), smallest(short, scale, c, l)
        if first:
            level[c, l] = error
        level[c, l] += leak * (min(error, RISES * level[c, l]) - level[c, l])


@jit(DECIDE, nogil=True, **FLAGS)
def decide(
    X: np.ndarray, long: np.ndarray, short: np.ndarray, floor: np.ndarray, level: np.ndarray, scale: np.ndarray,
    calls: np.ndarray, pace: np.ndarray, gain: np.ndarray, law: np.ndarray, thetas: np.ndarray, D_hat: np.ndarray,
) -> None:  # fmt: skip
    """Move the estimates D_hat (B,) to the best candidates, where the candidates differ, of the loops with a sample.

    What the errors tell is the largest cost. Where the window tells far less than the memory, the pace of the memory is
    slow; and where it tells about as much, errors far above the level and above the best candidate's start it anew.
    """
    spacing, cost = thetas[1] - thetas[0], np.empty(len(thetas))
    for l in range(len(D_hat)):
        if np.isnan(X[0, l]):
            continue
        first, leak, fade = calls[l] <= law[PATIENCE], gain[2, l], gain[3, l]
        weigh(X, long, short, floor, level, scale, first, leak, l)
        k = min(max(round((D_hat[l] - thetas[0]) / spacing), 0), len(thetas) - 1)
        best, window = compare(short, level, l, cost)
        risen = nearest(cost, k) > RISES * max(cost[best], float(len(X)))
        _, memory = compare(long, level, l, cost)
        ratio = (1.0 - fade) / leak * window / memory
        pace[l] = PACE * ratio if PACE * ratio < 1.0 else 1.0  # and where neither tells anything
        if risen and DIFFER * ratio > 1.0 and not first:
            for j in range(short.shape[0]):
                for c in range(short.shape[1]):
                    long[j, c, l] = short[j, c, l]
            weigh(X, long, short, floor, level, scale, first, 0.0, l)
        best, most = compare(long, floor, l, cost)
        if most > DIFFER * cost[best]:
            D_hat[l] = min(max(estimate(cost, best, thetas, D_hat[l]), law[LOW]), law[HIGH])
