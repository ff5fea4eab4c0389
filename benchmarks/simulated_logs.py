"""Recordings for benchmarks/identification.py, simulated by code that shares nothing with npred's kernels.

RK4 in plain Python between samples and arrivals of commands; only the plant's own f is npred's.
"""

import math
from collections import namedtuple
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from npred.plants.builtin.chemostat import Chemostat
from npred.plants.builtin.planar_arm import arm
from npred.plants.builtin.scalar import Scalar

M = SimpleNamespace(
    sin=math.sin, cos=math.cos, sqrt=lambda x: math.sqrt(max(x, 0.0)), exp=math.exp, abs=abs,
    where=lambda c, a, b: a if c else b, solve=lambda A, b: list(np.linalg.solve(np.array(A), np.array(b))),
)  # fmt: skip
SUBSTEPS = 3  # of RK4 in a period
HISTORY = 5.0  # longest delays before the log's first row, in which the input rests


class Motor:
    """A direct-current motor: current i, speed w, voltage v."""

    states = ("i", "w")
    inputs = ("v",)
    parameters = {"L": 0.05, "R": 1.0, "k": 0.5, "J": 0.05, "b": 0.05}
    box = {"i": (-1.0, 1.0), "w": (-2.0, 2.0)}
    guess = (0.0, 0.0)

    @staticmethod
    def f(x, u, t, p, M):
        return [(u.v - p.R * x.i - p.k * x.w) / p.L, (p.k * x.i - p.b * x.w) / p.J]

    @staticmethod
    def kappa(x, t, p, M):
        return [-0.5 * x.w]


class Tank:
    """The tank of the README: level h, inflow q."""

    states = ("h",)
    inputs = ("q",)
    parameters = {"area": 1.0, "outflow": 0.5}
    box = {"h": (0.5, 2.0)}
    guess = (1.0,)

    @staticmethod
    def f(x, u, t, p, M):
        return [(u.q - p.outflow * M.sqrt(x.h)) / p.area]

    @staticmethod
    def kappa(x, t, p, M):
        return [0.5 - 0.5 * (x.h - 1.0)]


class Mixer:
    """A linear plant whose two inputs act on both states."""

    states = ("a", "b")
    inputs = ("u", "v")
    parameters = {"k": 1.0, "c": 0.5}
    box = {"a": (-1.0, 1.0), "b": (-1.0, 1.0)}
    guess = (0.0, 0.0)

    @staticmethod
    def f(x, u, t, p, M):
        return [-x.a + p.k * u.u + p.c * u.v, -0.5 * x.b - p.c * u.u + p.k * u.v]

    @staticmethod
    def kappa(x, t, p, M):
        return [-0.3 * x.a, -0.3 * x.b]


class Unstable(Scalar):
    """The scalar plant."""


class Stable(Scalar):
    """The scalar plant with another sign."""

    parameters = {"a": -1.0, "c": 1.0}


@dataclass(frozen=True)
class Kind:
    """How logs of a plant are made: its declaration, rest, amplitude of commands, periods, gain (m, n), loops."""

    declaration: Any
    x: tuple[float, ...]
    u: tuple[float, ...]
    amplitude: float
    periods: tuple[float, float]
    gain: tuple[tuple[float, ...], ...]
    loops: tuple[str, ...] = ("open", "closed")


KINDS = {
    "scalar, unstable": Kind(Unstable, (0.0,), (0.0,), 1.0, (0.01, 0.03), ((-1.0,),), ("closed",)),
    "scalar, stable": Kind(Stable, (0.0,), (0.0,), 1.0, (0.01, 0.08), ((-0.4,),)),
    "chemostat": Kind(Chemostat, (3.0, 2.0), (0.9,), 0.25, (0.01, 0.02), ((0.3, 0.5),), ("closed",)),
    "planar_arm2": Kind(arm(2), (0.0,) * 4, (0.0, 0.0), 1.0, (0.004, 0.01), ((-0.3, 0, 0, 0), (0, -0.2, 0, 0))),
    "motor": Kind(Motor, (0.0, 0.0), (0.0,), 1.0, (0.004, 0.015), ((0.0, -0.2),)),
    "tank": Kind(Tank, (1.0,), (0.5,), 0.25, (0.03, 0.12), ((-0.15,),)),
    "mixer": Kind(Mixer, (0.0, 0.0), (0.0, 0.0), 1.0, (0.01, 0.06), ((-0.3, 0.0), (0.0, -0.2))),
}


@dataclass(frozen=True)
class Sample:
    """A log t (N,), U (N, m), X (N, n) with its true delays D (m,) and its settings."""

    kind: str
    t: np.ndarray
    U: np.ndarray
    X: np.ndarray
    D: np.ndarray
    period: float
    about: dict[str, Any]


def signal(rng: np.random.Generator, shape: str, N: int, m: int, hold: float) -> np.ndarray:
    """Test signals (N, m) within ±1: random levels, two levels, or a sum of sines."""
    k = np.arange(N)
    if shape == "sines":
        rates, phases = 2 * np.pi / (hold * rng.uniform(1.5, 8, (5, m))), rng.uniform(0, 7, (5, m))
        return np.sin(rates * k[:, None, None] + phases).sum(axis=1) / 3
    columns = []
    for _ in range(m):
        ends = np.cumsum(np.maximum(rng.exponential(hold, N), 2).astype(int))
        levels = rng.uniform(-1, 1, N) if shape == "levels" else rng.choice([-1.0, 1.0], N)
        columns.append(levels[np.searchsorted(ends, k, side="right")])
    return np.stack(columns, axis=1)


def simulate(
    kind: Kind, t: np.ndarray, command: np.ndarray, D: np.ndarray, p: dict[str, float], noise: np.ndarray,
    gain: float = 0.0, law: Any = None, x0: Any = None, lag: float = 0.0, disturbance: Any = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Commands (N, m) and states without noise (N, n); the law reads measured states, with the noise (N, n) on them.

    The plant's input is what arrives, through a first-order lag where `lag` > 0, with a disturbance(t) added.
    """
    made = kind.declaration
    state, inputs = namedtuple("x", made.states), namedtuple("u", made.inputs)
    parameters, K, rest = SimpleNamespace(**p), gain * np.array(kind.gain, dtype=float), np.array(kind.u)
    n, m, N = len(made.states), len(made.inputs), len(t)
    low = 0.0 if made in (Chemostat, Tank) else -math.inf

    def rate(z: np.ndarray, u: np.ndarray, s: float) -> np.ndarray:
        felt = z[n:] if lag else u
        felt = felt if disturbance is None else felt + disturbance(s)
        dx = made.f(state(*z[:n].tolist()), inputs(*felt.tolist()), s, parameters, M)
        return np.concatenate([np.array(dx, dtype=float), (u - z[n:]) / lag if lag else np.zeros(m)])

    z = np.append(np.array(kind.x if x0 is None else x0, dtype=float), rest)
    U, X, now, step = np.empty((N, m)), np.empty((N, n)), float(t[0]), float(np.median(np.diff(t))) / SUBSTEPS
    current, waiting, done = rest.copy(), [[] for _ in range(m)], [0] * m
    for k in range(N):
        while True:
            pending = [(waiting[j][done[j]], j) for j in range(m) if done[j] < len(waiting[j])]
            (end, value), j = min(pending, key=lambda a: a[0][0]) if pending else ((math.inf, 0.0), 0)
            stop = min(end, float(t[k]))
            count = math.ceil((stop - now) / step)
            for _ in range(count):
                h = (stop - now) / count if count else 0.0
                a = rate(z, current, now)
                b = rate(z + h / 2 * a, current, now + h / 2)
                c = rate(z + h / 2 * b, current, now + h / 2)
                d = rate(z + h * c, current, now + h)
                z = z + h / 6 * (a + 2 * b + 2 * c + d)
                now, count = now + h, count - 1
            now = stop
            if end > t[k]:
                break
            current[j], done[j] = value, done[j] + 1
        X[k] = z[:n]
        U[k] = np.maximum(rest + command[k] + K @ (X[k] + noise[k] - np.array(kind.x)), low)
        for j in range(m):
            if not waiting[j] or waiting[j][-1][1] != U[k, j]:
                waiting[j].append((t[k] + D[j], U[k, j]))
    return U, X


def stamps(rng: np.random.Generator, N: int, period: float, jitter: float) -> np.ndarray:
    """Times (N,), each off by up to `jitter` periods."""
    return (np.arange(N) + rng.uniform(-jitter, jitter, N)) * period


def off(rng: np.random.Generator, declaration: type, share: float) -> dict[str, float]:
    """The declaration's parameters, each off by up to this share of it."""
    return {name: value * (1 + rng.uniform(-share, share)) for name, value in declaration.parameters.items()}


def excited(name: str, rng: np.random.Generator, **fixed: Any) -> Sample:
    """A log that tells, of the ranges that the benchmark names."""
    kind = KINDS[name]
    m, n = len(kind.u), len(kind.x)
    s = {
        "N": int(rng.integers(300, 1501)), "period": rng.uniform(*kind.periods), "jitter": rng.uniform(0, 0.3),
        "noise": rng.choice([0.01, 0.02, 0.05]), "hold": float(np.exp(rng.uniform(np.log(5), np.log(50)))),
        "shape": rng.choice(["levels", "two", "sines"]), "loop": rng.choice(kind.loops), "amplitude": 1.0,
        "off": 0.03, "disturbance": 0.0, "resolution": 0.0, "delays": rng.uniform(2, 25, m),
    } | fixed  # fmt: skip
    t = stamps(rng, s["N"], s["period"], s["jitter"])
    D, p = np.broadcast_to(s["delays"], m) * s["period"], off(rng, kind.declaration, s["off"])
    command = kind.amplitude * s["amplitude"] * signal(rng, s["shape"], s["N"], m, s["hold"])
    white, phase, gain = rng.standard_normal((s["N"], n)), rng.uniform(0, 7, m), float(s["loop"] == "closed")
    size, rate = s["disturbance"] * kind.amplitude, 2 * np.pi / (30 * s["period"])
    push = (lambda time: size * np.sin(rate * time + phase)) if size else None
    U, X = simulate(kind, t, command, D, p, 0 * white, gain, disturbance=push)
    noise = s["noise"] * X.std(axis=0) * white
    if gain:
        U, X = simulate(kind, t, command, D, p, noise, gain, disturbance=push)
    Y, step = X + noise, s["resolution"] * X.std(axis=0)
    return Sample(name, t, U, np.round(Y / step) * step if s["resolution"] else Y, D, s["period"], s)


def silent(k: int, rng: np.random.Generator) -> Sample:
    """Log k of those that cannot tell: the seven kinds of WHY in turn, over the plants that rest."""
    why, name = WHY[k % len(WHY)], ("scalar, stable", "tank", "motor", "mixer")[k // len(WHY) % 4]
    kind, N, period = KINDS[name], int(rng.integers(300, 1201)), 0.0
    period = rng.uniform(*kind.periods)
    m, n, t = len(kind.u), len(kind.x), stamps(rng, N, period, rng.uniform(0, 0.3))
    D, p = rng.uniform(4, 25, m) * period, off(rng, kind.declaration, 0.03 if why != "rest" else 0.0)
    noise = 0.02 * kind.amplitude * rng.standard_normal((N, n))
    command, gain, more = np.zeros((N, m)), 0.0, {}
    about: dict[str, Any] = {"why": why, "longest": None}
    if why == "constant":
        more["x0"] = np.array(kind.x) + 0.4 * kind.amplitude * rng.uniform(-1, 1, n)
    elif why == "drift":
        command = 0.1 * kind.amplitude * np.linspace(0, 1, N)[:, None] * np.ones(m)
    elif why == "lag":
        sharp = rng.random() < 0.5
        command = kind.amplitude * signal(rng, "two" if sharp else "sines", N, m, 30 if sharp else 60)
        more["lag"], about["lag"] = float(D[0] / 2), float(D[0] / 2)
        D = np.zeros(m)
    elif why == "closed":
        gain = 1.0
    elif why == "small":
        command[N // 2 :] = 0.003 * kind.amplitude
    elif why == "beyond":
        command = kind.amplitude * signal(rng, "two", N, m, 15)
        about["longest"], D = 15 * period, np.full(m, rng.uniform(20, 40) * period)
    U, X = simulate(kind, t, command, D, p, noise, gain, **more)
    return Sample(name, t, U, X + noise, D, period, about)


WHY = ("rest", "constant", "drift", "lag", "closed", "small", "beyond")
