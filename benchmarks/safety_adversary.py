"""What an adversary makes of safety filters: does a loop that starts inside the promised set break a limit?

    python benchmarks/safety_adversary.py [--plant cart] [--seconds 60] [--seed 0]

CMA-ES chooses the start in the plant's box, the true delay in D_hat ± delay (by --known it is D_hat), and the input
before t = 0 as steps of equal length, and makes the least h as small as it can, in units of the limit's size. The
plants are those of limits.py. npred says which commands its filtered loop gives, and whether its first step promises to
keep the limits, `unkept` being 0. That loop is then integrated once more by SciPy's DOP853, with the dynamics and h
written here anew. A candidate that is not promised counts by how far h is below 0 where the first command acts.
Printed are the loops, those that are promised, and the least h over the size among these.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import harness
import numpy as np
from limits import Case, cases
from scipy.integrate import solve_ivp

import npred

SIZE, GENERATIONS, WIDTH = 12, 15, 0.3  # of a population; the spread that it begins with
PIECES = 4  # of the input before t = 0
OUTSIDE = 10.0  # what a candidate outside the promised set counts at least


class System(NamedTuple):
    """f(x, u), the limits h(x), and the inputs' ranges before t = 0."""

    f: Callable[[Any, Any], list[Any]]
    h: Callable[[Any], list[Any]]
    before: Sequence[tuple[float, float]]


def arm(x: Any, u: Any) -> list[Any]:
    """Two rods of 1 kg and 0.5 m, their angles to the vertical, friction 0.1, by Cramer's rule."""
    c, s = 0.125 * np.cos(x[0] - x[1]), 0.125 * np.sin(x[0] - x[1])
    first = u[0] - u[1] - 0.1 * x[2] - s * x[3] ** 2 - 7.3575 * np.sin(x[0])
    second = u[1] - 0.1 * x[3] + s * x[2] ** 2 - 2.4525 * np.sin(x[1])
    whole = 1 / 36 - c**2
    return [x[2], x[3], (first / 12 - c * second) / whole, (second / 3 - c * first) / whole]


def tank(x: Any, u: Any) -> list[Any]:
    """The tank's level and temperature: area 2, feed 0.06 · 15 √(4 - h), outflow 0.9 √h, heat 0.5."""
    feed = 0.9 * np.sqrt(4.0 - x[0])
    return [(feed - 0.9 * np.sqrt(x[0])) / 2.0, feed * (u[0] - x[1]) / (2.0 * x[0]) + 0.5 * x[1]]


def aircraft(x: Any, u: Any) -> list[Any]:
    """The PVTOL with a coupling of 0.5."""
    sin, cos = np.sin(x[2]), np.cos(x[2])
    return [x[3], x[4], x[5], -u[0] * sin + 0.5 * u[1] * cos, u[0] * cos + 0.5 * u[1] * sin - 1, u[1]]


def pole(x: Any, u: Any) -> list[Any]:
    """A cart of 1 kg with 0.2 kg at the end of a rod of 0.4 m, by Cramer's rule on both accelerations."""
    sin, cos = np.sin(x[2]), np.cos(x[2])
    push, weight, whole = u[0] + 0.08 * x[3] ** 2 * sin, 0.08 * 9.81 * sin, 1.2 * 0.032 - (0.08 * cos) ** 2
    return [x[1], (0.032 * push - 0.08 * cos * weight) / whole, x[3], (1.2 * weight - 0.08 * cos * push) / whole]


def clock(x: Any, u: Any) -> list[Any]:
    """The activator/repressor."""
    square = x[0] ** 2
    first = u[0] - x[0] + (300.0 * square + 0.04) / (1 + square + x[1] ** 2)
    return [first, (300.0 * square + 0.004) / (1 + square) - 0.5 * x[1]]


SYSTEMS = {
    "cart": System(lambda x, u: [x[1], u[0]], lambda x: [0.25 - x[0], 0.25 + x[0]], [(-1.0, 1.0)]),
    "arm": System(arm, lambda x: [0.37 - x[0], x[0] + 0.05, 0.9 - x[1], x[1] - 0.25], [(0.0, 7.0), (-1.0, 4.0)]),
    "tank": System(tank, lambda x: [24.0 - x[1], x[1] - 16.0], [(-5.0, 15.0)]),
    "aircraft": System(aircraft, lambda x: [0.25 - x[2], 0.25 + x[2]], [(0.5, 1.5), (-0.5, 0.5)]),
    "pole": System(pole, lambda x: [0.6 - x[0], 0.6 + x[0]], [(-5.0, 5.0)]),
    "pendulum": System(
        lambda x, u: [x[1], u[0] - 9.81 * np.sin(x[0]) - 0.2 * x[1]], lambda x: [1.2 - x[1], 1.2 + x[1]], [(0.0, 15.0)]
    ),
    "cubic": System(lambda x, u: [x[0] + 1.5 * x[0] ** 3 + u[0]], lambda x: [1.0 - x[0] ** 2], [(-2.0, 2.0)]),
    "clock": System(clock, lambda x: [x[1] - 6.0], [(-0.5, 0.5)]),
}


def length(case: Case) -> float:
    """How long a piece of the input before t = 0 lasts: control steps, so many that all pieces cover D_hat + delay."""
    return case.dt * math.ceil((case.D + case.delay) / case.dt / PIECES - 1e-9)


def past(case: Case, before: np.ndarray, t: float) -> np.ndarray:
    """The input at t < 0; before (PIECES, m) are its pieces, the last one first."""
    return before[min(int(-t / length(case)), PIECES - 1)]


def replayed(case: Case, system: System, X0: np.ndarray, D: float, before: np.ndarray, U: np.ndarray) -> np.ndarray:
    """The states (k, n) at the moments when commands U (k, m) begin to act and between them, by SciPy."""
    named, x = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-11}, X0
    for i in reversed(range(PIECES)):
        span = max(D - (i + 1) * length(case), 0.0), D - i * length(case)
        if span[1] > span[0]:
            x = solve_ivp(lambda t, x, u=before[i]: system.f(x, u), span, x, **named).y[:, -1]
    states = [x]
    for u in U:
        times = np.linspace(0.0, case.dt, 3)
        path = solve_ivp(lambda t, x, u=u: system.f(x, u), (0.0, case.dt), x, t_eval=times, **named).y.T
        states.extend(path[1:])
        x = path[-1]
    return np.array(states)


def score(case: Case, system: System, z: np.ndarray) -> tuple[float, bool]:
    """The least h over the limit's size, and whether the loop starts inside the promised set; else how far outside."""
    plant, n, (least, most) = case.plant, case.plant.n, harness.box(case.plant)
    X0, delay, share = least + z[:n] * (most - least), case.D + case.delay * (2 * z[n] - 1), z[n + 1 :]
    low, high = np.array(system.before).T
    before = low + share.reshape(PIECES, -1) * (high - low)
    named = {
        "D": delay, "D_hat": case.D, "X0": X0, "dt": case.dt, "u0": lambda t: past(case, before, t),
        "actuator": "history", "safety": npred.SafetyFilter(delay=case.delay), "progress": False,
    }  # fmt: skip
    rk4 = npred.predictor(plant, "rk4", 31)
    if npred.simulate(plant, rk4, t_end=case.dt, **named).unkept:
        first = replayed(case, system, X0, delay, before, np.zeros((0, plant.m)))[0]
        return OUTSIDE - min(np.min(system.h(first)), 0.0) / case.size, False
    loop = npred.simulate(plant, rk4, t_end=case.t_end / 2, **named)
    X = replayed(case, system, X0, delay, before, loop.U)
    return min(np.min(system.h(x)) for x in X) / case.size, True


def search(case: Case, seconds: float, seed: int) -> str:
    """Populations from random centres until the time is over: a line on the worst."""
    system, rng, ends = SYSTEMS[case.plant.name.lower()], np.random.default_rng(seed), time.monotonic() + seconds
    size, loops, inside, worst = case.plant.n + 1 + PIECES * case.plant.m, 0, 0, (np.inf, np.zeros(0))

    def scores(points: list[np.ndarray]) -> list[float]:
        nonlocal loops, inside, worst
        values = [score(case, system, z) for z in points]
        loops, inside = loops + SIZE, inside + sum(counts for _, counts in values)
        for (value, counts), z in zip(values, points, strict=True):
            worst = (value, z) if counts and value < worst[0] else worst
        return [value for value, _ in values]

    while time.monotonic() < ends:
        begins = int(rng.integers(1, 2**31)), rng.uniform(0.2, 0.8, size)
        for k, stops in enumerate(harness.evolve(scores, begins[1], WIDTH, SIZE, begins[0]), start=1):
            if k == GENERATIONS or stops or time.monotonic() > ends:
                break
    least, z = worst[0], worst[1].round(6).tolist()
    return f"{case.plant.name:9} loops {loops:5}, promised {inside:5}, least h / size {least:9.2e} at {z}"


if __name__ == "__main__":
    asked = harness.options(__doc__, plant=SYSTEMS, seconds=60.0, seed=0, known=False)
    for name, case in cases().items():
        if name in asked.plant:
            case = replace(case, delay=0.0) if asked.known else case
            print(search(case, asked.seconds, asked.seed), flush=True)
