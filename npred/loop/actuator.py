"""The actuator state u(x, t) = U(t + D (x - 1)), the exact solution of D u_t = u_x, u(1, t) = U(t) [DAPF, eqs. 6-7].

The controller holds U over each control step, so the history is piecewise constant and everything here is exact. Rows
of the ring buffers are control steps: `held[k]` is U on [k dt, (k + 1) dt), `total[k]` the sum of U over the steps
before k. D (m, B) has one delay per input.
"""

import math
from typing import Any

import numpy as np
from numba import njit

from npred.plants.inputs import Past
from npred.symbolic.compile_cache import jit

ROUNDING = 1e-9  # of a control step: positions this close to a step's start are on it


# k, dt, D (m, B), held, total (R, m, B) -> u, u_nodes (nx, m, B)
TRANSPORT = (
    "void(int64, float64, float64[:,::1], float64[:,:,::1], float64[:,:,::1], float64[:,:,::1], float64[:,:,::1])"
)
# k, dt, D (m, B), U (m, B) -> held, total (R, m, B), U0, U1, share (m, B)
ACTUATE = (
    "void(int64, float64, float64[:,::1], float64[:,::1], float64[:,:,::1], float64[:,:,::1], float64[:,::1], "
    "float64[:,::1], float64[:,::1])"
)


@njit  # compiled into those that call it, as the next two
def copy(source: np.ndarray, target: np.ndarray) -> None:
    """Copy source (·, B) to target. For `target[:] = source` Numba would compile the text of an error, for seconds."""
    for c in range(source.shape[0]):
        for l in range(source.shape[1]):
            target[c, l] = source[c, l]


@njit
def _sum_to(s: float, held: np.ndarray, total: np.ndarray, c: int, l: int, wrap: int) -> float:
    """The integral of U over time up to position s, in control steps."""
    i = int(s + ROUNDING)
    row = i - wrap if i >= wrap else i - wrap + held.shape[0]
    return total[row, c, l] + max(s - i, 0.0) * held[row, c, l]


@njit
def _stored(span: float, longest: float) -> float:
    """A delay in control steps, within what the ring buffers hold; that of a loop which ended is NaN, and reads 0."""
    return min(span, longest) if span > 0.0 else 0.0


@jit(TRANSPORT, nogil=True, error_model="numpy")
def transport(
    k: int, dt: float, D: np.ndarray, held: np.ndarray, total: np.ndarray, u: np.ndarray, u_nodes: np.ndarray
) -> None:
    """Write u(x, k dt) for the true delays D as its two readers need it.

    `u` has the mean over each node's cell: the predictor integrates u, and the trapezoidal rule on cell means is the
    integral of the held input, on any grid. `u_nodes` has values at the nodes, which the update law compares with
    kappa(P): linear between the starts of control steps, where U = kappa(P(1)) was commanded; the held value lags
    behind by half a step on average. At x = 1 it is the newest U, from the left.
    """
    nx, m, lanes = u.shape
    rows = held.shape[0]
    wrap = k - k % rows  # row of step i is i - wrap, plus rows where that is negative: a modulo each costs too much
    span, before, sum_before = np.empty(lanes), np.empty(lanes), np.empty(lanes)
    for c in range(m):
        for l in range(lanes):
            span[l] = _stored(D[c, l] / dt, min(k, rows - 1))
            before[l] = k - span[l]
            sum_before[l] = _sum_to(before[l], held, total, c, l, wrap)
        for j in range(nx):
            node, edge = 1.0 - j / (nx - 1), max(1.0 - (j + 0.5) / (nx - 1), 0.0)
            for l in range(lanes):
                s = k - edge * span[l]
                sum_s = _sum_to(s, held, total, c, l, wrap)
                u[j, c, l] = (sum_s - sum_before[l]) / (s - before[l]) if s > before[l] else held[(k - 1) % rows, c, l]
                before[l], sum_before[l] = s, sum_s
                position = k - node * span[l]
                i = min(int(position + ROUNDING), k - 1)
                row, after = i - wrap, min(i + 1, k - 1) - wrap
                start = held[row if row >= 0 else row + rows, c, l]
                end = held[after if after >= 0 else after + rows, c, l]
                u_nodes[j, c, l] = start + max(position - i, 0.0) * (end - start)


@njit  # compiled into those that call it
def leaving(k: int, dt: float, D: float) -> tuple[int, float]:
    """The step whose command leaves a delay D at the start of control step k, and for how much of the step it does."""
    s = k - D / dt
    i = math.floor(s + ROUNDING)
    return i, 1.0 - (s - i) if s - i > ROUNDING else 1.0


@jit(ACTUATE, nogil=True)
def actuate(
    k: int, dt: float, D: np.ndarray, U: np.ndarray, held: np.ndarray, total: np.ndarray, U0: np.ndarray,
    U1: np.ndarray, share: np.ndarray,
) -> None:  # fmt: skip
    """Hold U over control step k, and say what leaves the delay meanwhile: U0 for the first `share` of it, then U1."""
    rows = held.shape[0]
    for c in range(U.shape[0]):
        for l in range(U.shape[1]):
            i, share[c, l] = leaving(k, dt, D[c, l])
            held[k % rows, c, l] = U[c, l]
            total[(k + 1) % rows, c, l] = total[k % rows, c, l] + U[c, l]
            U0[c, l] = held[i % rows, c, l]
            U1[c, l] = held[(i + 1) % rows, c, l]


@njit  # compiled into the engine
def retime(k: int, dt: float, D: Any, speed: Any, held: Any, U1: Any, share: Any) -> None:
    """The same where the delay changes during the step: phi(t) = t - D passes the commands at that speed.

    The first switch comes when phi has passed the rest of its control step; all that follows it is U1, the mean of the
    commands over what is left. A speed that is not positive, at a jump of the delay say, holds U0.
    """
    rows = held.shape[0]
    for c in range(D.shape[0]):
        for l in range(D.shape[1]):
            i, rest = leaving(k, dt, D[c, l])
            share[c, l] = 1.0
            if speed[c, l] > rest:
                share[c, l] = rest / speed[c, l]
                left, total, i = speed[c, l] - rest, 0.0, i + 1
                mean = held[min(i, k) % rows, c, l]
                while left > 1.0 and i < k:
                    total, left, i = total + held[i % rows, c, l], left - 1.0, i + 1
                    mean = (total + left * held[i % rows, c, l]) / (speed[c, l] - rest)
                U1[c, l] = mean


def history(before: float, longest: float, dt: float, past: Past) -> tuple[int, np.ndarray, np.ndarray]:
    """The first step's number and the ring buffers, filled with the inputs of t < 0.

    They reach back to `before` seconds before t = 0, and to `longest` seconds at any time.
    """
    origin, rows = int(before / dt) + 3, int(max(before, longest) / dt) + 4
    commands = past.steps(origin, dt)
    held = np.ascontiguousarray(np.concatenate([commands, np.repeat(commands[-1:], rows - origin, axis=0)]))
    if past.course is None:  # exact sums
        steps = np.arange(rows, dtype=float)[:, None, None]
        return origin, held, steps * held - origin * held
    total = np.concatenate([np.zeros_like(held[:1]), np.cumsum(held[:-1], axis=0)])
    return origin, held, total - total[origin]
