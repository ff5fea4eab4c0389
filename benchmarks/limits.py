"""Limits under delay: how often safety filters miss them, with D known and with D anywhere in an interval.

    python benchmarks/limits.py [--loops 2000] [--seed 0]

Five shipped plants, each with `safe` written for it, and starts from its box. For each: the least h of the loop without
a filter, and, from the time when the first command acts, of the loop with one. The yardstick is the filter without
delay: its loop starts where the first command meets the plant. A loop is a violation where h falls below 0 by more than
`BEYOND` of the limit's size although the yardstick keeps it. `outside` are starts from which the filter has no duty:
where the first command meets the plant, the yardstick misses the limit too.
A start may count as a duty although a ψ of its limit's chain is below 0 there: the yardstick was lucky, and the filter
promises nothing. Of the arm's violations with seed 0 and a wrong D_hat all are such.
Times are of one filtered loop in the batch, per control step, against the same loop without the filter.
"""

import argparse
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

import npred
from npred.plants import Plant
from npred.plants.builtin import activator_repressor, planar_arm, pvtol, transport_tank

BEYOND = 1e-3  # of a limit's size: what counts as missed


class Cart:
    """A mass that the law sends to 5 cm before the end of its track, with an overshoot."""

    states, inputs, parameters = ("p", "v"), ("F",), {"end": 0.25, "stiffness": 4.0, "damping": 1.2}
    box, input_bounds = {"p": (-0.2, 0.2), "v": (-0.3, 0.3)}, ((-5.0, 5.0),)

    @staticmethod
    def f(x, u, t, p, M):
        """A double integrator."""
        return [x.v, u.F]

    @staticmethod
    def kappa(x, t, p, M):
        """Proportional and derivative."""
        return [-p.stiffness * (x.p - p.end + 0.05) - p.damping * x.v]

    @staticmethod
    def safe(x, t, p, M):
        """Both ends of the track."""
        return [p.end - x.p, p.end + x.p]


class Arm(planar_arm.arm(2)):
    """A stop at each side of both angles; the reference needs 0.03 rad more than the first angle has."""

    @staticmethod
    def safe(x, t, p, M):
        """The joints' stops."""
        return [0.37 - x.theta1, x.theta1 + 0.05, 0.9 - x.theta2, x.theta2 - 0.25]


class Tank(transport_tank.TransportTank):
    """The temperature, with a set point that is half a kelvin too hot; no input moves the level. One delay."""

    delay = None
    parameters = transport_tank.TransportTank.parameters | {"T_set": 24.5}
    guess = (2.0, 24.5)

    @staticmethod
    def safe(x, t, p, M):
        """From 16 to 24 K."""
        return [24.0 - x.T, x.T - 16.0]


class Aircraft(pvtol.PVTOL):
    """The roll angle's limit."""

    @staticmethod
    def safe(x, t, p, M):
        """To either side."""
        return [0.25 - x.theta, 0.25 + x.theta]


class Clock(activator_repressor.ActivatorRepressor):
    """The repressor x2, which falls from the box to its set point, kept above a floor that rises above it."""

    @staticmethod
    def safe(x, t, p, M):
        """Above 6, the set point being at 5.25."""
        return [x.x2 - 6.0]


@dataclass(frozen=True)
class Case:
    """A plant, its delay, how wrong D_hat may be, and the filter; size is that of h."""

    plant: Plant
    D: float
    delay: float
    alpha: float
    t_end: float
    size: float
    dt: float = 0.01
    u0: Any = None


CASES = (
    Case(Plant("cart", Cart), 0.3, 0.02, 3.0, 8.0, 0.25),
    Case(Plant("arm", Arm), 0.1, 0.01, 5.0, 6.0, 0.3),
    Case(Plant("tank", Tank), 2.0, 0.05, 1.0, 15.0, 4.0, 0.02, "equilibrium"),
    Case(Plant("aircraft", Aircraft), 0.2, 0.02, 5.0, 10.0, 0.25, u0="equilibrium"),
    Case(Plant("clock", Clock), 0.3, 0.02, 2.0, 10.0, 1.0),
)


def least(loop: Any, since: Any) -> np.ndarray:
    """The least h of each loop from the time `since` on; -inf for one that was lost."""
    h = np.where(np.isnan(loop.safety), -np.inf, loop.safety).min(axis=-1)
    return np.where(loop.t >= np.asarray(since)[..., None] - 1e-9, h, np.inf).min(axis=-1)


def run(case: Case, D: np.ndarray, X0: np.ndarray, safety: Any, D_hat: float) -> tuple[Any, float]:
    """The loops, and the microseconds of a control step of one of them."""
    plant, steps = case.plant, round(case.t_end / case.dt)
    named = {"t_end": case.t_end, "dt": case.dt, "u0": case.u0, "actuator": "history", "progress": False}
    predictor = npred.predictor("rk4", plant, 31)
    begun = time.perf_counter()
    loop = npred.simulate(plant, predictor, D=D, D_hat=D_hat, X0=X0, safety=safety, **named)
    return loop, (time.perf_counter() - begun) / len(X0) / steps * 1e6


def met(case: Case, loop: Any, D: np.ndarray) -> np.ndarray:
    """The states (B, n) that the first commands meet."""
    return loop.X[np.arange(len(D)), np.rint(D / case.dt).astype(int)]


def report(case: Case, wrong: bool, loops: int, rng: np.random.Generator) -> str:
    """A line on the case with D known, or with D anywhere in D_hat ± delay."""
    low, high = np.array([case.plant.box[name] for name in case.plant.states]).T
    X0, D = rng.uniform(low, high, (loops, case.plant.n)), np.full(loops, case.D)
    if wrong:
        D = D + rng.uniform(-case.delay, case.delay, loops)
    safety = npred.SafetyFilter(case.alpha, delay=case.delay if wrong else 0.0)
    run(case, D[:2], X0[:2], safety, case.D), run(case, D[:2], X0[:2], None, case.D)  # compiles
    free, plain = run(case, D, X0, None, case.D)
    kept, filtered = run(case, D, X0, safety, case.D)
    ideal, _ = run(case, np.full(loops, 1e-9), met(case, free, D), npred.SafetyFilter(case.alpha), 1e-9)
    missed, duty = least(kept, D) < -BEYOND * case.size, least(ideal, 0.0) >= -BEYOND * case.size
    idle = ~kept.filtered.any(axis=-1)
    same = bool((kept.X[idle] == free.X[idle]).all()) if idle.any() and not wrong else None
    worst = least(kept, D)[duty].min() if duty.any() else np.nan
    return (
        f"{case.plant.name:9} {'D_hat ± ' + format(case.delay, 'g') if wrong else 'D known':13} "
        f"unfiltered {(least(free, D) < -BEYOND * case.size).sum():5} missed, outside {(~duty).sum():5}, "
        f"violations {(missed & duty).sum():5}, least h {worst:9.2e}, unkept {(kept.unkept > 0).sum():5}, "
        f"idle {idle.sum():5} (the same: {same}), µs {plain:.2f} -> {filtered:.2f}"
    )


def main() -> None:
    """Print a line per plant and kind of delay."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    for case in CASES:
        for wrong in (False, True):
            print(report(case, wrong, asked.loops, np.random.default_rng(asked.seed)), flush=True)


if __name__ == "__main__":
    main()
