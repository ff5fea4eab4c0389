"""The loop of the same article: Z' = A Z + B U(φ1(t)), measured as Y = C Z(φ2(t)), an observer and a predictor.

arXiv:2603.29117. The observer's ξ stands for Z(φ2(t)); Ẑ carries it on to t, P to ρ(t) = φ1⁻¹(t), and U = K P.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from npred_experiments.experiment import Experiment, Measured, Measurements, PublishedNumber
from npred_experiments.horizons import DT, T, draws, inverse, late, rate

A, B = np.array([[0.0, 1.0], [2.0, 1.0]]), np.array([0.0, 1.0])
C, K, L = np.array([1.0, -1.0]), np.array([-4.0, -4.0]), np.array([-4.0, -8.0])
BEFORE, GUESS = np.array([-1.0, 1.0]), np.array([5.0, -5.0])  # Z before t = 0, and ξ(0)
NODES = 40  # nodes of both integrals
STEPS = round(T / DT)


class Signals(NamedTuple):
    """Z (N, 2), U (N,) and the horizon ρ(t) - t (N,) at steps of 1 ms."""

    Z: np.ndarray
    U: np.ndarray
    horizon: np.ndarray


def flow(s: Any) -> np.ndarray:
    """e^(A s), (..., 2, 2): the eigenvalues of A are 2 and -1."""
    s = np.asarray(s)[..., None, None]
    return (np.exp(2 * s) * (A + np.eye(2)) - np.exp(-s) * (A - 2 * np.eye(2))) / 3


def driven(s: np.ndarray) -> np.ndarray:
    """e^(A s) B, (..., 2)."""
    fast, slow = np.exp(2 * s) / 3, np.exp(-s) / 3
    return np.stack([fast - slow, 2 * fast + slow], axis=-1)


def published_loop(dt: float = DT, nodes: int = NODES) -> Signals:
    """The loop as coded: both integrals by the trapezoidal rule on 40 nodes, the last command held within a step."""
    first, second = draws()
    steps = round(T / dt)
    t = np.arange(steps + 1) * dt
    grid = np.arange(int(np.floor(late(first, 0.0) / dt)), steps + 2) * dt
    table = inverse(first, grid)
    horizon = np.interp(t, grid, table) - t
    Z, U, xi = np.empty((steps + 1, 2)), np.zeros(steps + 1), GUESS
    Z[0] = BEFORE
    for k in range(steps + 1):
        now, issued = t[k], max(k, 1)
        begin, source = late(second, now), late(first, now)
        tau = np.linspace(begin, now, nodes)
        arrived = np.interp(late(first, tau), t[:issued], U[:issued], left=0.0)
        Z_hat = flow(now - begin) @ xi + _trapezoid(driven(now - tau) * arrived[:, None], now - begin)
        theta = np.linspace(source, now, nodes)
        sent, arrival = np.interp(theta, t[:issued], U[:issued], left=0.0), np.interp(theta, grid, table)
        weights = (sent / rate(first, arrival))[:, None]
        P = flow(horizon[k]) @ Z_hat + _trapezoid(driven(now + horizon[k] - arrival) * weights, now - source)
        U[k] = K @ P if source >= 0 else 0.0
        if k == steps:
            break
        Y = C @ _past(t[: k + 1], Z[: k + 1], begin)

        def plant(s: float, Z: np.ndarray, k: int = k) -> np.ndarray:
            return A @ Z + B * np.interp(late(first, s), t[: k + 1], U[: k + 1], left=0.0)

        def observer(s: float, xi: np.ndarray, k: int = k, Y: Any = Y) -> np.ndarray:
            command = np.interp(late(first, late(second, s)), t[: k + 1], U[: k + 1], left=0.0)
            return rate(second, s) * (A @ xi + B * command + L * (Y - C @ xi))

        Z[k + 1], xi = _rk4(plant, now, Z[k], dt), _rk4(observer, now, xi, dt)
    return Signals(Z, U, horizon)


def _trapezoid(values: np.ndarray, length: float) -> np.ndarray:
    """∫ of values (., 2) at equal distances on an interval of that length."""
    return length / (len(values) - 1) * (values.sum(axis=0) - 0.5 * (values[0] + values[-1]))


def _past(t: np.ndarray, Z: np.ndarray, at: float) -> np.ndarray:
    return np.array([np.interp(at, t, Z[:, i], left=BEFORE[i]) for i in range(2)])


def _rk4(rate: Callable[[float, np.ndarray], np.ndarray], t: float, x: np.ndarray, dt: float) -> np.ndarray:
    a = rate(t, x)
    b = rate(t + dt / 2, x + dt / 2 * a)
    c = rate(t + dt / 2, x + dt / 2 * b)
    return x + dt / 6 * (a + 2 * b + 2 * c + rate(t + dt, x + dt * c))


def error(t: np.ndarray) -> np.ndarray:
    """Z(φ2(t)) - ξ(t), (., 2), once φ2(t) >= 0: from there on it decays by e^((A - L C) φ2(t)), whatever is sent.

    Up to φ2(t) = 0 what is measured stands still at Z(0), and ξ follows dξ/dφ2 = A ξ + L C (Z(0) - ξ).
    """
    second = draws()[1]
    rest = np.linalg.solve(A - np.outer(L, C), -L * (C @ BEFORE))
    xi = rest + _decay(-late(second, np.zeros(1)))[0] @ (GUESS - rest)
    return _decay(late(second, t)) @ (BEFORE - xi)


def _decay(s: np.ndarray) -> np.ndarray:
    """e^((A - L C) s), (., 2, 2): its eigenvalues are -1 and -2."""
    s, observed = np.asarray(s)[..., None, None], A - np.outer(L, C)
    return np.exp(-s) * (observed + 2 * np.eye(2)) - np.exp(-2 * s) * (observed + np.eye(2))


def astray(t: np.ndarray) -> np.ndarray:
    """K (Z(ρ(t)) - P(t)): the effect of the observer's error on the command, carried from φ2(t) to ρ(t)."""
    first, second = draws()
    return ((flow(inverse(first, t) - late(second, t)) @ error(t)[..., None])[..., 0]) @ K


def first_arrival() -> float:
    """ρ(t) for φ1(t) = 0: when the first command acts."""
    first = draws()[0]
    return float(inverse(first, inverse(first, np.zeros(1)))[0])


def meant(end: float = T, steps: int = STEPS) -> Signals:
    """The loop with exact integrals and commands sent continuously from the first on, φ1(t) = 0; Z at the times ρ(t).

    P(t) is Z(ρ(t)) but for the observer's error, so in the time s = ρ(t) at which commands act there is no delay left:
    Z' = (A + B K) Z - B astray(φ1(s)). Before that Z = e^(A s) Z(0).
    """
    first = draws()[0]
    begin = first_arrival()
    s = np.linspace(begin, end, 2 * steps + 1)
    t = late(first, s)
    pushed, closed, step = astray(t), A + np.outer(B, K), s[2] - s[0]
    Z = np.empty((steps + 1, 2))
    Z[0] = flow(begin) @ BEFORE
    for k in range(steps):
        x, (now, middle, after) = Z[k], pushed[2 * k : 2 * k + 3]
        a = closed @ x - B * now
        b = closed @ (x + step / 2 * a) - B * middle
        c = closed @ (x + step / 2 * b) - B * middle
        Z[k + 1] = x + step / 6 * (a + 2 * b + 2 * c + closed @ (x + step * c) - B * after)
    return Signals(Z, Z @ K - pushed[::2], (s - t)[::2])


def exact() -> dict[str, float]:
    """The rows of the loop as meant: commands up to 12 s act until ρ(12), the state is read up to 12 s."""
    first = draws()[0]
    states, commands = meant(), meant(float(inverse(first, np.array([T]))[0]))
    drift = flow(np.linspace(0.0, first_arrival(), STEPS)) @ BEFORE
    t = np.linspace(0.0, T, STEPS + 1)
    U = np.concatenate([[0.0], commands.U])
    return rows(Signals(np.concatenate([drift, states.Z]), U, inverse(first, t) - t))


def rows(loop: Signals) -> dict[str, float]:
    """The ranges that the article's figure shows, and where the state ends."""
    series = {"Z1": loop.Z[:, 0], "Z2": loop.Z[:, 1], "U": loop.U, "ρ(t) - t": loop.horizon}
    ends = {f"{which} {name}": float(of(values)) for name, values in series.items() for which, of in ENDS.items()}
    return ends | {"Z1(12)": float(loop.Z[-1, 0]), "Z2(12)": float(loop.Z[-1, 1])}


ENDS: dict[str, Callable[[np.ndarray], Any]] = {"lowest": np.min, "highest": np.max}
ROWS = [f"{which} {name}" for name in ("Z1", "Z2", "U", "ρ(t) - t") for which in ENDS] + ["Z1(12)", "Z2(12)"]


def measure() -> Measurements:
    """The ranges and the end of both loops."""
    coded, right = rows(published_loop()), exact()
    return {row: Measured(coded[row], right[row]) for row in ROWS}


EXPERIMENT = Experiment(
    "linear plant with delays that vary in time, and an observer",
    "Bhan, Krstic, Shi, arXiv:2603.29117",
    tuple(PublishedNumber(row, "") for row in ROWS),
    measure,
)
