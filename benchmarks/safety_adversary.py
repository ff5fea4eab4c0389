"""What an adversary makes of safety filters: does a loop that starts inside the promised set break a limit?

    python benchmarks/safety_adversary.py [--plant cart] [--seconds 60] [--seed 0]

CMA-ES chooses the start in the plant's box, the true delay in D_hat ± delay (that of the pole is D_hat), and the input
before t = 0 as steps of equal length, and makes the least h as small as it can, in units of the limit's size. The
plants and filters are those of limits.py. npred says only which commands its filtered loop gives. That loop is then
integrated once more by SciPy's DOP853, with the dynamics, h and the set that the filter promises to keep, h >= 0 and
h' + alpha h >= 0 where the first command acts, written here anew. A candidate outside that set counts by how far it is
outside.
Printed are the loops, those inside the set, and the least h over the size among these.
"""

import argparse
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import cma
import numpy as np
from limits import CASES, Case
from scipy.integrate import solve_ivp

import npred

SIZE, GENERATIONS, WIDTH = 12, 15, 0.3  # of a population; the spread that it begins with
PIECES = 4  # of the input before t = 0
OUTSIDE = 10.0  # what a candidate outside the promised set counts at least


class System(NamedTuple):
    """f(x, u), the limits h(x), their rates h'(x), or None where U moves these, and the inputs' ranges before t = 0."""

    f: Callable[[Any, Any], list[Any]]
    h: Callable[[Any], list[Any]]
    rates: Callable[[Any], list[Any]] | None
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
    """A cart of 1 kg with 0.1 kg at the end of a rod of 1 m: p'' cos θ + θ'' = 9.81 sin θ."""
    sin, cos = np.sin(x[2]), np.cos(x[2])
    acceleration = (u[0] + 0.1 * x[3] ** 2 * sin - 0.981 * sin * cos) / (1.1 - 0.1 * cos**2)
    return [x[1], acceleration, x[3], 9.81 * sin - acceleration * cos]


def track(x: Any) -> list[Any]:
    """1 - exp of how far beyond 0.6 m, in 0.1 m, the cart has to go to catch the pole, with 2.9 N, to either side."""
    rate, held, h = math.sqrt(10.791), 2.9 / 10.791, []
    for side in (1, -1):
        p, v, theta, omega = side * np.asarray(x)
        centre, speed = p + theta / 11, v + omega / 11
        falls, decays = (theta + omega / rate) / held, (theta - omega / rate) / held
        brake = speed * 1.1 / 2.9
        share = math.exp(rate * brake)
        root = math.sqrt(max(1 - max(1 - falls, 1e-3) / share, 1e-4))
        push = max(-math.log(share * (1 - root)) / rate, 0.0)
        brake = max(push + brake, 0.0)
        pushed, braked = math.exp(-rate * push), math.exp(-rate * brake)
        decays = (decays * pushed + 1 - pushed) * braked - 1 + braked
        centre += speed * push + 2.9 / 2.2 * (push**2 + brake**2)
        h.append(1 - math.exp((centre - held * decays / 22 - 0.6) / 0.1))
    return h


def clock(x: Any, u: Any) -> list[Any]:
    """The activator/repressor."""
    square = x[0] ** 2
    first = u[0] - x[0] + (300.0 * square + 0.04) / (1 + square + x[1] ** 2)
    return [first, (300.0 * square + 0.004) / (1 + square) - 0.5 * x[1]]


SYSTEMS = {
    "cart": System(
        lambda x, u: [x[1], u[0]], lambda x: [0.25 - x[0], 0.25 + x[0]], lambda x: [-x[1], x[1]], [(-1.0, 1.0)]
    ),
    "arm": System(
        arm,
        lambda x: [0.37 - x[0], x[0] + 0.05, 0.9 - x[1], x[1] - 0.25],
        lambda x: [-x[2], x[2], -x[3], x[3]],
        [(0.0, 7.0), (-1.0, 4.0)],
    ),
    "tank": System(tank, lambda x: [24.0 - x[1], x[1] - 16.0], None, [(-5.0, 15.0)]),
    "aircraft": System(
        aircraft, lambda x: [0.25 - x[2], 0.25 + x[2]], lambda x: [-x[5], x[5]], [(0.5, 1.5), (-0.5, 0.5)]
    ),
    "pole": System(pole, track, None, [(-3.0, 3.0)]),
    "clock": System(clock, lambda x: [x[1] - 6.0], lambda x: [clock(x, [0.0])[1]], [(-0.5, 0.5)]),
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
    plant, n = case.plant, case.plant.n
    box = np.array([plant.box[name] for name in plant.states])
    X0, delay, share = box[:, 0] + z[:n] * np.ptp(box, axis=1), case.D + case.delay * (2 * z[n] - 1), z[n + 1 :]
    low, high = np.array(system.before).T
    before = low + share.reshape(PIECES, -1) * (high - low)
    first = replayed(case, system, X0, delay, before, np.zeros((0, plant.m)))[0]
    h = np.array(system.h(first))
    chain = h if system.rates is None else np.append(h, np.array(system.rates(first)) / case.alpha + h)
    if chain.min() < 0:
        return OUTSIDE - chain.min() / case.size, False
    loop = npred.simulate(
        plant, npred.predictor("rk4", plant, 31), D=delay, D_hat=case.D, X0=X0, t_end=case.t_end / 2, dt=case.dt,
        u0=lambda t: past(case, before, t), actuator="history",
        safety=npred.SafetyFilter(case.alpha, delay=case.delay), progress=False,
    )  # fmt: skip
    X = replayed(case, system, X0, delay, before, loop.U)
    return min(np.min(system.h(x)) for x in X) / case.size, True


def search(case: Case, seconds: float, seed: int) -> str:
    """Populations from random centres until the time is over: a line on the worst."""
    system, rng, ends = SYSTEMS[case.plant.name], np.random.default_rng(seed), time.monotonic() + seconds
    size, loops, inside, worst = case.plant.n + 1 + PIECES * case.plant.m, 0, 0, (np.inf, np.zeros(0))
    while time.monotonic() < ends:
        settings = {"bounds": [0, 1], "popsize": SIZE, "seed": int(rng.integers(1, 2**31)), "verbose": -9}
        evolution = cma.CMAEvolutionStrategy(rng.uniform(0.2, 0.8, size), WIDTH, settings)
        for _ in range(GENERATIONS):
            points = evolution.ask()
            values = [score(case, system, z) for z in points]
            evolution.tell(points, [value for value, _ in values])
            loops, inside = loops + SIZE, inside + sum(counts for _, counts in values)
            for (value, counts), z in zip(values, points, strict=True):
                worst = (value, z) if counts and value < worst[0] else worst
            if time.monotonic() > ends or evolution.stop():
                break
    least, z = worst[0], worst[1].round(3)
    return f"{case.plant.name:9} loops {loops:5}, promised {inside:5}, least h / size {least:9.2e} at {z}"


def main() -> None:
    """Print a line per plant."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plant", choices=SYSTEMS, default=None)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for case in CASES:
        if options.plant in (None, case.plant.name):
            case = replace(case, delay=0.0) if case.plant.name == "pole" else case  # its limit needs D
            print(search(case, options.seconds, options.seed), flush=True)


if __name__ == "__main__":
    main()
