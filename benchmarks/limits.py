"""Limits under delay: how often safety filters miss them, with D known and with D anywhere in an interval.

    python benchmarks/limits.py [--loops 2000] [--seed 0] [--store artifacts]

Six shipped plants, each with `safe` written for it, and starts from its box; the last row has a guarded network as
predictor, which has to be trained. For each: the loops that miss the limit without a filter, and, from the time when
the first command acts, with one. The yardstick is the filter without delay: its loop starts where the first command
meets the plant. A loop is missed where h falls below 0 by more than `BEYOND` of the limit's size. It is
- `outside`, where the yardstick misses the limit too,
- `not promised`, where the yardstick was lucky: h, or ψ = h' + alpha h of a limit that U moves by its second
  derivative, is below 0 at the first state that a command meets; the filter promises nothing there,
- a `violation` else.
`least h` is that of all promised loops. Times are of one filtered loop in the batch, per control step, against the same
loop without the filter.
"""

import argparse
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

import npred
from npred.plants import Plant
from npred.plants.builtin import activator_repressor, cart_pole, planar_arm, pvtol, transport_tank

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


class Pole(cart_pole.CartPole):
    """A track that is too short for the law. To catch the pole the cart has to go where the pole falls, so that the
    limit is on how far it must go: with the force +F for t1 and -F for t2 it stops, the pole caught.

    By the linearisation: the centre of mass moves by total q'' = F, the unstable part of the pole, xi = theta + omega /
    rate, by xi' = rate (xi - F / force), in units of the largest xi that F holds. From xi = 0 at the end follows t1,
    from v = 0 there t2. Of the largest force, 3 N, 0.1 N are spare for what is not linear.
    """

    parameters = cart_pole.CartPole.parameters | {"force": 2.9, "track": 0.6, "scale": 0.1}
    input_bounds = ((-3.0, 3.0),)

    @staticmethod
    def safe(x, t, p, M):
        """To either side, 1 - exp of the distance beyond: where that is not to be had, it asks little."""
        total, rate = p.mass_cart + p.mass, M.sqrt(p.gravity * (1 + p.mass / p.mass_cart) / p.length)
        lever, held = p.mass * p.length / total, p.force / (p.mass_cart * p.length * rate**2)

        def farthest(side):
            q, v = side * (x.p + lever * x.theta), side * (x.v + lever * x.omega)
            xi, zeta = side * (x.theta + x.omega / rate) / held, side * (x.theta - x.omega / rate) / held
            stop = v * total / p.force  # s that braking takes
            w = M.exp(-rate * stop)
            root = M.sqrt(M.maximum(1 - w * M.maximum(1 - xi, 1e-3), 1e-4))  # of w z² - 2 z + 1 = xi, z = exp(-rate t1)
            t1 = M.maximum(-M.log((1 - root) / w) / rate, 0)
            t2 = M.maximum(t1 + stop, 0)
            z1, z2 = M.exp(-rate * t1), M.exp(-rate * t2)
            zeta = zeta * z1 * z2 + (1 - z1) * z2 - (1 - z2)
            return q + v * t1 + p.force / total / 2 * (t1**2 + t2**2) - lever * held * zeta / 2

        return [1 - M.exp((farthest(side) - p.track) / p.scale) for side in (1, -1)]


@dataclass(frozen=True)
class Case:
    """A plant, its delay, how wrong D_hat may be, and the filter; size is that of h, chain the derivative of h that U
    moves.
    """

    plant: Plant
    D: float
    delay: float
    alpha: float
    t_end: float
    size: float
    dt: float = 0.01
    u0: Any = None
    chain: int = 2


CASES = (
    Case(Plant("cart", Cart), 0.3, 0.02, 3.0, 8.0, 0.25),
    Case(Plant("arm", Arm), 0.1, 0.01, 5.0, 6.0, 0.3),
    Case(Plant("tank", Tank), 2.0, 0.05, 1.0, 15.0, 4.0, 0.02, "equilibrium", 1),
    Case(Plant("aircraft", Aircraft), 0.2, 0.02, 5.0, 10.0, 0.25, u0="equilibrium"),
    Case(Plant("pole", Pole), 0.3, 0.01, 3.0, 8.0, 6.0, 0.02, chain=1),
    Case(Plant("clock", Clock), 0.3, 0.02, 2.0, 10.0, 1.0),
)
NETWORK, TOLERANCE = "pipeline/paper.toml:deeponet", 0.01


def least(loop: Any, since: Any) -> np.ndarray:
    """The least h of each loop from the time `since` on; -inf for one that was lost."""
    h = np.where(np.isnan(loop.safety), -np.inf, loop.safety).min(axis=-1)
    return np.where(loop.t >= np.asarray(since)[..., None] - 1e-9, h, np.inf).min(axis=-1)


def run(
    case: Case, D: np.ndarray, X0: np.ndarray, safety: Any, D_hat: float, predictor: Any = None
) -> tuple[Any, float]:
    """The loops, and the microseconds of a control step of one of them."""
    plant, steps = case.plant, round(case.t_end / case.dt)
    named = {"t_end": case.t_end, "dt": case.dt, "u0": case.u0, "actuator": "history", "progress": False}
    begun = time.perf_counter()
    predictor = predictor or npred.predictor("rk4", plant, 31)
    loop = npred.simulate(plant, predictor, D=D, D_hat=D_hat, X0=X0, safety=safety, **named)
    return loop, (time.perf_counter() - begun) / len(X0) / steps * 1e6


def met(case: Case, loop: Any, D: np.ndarray) -> np.ndarray:
    """The states (B, n) that the first commands meet."""
    return loop.X[np.arange(len(D)), np.ceil(D / case.dt - 1e-9).astype(int)]  # the first that is looked at


def promised(case: Case, X: np.ndarray) -> np.ndarray:
    """Whether the filter promises to keep the limits from states (B, n) on: (B,)."""
    plant, step = case.plant, 1e-6
    h = plant.safe(X)
    if case.chain == 1:
        return (h >= 0).all(axis=-1)
    along = plant.f(X, np.zeros((len(X), plant.m)))
    rate = (plant.safe(X + step * along) - plant.safe(X - step * along)) / (2 * step)
    return ((h >= 0) & (rate + case.alpha * h >= 0)).all(axis=-1)


def report(case: Case, wrong: bool, loops: int, rng: np.random.Generator, predictor: Any = None) -> str:
    """A line on the case with D known, or with D anywhere in D_hat ± delay."""
    low, high = np.array([case.plant.box[name] for name in case.plant.states]).T
    X0, D = rng.uniform(low, high, (loops, case.plant.n)), np.full(loops, case.D)
    if wrong:
        D = D + rng.uniform(-case.delay, case.delay, loops)
    safety, limit = npred.SafetyFilter(case.alpha, delay=case.delay if wrong else 0.0), -BEYOND * case.size
    run(case, D[:2], X0[:2], safety, case.D, predictor), run(case, D[:2], X0[:2], None, case.D, predictor)  # compiles
    free, plain = run(case, D, X0, None, case.D, predictor)
    kept, filtered = run(case, D, X0, safety, case.D, predictor)
    start = met(case, free, D)
    ideal, _ = run(case, np.full(loops, 1e-9), start, npred.SafetyFilter(case.alpha), 1e-9)
    missed, duty, inside = least(kept, D) < limit, least(ideal, 0.0) >= limit, promised(case, start)
    idle = ~kept.filtered.any(axis=-1)
    same = bool((kept.X[idle] == free.X[idle]).all()) if idle.any() and not wrong else None
    worst = least(kept, D)[inside].min() if inside.any() else np.nan
    return (
        f"{case.plant.name:9} {'D_hat ± ' + format(case.delay, 'g') if wrong else 'D known':13} "
        f"unfiltered {(least(free, D) < limit).sum():5} missed; filtered: outside {(missed & ~duty).sum():5}, "
        f"not promised {(missed & duty & ~inside).sum():3}, violations {(missed & duty & inside).sum():3}; "
        f"promised {inside.sum():5}, of these missed {(missed & inside).sum():3}, least h {worst:9.2e}, "
        f"unkept {(kept.unkept > 0)[inside].sum():3}, idle {idle.sum():5} (the same: {same}), "
        f"µs {plain:.2f} -> {filtered:.2f}"
    )


def main() -> None:
    """Print a line per plant and kind of delay."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--store", default="artifacts")
    asked = parser.parse_args()
    for case in CASES:
        for wrong in (False, True):
            print(report(case, wrong, asked.loops, np.random.default_rng(asked.seed)), flush=True)
    case, network = CASES[-1], npred.load(NETWORK, nx=31, store=asked.store, runtime="fused")
    network.plant = case.plant  # the same, with limits
    guarded = npred.guarded(network, TOLERANCE)
    print(f"the clock with {NETWORK}, guarded at {TOLERANCE:g}")
    for wrong in (False, True):
        print(report(case, wrong, asked.loops, np.random.default_rng(asked.seed), guarded), flush=True)


if __name__ == "__main__":
    main()
