"""Recordings for benchmarks/identification.py, simulated by code that shares nothing with npred's kernels.

RK4 in plain Python between samples and arrivals of commands; only the plant's own f is npred's.
"""

import math
from bisect import bisect
from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from plants import declared
from scipy.signal import lfilter

from npred.plants.builtin.chemostat import Chemostat
from npred.plants.builtin.planar_arm import arm
from npred.plants.builtin.scalar import Scalar

M = SimpleNamespace(
    sin=math.sin, cos=math.cos, sqrt=lambda x: math.sqrt(max(x, 0.0)), exp=math.exp, abs=abs,
    where=lambda c, a, b: a if c else b, solve=lambda A, b: list(np.linalg.solve(np.array(A), np.array(b))),
)  # fmt: skip
SUBSTEPS = 3  # of RK4 in a period


Motor = declared(  # with direct current: current i, speed w, voltage v
    "Motor", "i w", "v", lambda x, u, t, p, M: [(u.v - p.R * x.i - p.k * x.w) / p.L, (p.k * x.i - p.b * x.w) / p.J],
    [(-1, 1), (-2, 2)], parameters={"L": 0.05, "R": 1.0, "k": 0.5, "J": 0.05, "b": 0.05},
)  # fmt: skip
Tank = declared(  # of the README: level h, inflow q
    "Tank", "h", "q", lambda x, u, t, p, M: [(u.q - p.outflow * M.sqrt(x.h)) / p.area], [(0.5, 2.0)],
    parameters={"area": 1.0, "outflow": 0.5},
)  # fmt: skip
Mixer = declared(  # linear, both inputs act on both states
    "Mixer", "a b", "u v", lambda x, u, t, p, M: [-x.a + p.k * u.u + p.c * u.v, -0.5 * x.b - p.c * u.u + p.k * u.v],
    [(-1, 1), (-1, 1)], parameters={"k": 1.0, "c": 0.5},
)  # fmt: skip
Unstable, Stable = type("Unstable", (Scalar,), {}), type("Stable", (Scalar,), {"parameters": {"a": -1.0, "c": 1.0}})


# How logs of a plant are made: its declaration, rest, amplitude of commands, periods, gain (m, n) of a law, laws.
Kind = namedtuple("Kind", "declaration x u amplitude periods gain laws", defaults=[("", "P")])
KINDS = {
    "scalar, unstable": Kind(Unstable, (0.0,), (0.0,), 1.0, (0.01, 0.03), ((-1.0,),), ("P",)),
    "scalar, stable": Kind(Stable, (0.0,), (0.0,), 1.0, (0.01, 0.08), ((-0.4,),)),
    "chemostat": Kind(Chemostat, (3.0, 2.0), (0.9,), 0.12, (0.01, 0.02), ((0.25, -0.17),), ("P",)),
    "planar_arm2": Kind(arm(2), (0.0,) * 4, (0.0, 0.0), 1.0, (0.004, 0.01), ((-0.3, 0, 0, 0), (0, -0.2, 0, 0))),
    "motor": Kind(Motor, (0.0, 0.0), (0.0,), 1.0, (0.004, 0.015), ((0.0, -0.2),)),
    "tank": Kind(Tank, (1.0,), (0.5,), 0.25, (0.03, 0.12), ((-0.15,),)),
    "mixer": Kind(Mixer, (0.0, 0.0), (0.0, 0.0), 1.0, (0.01, 0.06), ((-0.3, 0.0), (0.0, -0.2))),
}
MAIN = [name for name in KINDS if name != "mixer"]
RESTING = ["scalar, stable", "tank", "motor"]  # one input, at rest without a law
FREE = {  # the first five have several
    "tank": [("area", "outflow")], "motor": [("R", "k", "J"), ("L", "R"), ("k", "J", "b")], "mixer": [("k", "c")],
    "chemostat": [("a", "m"), ("a", "rho", "S_in")], "planar_arm2": [("mass", "length", "friction")],
    "scalar, stable": [("a",)], "scalar, unstable": [("a",)],
}  # fmt: skip

REPEATS = {"sine": 1, "two sines": 2, "square": 1, "PRBS": 1}  # what repeats after so many holds

# Settings of a log. (a, b) is drawn between, [a, b] one of them; lengths are in periods, sizes of what acts on
# the input in amplitudes, of what acts on samples in standard deviations of the answer.
USUAL: dict[str, Any] = {
    "N": (300, 800), "jitter": (0.0, 0.3), "noise": [0.01, 0.02, 0.05], "floor": 0.0, "amplitude": 1.0, "lead": 0,
    "shape": ["levels", "two", "sines"], "off": 0.03, "free": (), "free_off": 0.15, "longest": None, "x0": 0.0,
    "integral": (8.0, 20.0),  # times of a PI law, in longest delays
    "push": 0.0, "push_kind": "sine", "push_period": (5.0, 100.0),  # a disturbance of the input
    "resolution": 0.0, "outliers": 0.0, "missing": 0.0, "stuck": 0.0, "colour": 0.0,  # of the samples
    "later": 0.0, "share": 0.5,  # a share of the command takes a second path, that is later
    "dead": 0.0, "limit": 0.0, "lag": 0.0, "mode": 0.0, "damping": (0.1, 0.7), "friction": 0.0, "sensor": 0.0,
}  # fmt: skip
TESTED = {"amplitude": (0.3, 1.0), "push": (0.0, 0.2), "push_kind": "noise"}
UNTESTED = {"amplitude": 0.0, "floor": (0.005, 0.02), "noise": 0.0, "push_kind": "noise", "push": (0.0, 0.5)}
STILL = {"floor": 0.02, "noise": 0.0, "amplitude": 0.0, "law": "", "N": (300, 1200), "delays": (4.0, 25.0)}
MOVED = STILL | {"shape": ["two", "sines"], "amplitude": 1.0, "hold": (30.0, 60.0), "delays": 0.0}
SETS: dict[str, dict[str, dict[str, Any]]] = {
    "disturbed": {
        "a sine at the input": {"push": (0.05, 0.3)},
        "a drift at the input": {"push": (0.05, 0.3), "push_kind": "drift"},
        "noise at the input": {"push": (0.05, 0.3), "push_kind": "noise"},
        "quantised": {"resolution": (0.05, 0.5)},
        "outliers": {"outliers": (0.002, 0.03)},
        "samples missing": {"missing": (0.05, 0.4)},
        "stuck": {"stuck": (0.05, 0.2)},
        "coloured noise": {"colour": (0.7, 0.98)},
        "all, small": {"push": 0.05, "resolution": 0.05, "outliers": 0.003, "missing": 0.05, "stuck": 0.02,
                       "colour": 0.5},
    },
    "structure": {
        "half of the command later": {"later": (2.0, 20.0), "shape": ["levels", "two", "sines", "two sines"]},
        "a lag": {"lag": (2.0, 25.0)},
        "a mode": {"mode": (1.0, 8.0)},
        "a dead zone": {"dead": (0.1, 0.4)},
        "friction": {"friction": (0.1, 0.4)},
        "a sensor's lag": {"sensor": (2.0, 25.0)},
        "saturation": {"limit": (0.3, 0.7)},
        "a lag, two sines": {"lag": (2.0, 25.0), "shape": "two sines"},
    },
    "closed": {
        "P, test signal": {"law": "P"} | TESTED, "PI, test signal": {"law": "PI"} | TESTED,
        "P": {"law": "P"} | UNTESTED, "PI": {"law": "PI"} | UNTESTED,
    },
    "periodic": {shape: {"shape": shape, "hold": (8.0, 40.0), "lead": [0, 200]} for shape in REPEATS},
    "silent": {
        "rest": STILL | {"off": 0.0},
        "constant": STILL | {"x0": 0.4},
        "drift": STILL | {"shape": "ramp", "amplitude": 0.1},
        "lag, no delay": MOVED | {"lag": (2.0, 12.0)},
        "no test signal": STILL | {"law": "P"},
        "small": STILL | {"shape": "step", "amplitude": 0.003},
        "beyond": MOVED | {"shape": "two", "hold": 15.0, "delays": (20.0, 40.0), "longest": 15.0},
    },
}  # fmt: skip
WITHIN = {"disturbed": MAIN, "closed": ["scalar, unstable", "scalar, stable", "chemostat", "tank", "motor"],
          "silent": [*RESTING, "mixer"]}  # fmt: skip


@dataclass(frozen=True)
class Sample:
    """A log t (N,), U (N, m), X (N, n), in the plant's unit of time, and the truth, computed by what made it.

    D (m, 2) is the range of true delays: [D, D + later + lags], one point without them, where a mode counts by its
    longest phase delay; `longest` where D is beyond it. A periodic input repeats after `repeats` (inf: never).
    """

    kind: str
    why: str
    t: np.ndarray
    U: np.ndarray
    X: np.ndarray
    D: np.ndarray
    parameters: dict[str, float]
    period: float
    repeats: float
    unit: str
    about: dict[str, Any]


def signal(rng: np.random.Generator, shape: str, N: int, m: int, hold: float) -> np.ndarray:
    """Commands (N, m) within ±1: random levels, two levels, sums of sines, a ramp, a step, or what repeats."""
    k = np.arange(N)[:, None]
    if shape == "sines":
        rates, phases = 2 * np.pi / (hold * rng.uniform(1.5, 8, (5, m))), rng.uniform(0, 7, (5, m))
        return np.sin(rates * k[:, None] + phases).sum(axis=1) / 3
    if shape in ("sine", "two sines", "square"):
        angle = 2 * np.pi * k / hold + rng.uniform(0, 7, m)
        wave = np.sin(angle) if shape != "two sines" else (np.sin(angle) + np.sin(1.5 * angle + 1)) / 2
        return np.sign(wave) if shape == "square" else wave
    if shape in ("ramp", "step"):
        return np.ones(m) * (k / (N - 1) if shape == "ramp" else k >= N // 2)
    if shape == "PRBS":
        return np.resize(np.repeat(rng.choice([-1.0, 1.0], (int(hold) // 2, m)), 2, axis=0), (N, m))  # chips of 2 rows
    columns = []
    for _ in range(m):
        ends = np.cumsum(np.maximum(rng.exponential(hold, N), 2).astype(int))
        levels = rng.uniform(-1, 1, N) if shape == "levels" else rng.choice([-1.0, 1.0], N)
        columns.append(levels[np.searchsorted(ends, k[:, 0], side="right")])
    return np.stack(columns, axis=1)


def simulate(
    kind: Kind, s: SimpleNamespace, t: np.ndarray, command: np.ndarray, D: np.ndarray, p: dict[str, float],
    noise: np.ndarray, push: Callable[[float], Any],
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Commands (N, m) and outputs without noise (N, n); a law reads outputs with the noise (N, n) on them.

    From command to output: paths with delays D (2, m), dead zone, saturation, lag, mode, disturbance and friction at
    the input, f, the sensor's lag; each only if the settings s ask for it.
    """
    plant, K, x0, rest = kind.declaration, np.array(kind.gain, dtype=float), np.array(kind.x), np.array(kind.u)
    state, inputs, parameters = namedtuple("x", plant.states), namedtuple("u", plant.inputs), SimpleNamespace(**p)
    n, m, N, one = len(x0), len(rest), len(t), kind.amplitude
    low = 0.0 if plant in (Chemostat, Tank) else -math.inf
    lag, mode, sensor = (length * s.period for length in (s.lag, s.mode, s.sensor))

    def rate(z: np.ndarray, u: np.ndarray, time: float) -> np.ndarray:
        x, behind, q, v, y = np.split(z, ends) if more else (z, u, u, u, z)
        moved = behind if lag else u
        felt = (q if mode else moved) + push(time)
        if s.friction:
            felt = felt - s.friction * one * np.tanh((x - x0)[n - m :] / (0.05 * one))
        dx = np.array(plant.f(state(*x.tolist()), inputs(*felt.tolist()), time, parameters, M), dtype=float)
        if not more:
            return dx
        bent = (moved - q) / mode**2 - 2 * s.damping * v / mode if mode else 0 * u
        return np.concatenate([dx, (u - behind) / (lag or 1.0), v, bent, (x - y) / (sensor or 1.0)])

    x, more, ends = x0 + s.x0 * one, bool(lag or mode or sensor), np.cumsum([n, m, m, m])
    z, total = np.concatenate([x, rest, rest, 0 * rest, x]) if more else x, np.zeros(n)
    U, Y, now, times, step = np.empty((N, m)), np.empty((N, n)), float(t[0]), t.tolist(), s.period / SUBSTEPS
    for k in range(N):
        Y[k] = z[-n:] if sensor else z[:n]
        error = Y[k] + noise[k] - x0
        total += error * s.period / (s.integral * D.max()) if s.law == "PI" else 0.0
        U[k] = np.maximum(rest + command[k] + (K @ (error + total) if s.law else 0.0), low)
        until = times[min(k + 1, N - 1)]
        arrivals = {times[i] + d for d in {*D.flat} for i in range(bisect(times, now - d), bisect(times, until - d))}
        for stop in sorted(time for time in {until, *arrivals} if now < time <= until):
            last = np.searchsorted(t, (now + stop) / 2 - D, side="right") - 1  # (2, m)
            paths = np.where(last < 0, rest, np.take_along_axis(U, last, axis=0)) - rest
            u = paths[0] + s.share * (paths[1] - paths[0])
            u = np.sign(u) * np.maximum(abs(u) - s.dead * one, 0)
            u = rest + (np.clip(u, -s.limit * one, s.limit * one) if s.limit else u)
            count = math.ceil((stop - now) / step)
            h = (stop - now) / count
            for time in now + h * np.arange(count):
                a = rate(z, u, time)
                b = rate(z + h / 2 * a, u, time + h / 2)
                c = rate(z + h / 2 * b, u, time + h / 2)
                z = z + h / 6 * (a + 2 * b + 2 * c + rate(z + h * c, u, time + h))
            now = stop
    return U, Y


def drawn(rng: np.random.Generator, setting: Any) -> Any:
    """A setting's value: see USUAL."""
    if isinstance(setting, list):
        return setting[rng.integers(len(setting))]
    if not isinstance(setting, tuple) or not setting or isinstance(setting[0], str):
        return setting
    return int(rng.integers(*setting)) if isinstance(setting[0], int) else rng.uniform(*setting)


def excited(name: str, rng: np.random.Generator, why: str = "", unit: str = "s", **fixed: Any) -> Sample:
    """A log of the plant `name` by the settings `fixed` and USUAL."""
    kind = KINDS[name]
    m, n, one, plant = len(kind.u), len(kind.x), kind.amplitude, kind.declaration
    drafts = USUAL | {"period": kind.periods, "law": list(kind.laws), "delays": (2.0, 25.0)} | fixed
    s = SimpleNamespace(**{key: drawn(rng, v) for key, v in drafts.items() if key != "delays"})
    s.hold = drawn(rng, s.hold) if "hold" in drafts else float(np.exp(rng.uniform(np.log(5), np.log(50))))
    N, T = s.N + s.lead, s.period
    t = (np.arange(N) + rng.uniform(-s.jitter, s.jitter, N)) * T
    first = np.array([drawn(rng, drafts["delays"]) for _ in range(m)])
    D = np.stack([first, first + s.later]) * T
    off = {key: s.free_off if key in s.free else s.off for key in plant.parameters}
    p = {key: v * (1 + rng.uniform(-off[key], off[key])) for key, v in plant.parameters.items()}
    command = one * s.amplitude * signal(rng, s.shape, N, m, s.hold)
    white = np.asarray(lfilter([(1 - s.colour**2) ** 0.5], [1, -s.colour], rng.standard_normal((N, n)), axis=0))
    phase, size = rng.uniform(0, 7, m), s.push * one
    knots = np.arange(0.0, N + s.push_period, s.push_period) * T
    walk = rng.standard_normal((m, len(knots)))
    push = {
        "sine": lambda time: size * np.sin(2 * np.pi / (s.push_period * T) * time + phase),
        "drift": lambda time: size * np.ones(m) * (2 * time / t[-1] - 1),
        "noise": lambda time: size * np.array([np.interp(time, knots, w) for w in walk]),
    }[s.push_kind] if size else lambda time: 0.0  # fmt: skip
    U, X = simulate(kind, s, t, command, D, p, 0 * white, push)
    noise = np.hypot(s.noise * X.std(axis=0), s.floor * one) * white
    if s.law:
        U, X = simulate(kind, s, t, command, D, p, noise, push)
    Y, spread = X + noise, X.std(axis=0)
    Y = np.round(Y / (s.resolution * spread)) * s.resolution * spread if s.resolution else Y
    wild = rng.random((N, n)) < s.outliers
    Y[wild] += (rng.choice([-1, 1], (N, n)) * rng.uniform(10, 100, (N, n)) * spread)[wild]
    begin = int(rng.uniform(0.2, 0.9 - s.stuck) * N)
    Y[begin : begin + int(s.stuck * N)] = Y[begin]
    Y[rng.random(N) < s.missing] = np.nan
    w = np.linspace(0.01, 3, 300)
    bent = s.mode * (np.arctan2(2 * s.damping * w, 1 - w**2) / w).max()
    truth = np.minimum(np.stack([D[0], D[1] + (s.lag + s.sensor + bent) * T], axis=1), (s.longest or np.inf) * T)
    s.hold = int(s.hold) // 2 * 2.0 if s.shape == "PRBS" else s.hold
    t, U, Y, repeats = t[s.lead :], U[s.lead :], Y[s.lead :], REPEATS.get(s.shape, np.inf) * s.hold * T
    return Sample(name, why or name, t, U, Y, truth, p, T, repeats, unit, vars(s))


def log_of(what: str, k: int) -> Sample:
    """Log k of a set, always the same; half of those that are disturbed, wrong or closed have free parameters."""
    rng, chance = np.random.default_rng([*what.encode(), k]), np.random.default_rng(k)
    if what == "clean":
        return excited(MAIN[k % len(MAIN)], np.random.default_rng([18, k]), N=(300, 1500))
    if what == "parameters":
        name, unit = list(FREE)[k % 5], ("s", "min", "h")[k // 5 % 3]
        return excited(name, rng, f"{name}, {unit}", unit, free=drawn(chance, FREE[name]))
    kinds, names = SETS[what], WITHIN.get(what, RESTING)
    why, name = list(kinds)[k % len(kinds)], names[k // len(kinds) % len(names)]
    free = drawn(chance, FREE[name]) if what in ("disturbed", "structure", "closed") and chance.random() < 0.5 else ()
    return excited(name, rng, why, free=free, **kinds[why])
