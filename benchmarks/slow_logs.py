"""What `npred.identify` says of slow logs, beside a fit by SciPy over the whole log that shares no code with npred.

    python benchmarks/slow_logs.py [referee] [longest] [--logs 30] [--only 17] [--jobs 2]

A log of a heater, a room or a tank has eight edges, and time constants up to half its length. `referee`: the parameters
that the referee knows, to 5 % with 95 %, and how many of npred's lie within 5 % of them; a row is enough for a delay.
`longest`: the answers with longest delays of 10 to 90 rows, where these are longer than the delay: the intervals of
each two should overlap.
"""

import multiprocessing
import time
import warnings
from collections.abc import Callable
from itertools import combinations
from typing import Any, NamedTuple

import harness
import numpy as np
from scipy.optimize import least_squares

from npred import plants
from npred.identification.identify import identify

LONGEST = 10, 20, 30, 40, 60, 90  # rows
COUNTS = {"referee": 30, "longest": 20}
WITHIN, ROW = 0.05, 1.0
EDGES = 8


class Lag:
    """One lag, a heater's."""

    states, inputs = ("y",), ("u",)
    parameters = {"K": 0.5, "tau": 150.0, "y0": 23.0}
    box, guess = {"y": (20.0, 60.0)}, (40.0,)

    @staticmethod
    def f(x, u, t, p, M):
        return [(p.K * u.u + p.y0 - x.y) / p.tau]

    @staticmethod
    def kappa(x, t, p, M):
        return [(40.0 - p.y0) / p.K]


class Lags(Lag):
    """Two lags: a heater and its sensor, a room and its walls."""

    states = ("y", "b")
    parameters = {"K": 0.5, "tau": 150.0, "tau2": 15.0, "y0": 23.0}
    box, guess = {"y": (20.0, 60.0), "b": (20.0, 60.0)}, (40.0, 40.0)

    @staticmethod
    def f(x, u, t, p, M):
        return [(x.b - x.y) / p.tau2, (p.K * u.u + p.y0 - x.b) / p.tau]


class Tank(Lag):
    """A level over an outlet, and an inflow."""

    parameters = {"K": 0.05, "c": 1.0}
    box, guess = {"y": (0.5, 30.0)}, (10.0,)

    @staticmethod
    def f(x, u, t, p, M):
        return [p.K * u.u - p.c * M.sqrt(M.maximum(x.y, 1e-9))]

    @staticmethod
    def kappa(x, t, p, M):
        return [p.c * M.sqrt(10.0) / p.K]


class Made(NamedTuple):
    """Rows y (N,) each `period`, edges (E,) with levels (E,), the truth, and a user's first values."""

    kind: type[Lag]
    period: float
    y: np.ndarray
    edges: np.ndarray
    levels: np.ndarray
    truth: dict[str, float]
    first: dict[str, float]


def response(kind: type[Lag], z: np.ndarray, N: int, T: float, edges: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """y (N,) with z = delay, parameters, first states: lags by their formulas, the tank by RK4 between edges."""
    D, p, x = z[0], z[1 : 1 + len(kind.parameters)], z[1 + len(kind.parameters) :]
    t, y = T * np.arange(N), np.empty(N)
    ends = np.append(edges[1:] + D, np.inf)
    now = 0.0
    for level, end in zip(levels, ends, strict=True):
        rows = np.flatnonzero((t >= now) & (t < end))
        stop = min(end, t[-1])
        if stop < now:
            continue
        s = np.append(t[rows], stop) - now
        if kind is Tank:
            moved, x = tank(p, level, float(x[0]), s)
        else:
            rest = p[0] * level + p[-1]
            a = rest + (x[-1] - rest) * np.exp(-s / p[1])
            moved = a
            if kind is Lags:
                gain = p[1] / (p[1] - p[2] * (1 + 1e-9))
                moved = rest + (x[-1] - rest) * gain * np.exp(-s / p[1])
                moved = moved + (x[0] - rest - (x[-1] - rest) * gain) * np.exp(-s / p[2])
            x = np.array([moved[-1], a[-1]] if kind is Lags else [a[-1]])
        y[rows] = moved[:-1]
        now = stop if end < t[-1] else np.inf
    return y


def tank(p: np.ndarray, level: float, x: float, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Levels at times s after the begin, and the last one."""

    def f(x: float) -> float:
        return p[0] * level - p[1] * max(x, 1e-9) ** 0.5

    moved = []
    for h in np.diff(s, prepend=0.0).tolist():
        a = f(x)
        b = f(x + h / 2 * a)
        c = f(x + h / 2 * b)
        x += h / 6 * (a + 2 * b + 2 * c + f(x + h * c))
        moved.append(x)
    return np.array(moved), np.array([x])


def made(k: int) -> Made:
    """Log k, always the same."""
    rng, kind = np.random.default_rng([32, k]), (Lag, Lags, Tank)[k % 3]
    N, T = int(rng.choice([300, 600, 900, 1500])), float(rng.choice([1.0, 5.0, 60.0]))
    span, D = N * T, rng.uniform(0.0, 0.06) * N * T
    tau, levels = np.exp(rng.uniform(np.log(0.05), np.log(0.5))) * span, rng.uniform(0, 100, EDGES + 1)
    while np.abs(np.diff(levels)).min() < 15:
        levels = rng.uniform(0, 100, EDGES + 1)
    edges = np.append(0.0, np.sort(rng.choice(np.arange(N // 40, N - N // 10), EDGES, replace=False)) * T)
    if kind is Tank:  # by its time constant at y = 10
        c = 2 * 10**0.5 / tau
        p, x = {"K": c * 10**0.5 / 60, "c": c}, [rng.uniform(2, 15)]
    else:
        p = {"K": rng.uniform(0.3, 0.9), "tau": tau, "tau2": tau * rng.uniform(0.05, 0.3), "y0": rng.uniform(18, 26)}
        p, x = {name: p[name] for name in kind.parameters}, [p["y0"] + rng.uniform(0, 15)] * len(kind.states)
    y = response(kind, np.array([D, *p.values(), *x]), N, T, edges, levels)
    y = y + rng.uniform(0.003, 0.02) * y.std() * rng.standard_normal(N)
    first = {name: value * np.exp(rng.uniform(-0.5, 0.5)) for name, value in p.items()}
    return Made(kind, T, np.round(y, 1 if k % 4 == 0 else 6), edges, levels, {"D": D, **p}, first)


def refereed(log: Made, most: float) -> dict[str, tuple[float, float]]:
    """Value and deviation of each parameter and of the delay, by least squares from several delays."""
    names, n, N = list(log.kind.parameters), len(log.kind.states), len(log.y)

    def residuals(z: np.ndarray) -> np.ndarray:
        y = response(log.kind, np.append(z[0] * log.period, z[1:]), N, log.period, log.edges, log.levels)
        return np.nan_to_num(y - log.y, nan=1e6)

    low = np.array([0.0, *(1e-9 if name != "y0" else -np.inf for name in names), *[-np.inf] * n])
    high = np.array([most / log.period, *[np.inf] * (len(names) + n)])
    best: Any = None
    for share in np.linspace(0.02, 0.95, 3 if log.kind is Tank else 8):
        z = np.array([share * high[0], *(log.first[name] for name in names), *[log.y[0]] * n])
        scale = np.array([3.0, *(abs(log.first[name]) for name in names), *[np.ptp(log.y)] * n])
        got = least_squares(residuals, z, bounds=(low, high), x_scale=scale, diff_step=1e-4, max_nfev=60)
        best = got if best is None or got.cost < best.cost else best
    best = least_squares(residuals, best.x, bounds=(low, high), x_scale=scale, diff_step=1e-5, xtol=1e-12)
    size = np.sqrt(2 * best.cost / (N - len(best.x)))
    covariance = np.linalg.pinv(best.jac.T @ best.jac) * size**2
    z, deviation = best.x, np.sqrt(np.diag(covariance))
    z[0], deviation[0] = z[0] * log.period, deviation[0] * log.period
    return {name: (float(z[k]), float(deviation[k])) for k, name in enumerate(["D", *names])}


def ours(log: Made, longest: float | None) -> Any:
    """`npred.identify`'s answer, of arrays, from the user's first values."""
    plant = plants.make(log.kind.__name__, type(log.kind.__name__, (log.kind,), {"parameters": log.first}))
    t = log.period * np.arange(len(log.y))
    U = log.levels[np.searchsorted(log.edges, t, side="right") - 1]
    X = np.column_stack([log.y, *[np.full(len(t), np.nan)] * (plant.n - 1)])
    return identify(plant, t, U, X, free=list(log.first), longest=longest)


def beside(k: int) -> tuple[int, int, str]:
    """How many parameters of log k the referee knows, how many of these npred has within 5 %, and words."""
    warnings.simplefilter("ignore")
    log, begin = made(k), time.perf_counter()
    span = log.period * len(log.y)
    answer: Any = None
    error = ""
    try:
        answer = ours(log, None)
    except Exception as wrong:  # it is printed
        error = f"{type(wrong).__name__}: {wrong}"
    seconds = time.perf_counter() - begin
    good, known, words = 0, 0, []
    for name, (value, deviation) in refereed(log, span / 5).items():
        room = max(WITHIN * abs(value), ROW * log.period if name == "D" else 0.0)
        if 1.96 * deviation > room:
            continue
        known += 1
        found = answer and (answer.D[0] if name == "D" else answer.parameters.get(name))
        ends: Any = None if found is None else answer.interval[0] if name == "D" else answer.parameter_intervals[name]
        doubt = "" if found is None or name != "D" or answer.identifiable[0] else " uncertain"
        good += (near := found is not None and abs(found - value) <= room)
        said = "none" if found is None else f"{found:.4g} [{ends[0]:.4g}, {ends[1]:.4g}]{doubt}"
        words.append(f"{'' if near else 'OFF '}{name} {value:.4g} ± {1.96 * deviation:.2g}: {said}")
    return known, good, f"{k} {log.kind.__name__} {len(log.y)} rows, {seconds:.1f} s: {'; '.join(words)}{error}"


def over(k: int) -> tuple[int, int, str]:
    """Pairs of longest delays with log k, how many have intervals that overlap, and words."""
    warnings.simplefilter("ignore")
    log = made(k)
    rows, words = [], [f"{k} {log.kind.__name__}, {log.truth['D'] / log.period:.1f} rows late"]
    for longest in np.array(LONGEST) * log.period:
        try:
            answer = ours(log, longest)
            ends = {} if answer.refused else {"D": answer.interval[0], **answer.parameter_intervals}
        except Exception:  # one that says that the log is too short
            ends = {}
        said = ", ".join(f"{name} [{low:.4g}, {high:.4g}]" for name, (low, high) in ends.items())
        words.append(f"{longest / log.period:.0f}: {said or 'refused'}")
        rows += [ends] if longest > log.truth["D"] else []
    overlap = [
        bool(one) and all(max(one[n][0], other[n][0]) <= min(one[n][1], other[n][1]) for n in other) and bool(other)
        for one, other in combinations(rows, 2)
    ]
    return len(overlap), sum(overlap), "\n    ".join(words)


if __name__ == "__main__":
    asked = harness.options(__doc__, {"what": COUNTS}, logs=1000, only=[int], jobs=1)
    ways: dict[str, Callable[[int], tuple[int, int, str]]] = {"referee": beside, "longest": over}
    with multiprocessing.Pool(asked.jobs) as pool:
        for what in (name for name in COUNTS if name in asked.what):
            chosen, counts = asked.only or range(min(COUNTS[what], asked.logs)), []
            for asked_for, good, words in (pool.imap if asked.jobs > 1 else map)(ways[what], chosen):
                counts.append((asked_for, good))
                print(f"{'' if asked_for == good else 'OFF '}{words}", flush=True)
            every, good = np.sum(counts, axis=0)
            print(f"{what}: {sum(a == b for a, b in counts)} of {len(counts)} logs, {good} of {every} cases")
