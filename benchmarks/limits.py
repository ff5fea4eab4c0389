"""Limits under delay: what a safety filter costs loops that are well without it, and how often it misses a limit.

    python benchmarks/limits.py [pole cart …] [--loops 2000] [--seed 0] [--wrong] [--rival] [--store artifacts]

Loops of plants with `safe` start in their boxes with D known, or, by --wrong, with D anywhere in D_hat ± delay. All is
counted from the time when the first command acts. A loop is at rest where it ends within 2 % of the box of the target.
- `inside`: the loops that keep the limits without the filter; with it, the share that keeps them, that is at rest as
  without, and whose U is the same to the bit.
- `outside`: the others; how many of them the filter keeps and brings to rest, and, by --rival, of those that an optimal
  control problem of 3 s can keep and bring to rest, from the state that the first command meets (CasADi, IPOPT).
- `promised`: those in whose first step the filter finds a plan, so that `unkept` is 0; the least h of these over its
  size, and the violations, loops with h < 0.
Times are of one filtered loop in the batch, per control step, against the same loop without the filter. The last row
has a guarded network as predictor, which has to be trained.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import npred
from npred.plants import Plant
from npred.plants.builtin import activator_repressor, cart_pole, planar_arm, pvtol, transport_tank

REST = 0.02  # of half a box: how near to its target a loop is at rest
ROUNDING = 1e-9  # of the size of h


class Pole(cart_pole.CartPole):
    """A pole on a cart, whose track alone is limited: no limit knows the pole."""

    parameters = cart_pole.CartPole.parameters | {"mass": 0.2, "length": 0.4, "end": 0.6}
    box = {"p": (-0.5, 0.5), "v": (-0.2, 0.2), "theta": (-0.15, 0.15), "omega": (-0.2, 0.2)}
    input_bounds = ((-25.0, 25.0),)

    @staticmethod
    def safe(x, t, p, M):
        """Both ends of the track."""
        return [p.end - x.p, p.end + x.p]


class Pendulum:
    """A pendulum that hangs, is sent to 1.5 rad, and must not turn faster than 1.2 rad/s."""

    states, inputs = ("theta", "omega"), ("torque",)
    box, input_bounds = {"theta": (-0.5, 2.0), "omega": (-1.0, 1.0)}, ((-15.0, 15.0),)
    guess = (1.5, 0.0)

    @staticmethod
    def f(x, u, t, p, M):
        """1 kg at 1 m, with friction."""
        return [x.omega, u.torque - 9.81 * M.sin(x.theta) - 0.2 * x.omega]

    @staticmethod
    def kappa(x, t, p, M):
        """The weight, and a spring with a damper."""
        return [9.81 * M.sin(x.theta) - 6.0 * (x.theta - 1.5) - 3.0 * x.omega]

    @staticmethod
    def safe(x, t, p, M):
        """The rate to either side."""
        return [1.2 - x.omega, 1.2 + x.omega]


class Drone(pvtol.PVTOL):
    """The height above the ground, which is 0.5 below where it goes; some starts fall."""

    box = pvtol.PVTOL.box | {"y": (-0.4, 0.5), "vy": (-1.0, 1.0)}
    input_bounds = ((0.0, 2.5), (-2.0, 2.0))

    @staticmethod
    def safe(x, t, p, M):
        """The ground."""
        return [x.y + 0.5]


class Elbow(planar_arm.arm(2)):
    """A stop of the second joint alone."""

    input_bounds = ((-20.0, 20.0), (-10.0, 10.0))

    @staticmethod
    def safe(x, t, p, M):
        """The elbow's stops."""
        return [0.85 - x.theta2, x.theta2 - 0.2]


class Series:
    """Two tanks, one flowing into the other, whose level must stay below 0.57 m on the way to 0.55 m."""

    states, inputs = ("h1", "h2"), ("q",)
    box, input_bounds = {"h1": (0.2, 0.8), "h2": (0.2, 0.55)}, ((0.0, 1.2),)
    guess = (0.55, 0.55)

    @staticmethod
    def f(x, u, t, p, M):
        """Torricelli's outflows."""
        first, second = M.sqrt(M.maximum(x.h1, 1e-3)), M.sqrt(M.maximum(x.h2, 1e-3))
        return [u.q - 0.6 * first, 0.6 * first - 0.6 * second]

    @staticmethod
    def kappa(x, t, p, M):
        """Proportional in both levels."""
        return [0.6 * 0.55**0.5 - 1.0 * (x.h1 - 0.55) - 4.0 * (x.h2 - 0.55)]

    @staticmethod
    def safe(x, t, p, M):
        """The second tank's rim."""
        return [0.57 - x.h2]


class Lane:
    """A car at 20 m/s that changes to the middle of its lane: offset y, heading psi, steering angle delta."""

    states, inputs = ("y", "psi", "delta"), ("steer",)
    box, input_bounds = {"y": (-1.0, 1.0), "psi": (-0.08, 0.08), "delta": (-0.01, 0.01)}, ((-0.06, 0.06),)

    @staticmethod
    def f(x, u, t, p, M):
        """A bicycle of 2.7 m, its steering a lag of 0.1 s."""
        return [20.0 * M.sin(x.psi), 20.0 / 2.7 * M.tan(x.delta), (u.steer - x.delta) / 0.1]

    @staticmethod
    def kappa(x, t, p, M):
        """Linear."""
        return [-0.01 * x.y - 0.25 * x.psi - 0.3 * x.delta]

    @staticmethod
    def safe(x, t, p, M):
        """The lane's lines."""
        return [1.2 - x.y, 1.2 + x.y]


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


class Cubic:
    """x' = x + 1.5 x³ + u without bounds of u: between two nodes the prediction grows by whole factors."""

    states, inputs, box = ("x",), ("u",), {"x": (-0.5, 0.5)}

    @staticmethod
    def f(x, u, t, p, M):
        """Unstable, the more the farther out."""
        return [x.x + 1.5 * x.x**3 + u.u]

    @staticmethod
    def kappa(x, t, p, M):
        """To 0.9, at a rate of 4."""
        return [-x.x - 1.5 * x.x**3 - 4.0 * (x.x - 0.9)]

    @staticmethod
    def safe(x, t, p, M):
        """To either side."""
        return [1.0 - x.x**2]


@dataclass(frozen=True)
class Case:
    """A plant, its delay, how wrong D_hat may be; size is that of h."""

    plant: Plant
    D: float
    delay: float
    t_end: float
    size: float
    dt: float = 0.01
    u0: Any = None


def cases() -> dict[str, Case]:
    """The cases by the name of their plant: six with limits of a part of the state, then the others."""
    every = (
        Case(npred.plant(Pole, kappa="lqr"), 0.12, 0.005, 20.0, 0.6, 0.005),
        Case(npred.plant(Pendulum), 0.1, 0.005, 8.0, 1.2),
        Case(npred.plant(Drone), 0.2, 0.01, 20.0, 0.45, u0="equilibrium"),
        Case(npred.plant(Elbow), 0.1, 0.005, 8.0, 0.3),
        Case(npred.plant(Series), 0.5, 0.02, 25.0, 0.1, 0.02, "equilibrium"),
        Case(npred.plant(Lane), 0.15, 0.01, 8.0, 1.2),
        Case(npred.plant(Cart), 0.3, 0.02, 8.0, 0.25),
        Case(npred.plant(Arm), 0.1, 0.01, 6.0, 0.3),
        Case(npred.plant(Tank), 2.0, 0.05, 15.0, 4.0, 0.02, "equilibrium"),
        Case(npred.plant(Aircraft), 0.2, 0.02, 10.0, 0.25, u0="equilibrium"),
        Case(npred.plant(Clock), 0.3, 0.02, 10.0, 1.0),
        Case(npred.plant(Cubic), 0.6, 0.01, 6.0, 1.0),
    )
    return {case.plant.name.lower(): case for case in every}


NETWORK, TOLERANCE = "pipeline/paper.toml:deeponet", 0.01


def run(
    case: Case, D: np.ndarray, X0: np.ndarray, safety: Any, predictor: Any = None, t_end: float | None = None
) -> tuple[Any, float]:
    """The loops, and the microseconds of a control step of one of them."""
    plant, steps = case.plant, round((t_end or case.t_end) / case.dt)
    named = {"t_end": t_end or case.t_end, "dt": case.dt, "u0": case.u0, "actuator": "history", "progress": False}
    begun = time.perf_counter()
    predictor = predictor or npred.predictor(plant, "rk4", 31)
    loop = npred.simulate(plant, predictor, D=D, D_hat=case.D, X0=X0, safety=safety, **named)
    return loop, (time.perf_counter() - begun) / len(X0) / steps * 1e6


def least(loop: Any, since: Any) -> np.ndarray:
    """The least h of each loop from the time `since` on; -inf for one that was lost."""
    h = np.where(np.isnan(loop.safety), -np.inf, loop.safety).min(axis=-1)
    return np.where(loop.t >= np.asarray(since)[..., None] - 1e-9, h, np.inf).min(axis=-1)


def rests(case: Case, loop: Any) -> np.ndarray:
    """Whether each loop ends near the target (B,)."""
    target = case.plant.target(loop.t[-1])
    half = np.ptp(np.array([case.plant.box[name] for name in case.plant.states]), axis=-1) / 2
    return (np.abs(np.nan_to_num(loop.X[:, -1], nan=np.inf) - target) <= REST * half).all(axis=-1)


def starts(case: Case, loops: int, rng: np.random.Generator) -> np.ndarray:
    """States of the box (B, n)."""
    low, high = np.array([case.plant.box[name] for name in case.plant.states]).T
    return rng.uniform(low, high, (loops, case.plant.n))


def report(
    case: Case, wrong: bool, loops: int, rng: np.random.Generator, predictor: Any = None,
    rival: Callable[[Case, np.ndarray], np.ndarray] | None = None,
) -> str:  # fmt: skip
    """A line on the case with D known, or with D anywhere in D_hat ± delay."""
    X0, D = starts(case, loops, rng), np.full(loops, case.D)
    if wrong:
        D = D + rng.uniform(-case.delay, case.delay, loops)
    safety = npred.SafetyFilter(delay=case.delay if wrong else 0.0)
    promised = run(case, D, X0, safety, predictor, case.dt)[0].unkept == 0  # compiles, too
    run(case, D[:2], X0[:2], None, predictor, case.dt)
    free, plain = run(case, D, X0, None, predictor)
    kept, filtered = run(case, D, X0, safety, predictor)
    h_free, h, rest_free, rest = least(free, D), least(kept, D), rests(case, free), rests(case, kept)
    inside, keeps = h_free >= 0, h >= -ROUNDING * case.size
    same, well = (kept.U == free.U).all(axis=(-2, -1)), keeps & (rest | ~rest_free)
    outside, where = ~inside, "D_hat ± " + format(case.delay, "g") if wrong else "D known"
    line = (
        f"{case.plant.name:9} {where:13} inside {inside.sum()}: as without {well[inside].mean():.2%}, "
        f"U the same {same[inside].mean():.2%}; outside {outside.sum()}: kept {(keeps & outside).sum()}, and at rest "
        f"{(keeps & rest & outside).sum()}, at rest {(rest & outside).sum()} (without {(rest_free & outside).sum()}); "
        f"promised {promised.sum()}: violations {(promised & ~keeps).sum()}, "
        f"least h {h[promised].min(initial=np.inf) / case.size:.1e}, unkept {(promised & (kept.unkept > 0)).sum()}; "
        f"µs {plain:.2f} -> {filtered:.2f}"
    )
    if rival is None:
        return line
    met = free.X[np.arange(loops), np.ceil(D / case.dt - 1e-9).astype(int)]
    hard = np.flatnonzero(outside & (case.plant.safe(met) >= 0).all(axis=-1))
    can = hard[rival(case, met[hard])]
    shares = f"{keeps[can].mean():.1%}, and at rest {(keeps & rest)[can].mean():.1%}"
    return f"{line}; of {len(hard)} that are in the limits at first the rival keeps {len(can)}, of these kept {shares}"


class OfCasadi:
    """What `M` offers a plant, on CasADi's expressions."""

    names = {"maximum": "fmax", "minimum": "fmin", "abs": "fabs"}

    def __getattr__(self, name: str) -> Any:
        import casadi as ca

        return getattr(ca, self.names.get(name, name))

    @staticmethod
    def solve(A: Any, b: Any) -> list[Any]:
        """The y of A y = b."""
        import casadi as ca

        return ca.vertsplit(ca.solve(ca.vertcat(*(ca.horzcat(*row) for row in A)), ca.vertcat(*b)))


def optimal(case: Case, X: np.ndarray) -> np.ndarray:
    """Whether states (B, n) can be kept for 3 s and brought to the target: by multiple shooting and IPOPT."""
    import casadi as ca

    plant, h, M, seconds = case.plant, 2 * case.dt, OfCasadi(), max(3.0, case.t_end / 4)
    h = max(h, seconds / 200)
    steps, t = round(seconds / h), ca.SX.sym("t")
    x, u = ca.SX.sym("x", plant.n), ca.SX.sym("u", plant.m)

    def f(x: Any) -> Any:
        return ca.vertcat(*plant.call("f", ca.vertsplit(x), ca.vertsplit(u), t, plant.p, M))

    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    following = ca.Function("following", [x, u, t], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3))])
    safe = ca.Function("safe", [x, t], [ca.vertcat(*plant.call("safe", ca.vertsplit(x), None, t, plant.p, M))])
    problem = ca.Opti()
    states, inputs, missed = problem.variable(plant.n, steps + 1), problem.variable(plant.m, steps), problem.variable()
    start = problem.parameter(plant.n)
    times = case.D + h * np.arange(steps + 1)
    goal = np.broadcast_to(plant.target(times), (steps + 1, plant.n))
    half = np.ptp(np.array([plant.box[name] for name in plant.states]), axis=-1) / 2
    bounds = npred.plants.inputs.widest(plant, npred.plants.inputs.bounds(plant, None))
    problem.subject_to(states[:, 0] == start)
    problem.subject_to(missed >= 0)
    cost = 1e3 * missed
    for k in range(steps):
        problem.subject_to(states[:, k + 1] == following(states[:, k], inputs[:, k], times[k]))
        problem.subject_to(safe(states[:, k + 1], times[k + 1]) / case.size >= -missed)
        for c, (low, high) in enumerate(bounds):
            problem.subject_to(problem.bounded(low, inputs[c, k], high))
        cost += 1e-3 * ca.sumsqr((states[:, k + 1] - goal[k + 1]) / half) * h
    problem.subject_to(problem.bounded(-0.2, (states[:, steps] - goal[-1]) / half, 0.2))
    problem.minimize(cost)
    problem.solver("ipopt", {"print_time": 0, "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 300}})
    keeps = []
    for state in X:
        share = np.exp(-5 * np.arange(steps + 1) / steps)[:, None]
        problem.set_value(start, state)
        problem.set_initial(states, (share * state + (1 - share) * goal).T)
        problem.set_initial(inputs, np.broadcast_to(plant.u_target(times[:-1]), (steps, plant.m)).T)
        problem.set_initial(missed, 0.5)
        try:
            keeps.append(problem.solve().value(missed) < 1e-6)
        except RuntimeError:
            keeps.append(False)
    return np.array(keeps, dtype=bool)


def main() -> None:
    """Print a line per plant and kind of delay."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    every = cases()
    parser.add_argument("plants", nargs="*", default=[*every, "network"])
    parser.add_argument("--loops", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--wrong", action="store_true")
    parser.add_argument("--rival", action="store_true")
    parser.add_argument("--store", default="artifacts")
    asked = parser.parse_args()
    for name in asked.plants:
        case, predictor = every["clock" if name == "network" else name], None
        if name == "network":
            predictor = npred.load(NETWORK, nx=31, store=asked.store, runtime="fused")
            predictor.plant = case.plant  # the same, with limits
            predictor = npred.guarded(predictor, TOLERANCE)
        rng = np.random.default_rng(asked.seed)
        print(report(case, asked.wrong, asked.loops, rng, predictor, optimal if asked.rival else None), flush=True)


if __name__ == "__main__":
    main()
