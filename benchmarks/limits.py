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

from dataclasses import dataclass
from functools import partial
from typing import Any

import harness
import numpy as np
import plants

import npred
from npred.plants import Plant

REST = 0.02  # of half a box: how near to its target a loop is at rest
ROUNDING = 1e-9  # of the size of h


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
        Case(npred.plant(plants.Pole, kappa="lqr"), 0.12, 0.005, 20.0, 0.6, 0.005),
        Case(npred.plant(plants.Pendulum), 0.1, 0.005, 8.0, 1.2),
        Case(npred.plant(plants.Drone), 0.2, 0.01, 20.0, 0.45, u0="equilibrium"),
        Case(npred.plant(plants.Elbow), 0.1, 0.005, 8.0, 0.3),
        Case(npred.plant(plants.Series), 0.5, 0.02, 25.0, 0.1, 0.02, "equilibrium"),
        Case(npred.plant(plants.Lane), 0.15, 0.01, 8.0, 1.2),
        Case(npred.plant(plants.Cart), 0.3, 0.02, 8.0, 0.25),
        Case(npred.plant(plants.Arm), 0.1, 0.01, 6.0, 0.3),
        Case(npred.plant(plants.Tank), 2.0, 0.05, 15.0, 4.0, 0.02, "equilibrium"),
        Case(npred.plant(plants.Aircraft), 0.2, 0.02, 10.0, 0.25, u0="equilibrium"),
        Case(npred.plant(plants.Clock), 0.3, 0.02, 10.0, 1.0),
        Case(npred.plant(plants.Cubic), 0.6, 0.01, 6.0, 1.0),
    )
    return {case.plant.name.lower(): case for case in every}


NETWORK, TOLERANCE = "pipeline/paper.toml:deeponet", 0.01


def run(case: Case, D: Any, X0: np.ndarray, safety: Any, predictor: Any = None, t_end: Any = None) -> tuple[Any, float]:
    """The loops, and the microseconds of a control step of one of them."""
    plant, t_end = case.plant, t_end or case.t_end
    predictor = predictor or npred.predictor(plant, "rk4", 31)
    named = {"t_end": t_end, "dt": case.dt, "u0": case.u0, "actuator": "history", "progress": False}
    simulate = partial(npred.simulate, plant, predictor, D=D, D_hat=case.D, X0=X0, safety=safety, **named)
    seconds, loop = harness.seconds(simulate)
    return loop, seconds / len(X0) / round(t_end / case.dt) * 1e6


def least(loop: Any, since: Any) -> np.ndarray:
    """The least h of each loop from the time `since` on; -inf for one that was lost."""
    h = np.where(np.isnan(loop.safety), -np.inf, loop.safety).min(axis=-1)
    return np.where(loop.t >= np.asarray(since)[..., None] - 1e-9, h, np.inf).min(axis=-1)


def rests(case: Case, loop: Any) -> np.ndarray:
    """Whether each loop ends near the target (B,)."""
    off = np.abs(np.nan_to_num(loop.X[:, -1], nan=np.inf) - case.plant.target(loop.t[-1]))
    return (off <= REST * harness.half_widths(case.plant)).all(axis=-1)


def report(case: Case, wrong: bool, loops: int, rng: np.random.Generator, predictor: Any, rival: bool) -> str:
    """A line on the case with D known, or with D anywhere in D_hat ± delay."""
    X0, D = harness.starts(case.plant, loops, rng), np.full(loops, case.D)
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
    if not rival:
        return line
    met = free.X[np.arange(loops), np.ceil(D / case.dt - 1e-9).astype(int)]
    hard = np.flatnonzero(outside & (case.plant.safe(met) >= 0).all(axis=-1))
    can = hard[optimal(case, met[hard])]
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

    following = ca.Function("following", [x, u, t], [harness.rk4(f, x, h)])
    safe = ca.Function("safe", [x, t], [ca.vertcat(*plant.call("safe", ca.vertsplit(x), None, t, plant.p, M))])
    problem = ca.Opti()
    states, inputs, missed = problem.variable(plant.n, steps + 1), problem.variable(plant.m, steps), problem.variable()
    start = problem.parameter(plant.n)
    times = case.D + h * np.arange(steps + 1)
    goal = np.broadcast_to(plant.target(times), (steps + 1, plant.n))
    half = harness.half_widths(plant)
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


if __name__ == "__main__":
    every = cases()
    places = {"plants": [*every, "network"]}
    asked = harness.options(__doc__, places, loops=2000, seed=0, wrong=False, rival=False, store="artifacts")
    for name in asked.plants:
        case, predictor = every["clock" if name == "network" else name], None
        if name == "network":
            predictor = npred.load(NETWORK, nx=31, store=asked.store, runtime="fused")
            predictor.plant = case.plant  # the same, with limits
            predictor = npred.guarded(predictor, TOLERANCE)
        rng = np.random.default_rng(asked.seed)
        print(report(case, asked.wrong, asked.loops, rng, predictor, asked.rival), flush=True)
