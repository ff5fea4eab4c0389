"""Recordings made by SciPy, which shares no code with npred: held commands, delays, irregular samples, noise."""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

Dynamics = Callable[[np.ndarray, np.ndarray], np.ndarray]
Table = tuple[np.ndarray, np.ndarray, np.ndarray]


def recording(
    f: Dynamics, x0: list[float], commands: np.ndarray, D: list[float], period: float, noise: float, seed: int,
    jitter: float = 0.3, outputs: int | None = None,
) -> Table:  # fmt: skip
    """Rows (t, U, X): commands (K, m) each period, states at other times, NaN where a row brings nothing new."""
    rng, count, m = np.random.default_rng(seed), len(commands), commands.shape[1]
    t_U = period * np.arange(count)
    t = np.sort(t_U[1:] + period * rng.uniform(-jitter, jitter, count - 1))
    switches = np.unique(np.concatenate([[0.0, t[-1]], *(t_U + d for d in D)]))
    switches = switches[switches <= t[-1]]
    x, rows, times = np.array(x0, dtype=float), [], []
    for begin, end in zip(switches, switches[1:], strict=False):
        past = [np.searchsorted(t_U + d, (begin + end) / 2, side="right") - 1 for d in D]
        u = np.array([commands[max(k, 0), j] for j, k in enumerate(past)])
        asked = t[(t > begin) & (t <= end)]
        solved = solve_ivp(lambda _, y, u=u: f(y, u), (begin, end), x, dense_output=True, rtol=1e-9, atol=1e-11)
        if len(asked):
            rows.append(solved.sol(asked).T)
            times.append(asked)
        x = solved.y[:, -1]
    X = np.concatenate(rows)[:, :outputs]
    X = X + noise * X.std(axis=0) * rng.standard_normal(X.shape)
    blank = np.full((len(X), m), np.nan), np.full((count, X.shape[1]), np.nan)
    return np.append(t_U, np.concatenate(times)), np.concatenate([commands, blank[0]]), np.concatenate([blank[1], X])


def steps(count: int, m: int, hold: int, seed: int, size: float = 1.0) -> np.ndarray:
    """Commands (count, m) that are drawn anew every `hold` rows."""
    levels = np.random.default_rng([seed, 1]).uniform(-size, size, (-(-count // hold), m))
    return np.repeat(levels, hold, axis=0)[:count]


def looped(
    f: Dynamics, law: Callable[[np.ndarray], np.ndarray], x0: np.ndarray,
    tests: np.ndarray, D: float, period: float, noise: float, seed: int, fine: int = 20,
) -> Table:  # fmt: skip
    """The same of a closed loop: each period the law of the state then, plus a test signal (K, m). By RK4 on a fine
    grid, of which the delay is a multiple.
    """
    rng, count, h = np.random.default_rng(seed), len(tests), period / fine
    late, x, X, commands = round(D / h), np.array(x0, dtype=float), [], np.empty_like(tests)
    rest = law(x)
    for k in range(count):
        commands[k] = law(x) + tests[k]
        X.append(x)
        for i in range(k * fine, (k + 1) * fine):
            past = (i - late) // fine
            u = commands[past] if past >= 0 else rest
            k1 = f(x, u)
            k2 = f(x + h / 2 * k1, u)
            k3 = f(x + h / 2 * k2, u)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3, u))
    X = np.array(X)
    return period * np.arange(count), commands, X + noise * X.std(axis=0) * rng.standard_normal(X.shape)
