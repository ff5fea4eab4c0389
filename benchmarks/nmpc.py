"""Rivals of another kind: model predictive control, replayed commands, a linear predictor, and no predictor at all.

python benchmarks/nmpc.py [cart_pole] [pvtol] [planar_arm2]  # needs the extra: pip install -e '.[rivals]'
python benchmarks/nmpc.py --starts 3 --mismatch 0  # without the search for delays, which takes minutes

A pendulum on a cart, an aircraft that takes off vertically, and an arm that follows a reference, each with nothing
bounded, and with bounds of inputs and limits on states (`safe`). All have one cost up to 8 s, with the target x*, u*:
∫ |X - x*|² + |U - u*|² dt.

- `P = X`: the plant's law on the measured state.
- `replayed commands`: the law on the state that Euler steps through the commands under way lead to.
- `linear predictor`: the law on e^{AD} X + ∫ e^{A(D-s)} B U ds, A and B of the linearisation (Artstein's reduction, a
  Smith predictor in state space); of a plant that rests.
- `RK4 predictor`: npred's, and the law; `…, lqr`: with the law that npred.laws.lqr designs from f for that cost;
  `…, filter`: the plant's law with npred.SafetyFilter, where there are limits.
- `NMPC, predicted state`: an optimal control problem of 2 s from that prediction, solved to convergence in every step,
  the law's cost-to-go at its end, bounds as constraints (limits on states softened by a penalty), warm starts.
- `NMPC, pending inputs`: the same from the measured state, the commands under way being its first inputs, fixed.

Printed are, over the starts: loops that end near the target, the median cost, the largest violation of a limit in
these, the processor time of a control step (median and 99.9 % quantile, milliseconds), and the true delays, next to
the D that all believe, with which every loop of a few starts still ends there. A loop that tips over is lost, and so is
one that asks for inputs above 100.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from limits import Arm, Pole
from scipy.linalg import expm, solve_continuous_lyapunov

import npred
from npred import randomness
from npred.plants import Plant
from npred.plants.builtin import cart_pole, pvtol

DT, T_END = 0.02, 8.0  # s
STEPS, STEP = 50, 0.04  # of the horizon, s
ITERATIONS = 60  # at most; a step takes four or so
PENALTY = 1e3  # per unit of a limit and s
LIMIT = 100.0  # what asks for more is lost; solvers do not return from infinite guesses
REST = 0.1  # of |X - x*|, at the end of a loop
Step = Callable[[np.ndarray], np.ndarray]


class Cart(cart_pole.CartPole):
    """The track ends after 0.6 m."""

    @staticmethod
    def safe(x, t, p, M):
        """Both ends."""
        return [0.6 - x.p, 0.6 + x.p]


class Aircraft(pvtol.PVTOL):
    """The roll angle stays within 0.12 rad, which its law exceeds."""

    @staticmethod
    def safe(x, t, p, M):
        """To either side."""
        return [0.12 - x.theta, 0.12 + x.theta]


@dataclass(frozen=True)
class Task:
    """A plant with limits, its delay, the bounds of its inputs, the filter's alpha, the angle that may not tip, and the
    plant with the filter's limits, where these are others.
    """

    limited: Plant
    D: float
    bounds: Sequence[tuple[float, float]]
    alpha: float
    upright: int | None = None
    filtered: Plant | None = None

    @property
    def pending(self) -> int:
        """How many commands are under way."""
        return round(self.D / DT)


TASKS = {
    "cart_pole": Task(npred.plant(Cart), 0.3, [(-3.0, 3.0)], 3.0, 2, npred.plant(Pole)),
    "pvtol": Task(npred.plant(Aircraft), 0.2, [(0.0, 2.0), (-1.0, 1.0)], 5.0, 2),
    "planar_arm2": Task(npred.plant(Arm), 0.1, [(-20.0, 20.0), (-10.0, 10.0)], 5.0),
}


class OfCasadi:
    """What `M` offers a plant, on CasADi's expressions."""

    def __getattr__(self, name: str) -> Any:
        return getattr(ca, name)

    @staticmethod
    def solve(A: Any, b: Any) -> list[Any]:
        """The y of A y = b."""
        return ca.vertsplit(ca.solve(ca.vertcat(*(ca.horzcat(*row) for row in A)), ca.vertcat(*b)))


class LinearPredictor(npred.Predictor):
    """P(1) = e^{AD} X + ∫ e^{A(D-s)} B u ds near rest, exact for the linearisation and an input held over each step."""

    name = "linear"

    def __init__(self, plant: Plant, nx: int):
        super().__init__(plant, nx)
        A, B = plant.jacobians(plant.equilibrium, plant.u_equilibrium)
        zero = np.zeros((plant.m, plant.n + plant.m))
        held = expm(np.block([[A, B], [zero]]) * DT)
        self.A, self.B = held[: plant.n, : plant.n], held[: plant.n, plant.n :]

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        P, rest = [X - self.plant.equilibrium], self.plant.u_equilibrium
        for j in range(u.shape[1] - 1):
            P.append(P[-1] @ self.A.T + ((u[:, j] + u[:, j + 1]) / 2 - rest) @ self.B.T)
        return np.stack(P, axis=1) + self.plant.equilibrium


class Nmpc:
    """The optimal control problem, once a step; `augmented`: from the measured state, its pending inputs fixed.

    Its variables are x, u and a slack of the limits, step by step; its parameters the targets of x and u.
    """

    def __init__(self, task: Task, plant: Plant, bounded: bool, augmented: bool, solver: str) -> None:
        n, m, M = plant.n, plant.m, OfCasadi()
        self.plant, self.augmented, self.pending, self.k = plant, augmented, task.pending, 0
        self.commands = np.tile(plant.u_target(0.0), (task.pending, 1))
        steps = ([DT] * task.pending if augmented else []) + [STEP] * STEPS
        x, u, h = ca.SX.sym("x", n), ca.SX.sym("u", m), ca.SX.sym("h")

        def f(x: Any) -> Any:
            return ca.vertcat(*plant.call("f", ca.vertsplit(x), ca.vertsplit(u), 0.0, plant.p, M))

        k1 = f(x)
        k2 = f(x + h / 2 * k1)
        k3 = f(x + h / 2 * k2)
        following = ca.Function("following", [x, u, h], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3))])
        self.predict = following.mapaccum(task.pending)
        X, U = ca.SX.sym("X", n, len(steps) + 1), ca.SX.sym("U", m + 1, len(steps))
        goal, held = ca.SX.sym("goal", n, len(steps) + 1), ca.SX.sym("held", m, len(steps))
        variables, total, rows, lower, upper, equalities = [], 0.0, [], [], [], []
        for k, step in enumerate(steps):
            variables += [X[:, k], U[:, k]]
            total += step * (ca.sumsqr(X[:, k] - goal[:, k]) + ca.sumsqr(U[:m, k] - held[:, k]) + PENALTY * U[m, k])
            rows += [X[:, k + 1] - following(X[:, k], U[:m, k], step)]
            lower, upper, equalities = lower + [0.0] * n, upper + [0.0] * n, equalities + [True] * n
            limits = plant.call("safe", ca.vertsplit(X[:, k]), None, 0.0, plant.p, M) if bounded else []
            rows += [limit + U[m, k] for limit in limits]
            lower, upper = lower + [0.0] * len(limits), upper + [np.inf] * len(limits)
            equalities += [False] * len(limits)
        end = X[:, -1] - goal[:, -1]
        total += end.T @ ca.DM(cost_to_go(plant)) @ end
        parameters = ca.vertcat(ca.vec(goal), ca.vec(held))
        problem = {"x": ca.vertcat(*variables, X[:, -1]), "f": total, "g": ca.vertcat(*rows), "p": parameters}
        quiet = {"ipopt": {"print_level": 0, "sb": "yes", "warm_start_init_point": "yes", "max_iter": ITERATIONS}}
        quiet["fatrop"] = {"print_level": 0, "max_iter": ITERATIONS}
        structure = {"structure_detection": "auto", "equality": equalities} if solver == "fatrop" else {}
        options = {"expand": True, "print_time": False, "error_on_fail": False, solver: quiet[solver]} | structure
        self.solve = ca.nlpsol("nmpc", solver, problem, options)
        self.rows = {"lbg": lower, "ubg": upper}
        size = (n + m + 1) * len(steps) + n
        self.low, self.high = np.full(size, -np.inf), np.full(size, np.inf)
        self.inputs = (np.arange(len(steps)) * (n + m + 1))[:, None] + n + np.arange(m)
        if bounded:
            self.low[self.inputs], self.high[self.inputs] = np.array(task.bounds).T
        self.low[self.inputs[:, -1] + 1] = 0.0
        if not bounded:
            self.high[self.inputs[:, -1] + 1] = 0.0
        self.times = np.concatenate([[0.0], np.cumsum(steps)])
        self.guess = np.zeros(size)
        self.guess[self.inputs] = self.commands[0]

    def step(self, X: np.ndarray) -> np.ndarray:
        t = self.k * DT
        if not self.augmented:
            X, t = np.array(self.predict(X, self.commands.T, DT))[:, -1], t + self.pending * DT
        low, high, n = self.low.copy(), self.high.copy(), self.plant.n
        low[:n] = high[:n] = X
        first = self.pending if self.augmented else 0
        low[self.inputs[:first]] = high[self.inputs[:first]] = self.commands[:first]
        t = t + self.times
        targets = np.concatenate(
            [
                np.ravel(self.plant.target(t)[-len(t) :] + np.zeros((len(t), n))),
                np.ravel(self.plant.u_target(t[:-1]) + np.zeros((len(t) - 1, self.plant.m))),
            ]
        )
        answer = np.array(self.solve(x0=self.guess, lbx=low, ubx=high, p=targets, **self.rows)["x"]).ravel()
        if np.isfinite(answer).all():
            self.guess = answer
        at = self.inputs[first]
        U = np.clip(np.nan_to_num(answer[at]), self.low[at], self.high[at])
        self.commands, self.k = np.vstack([self.commands[1:], U]), self.k + 1
        return U


def cost_to_go(plant: Plant) -> np.ndarray:
    """S of (A + B K)' S + S (A + B K) = -(I + K' K)."""
    (closed, _), K = plant.linearised(0.0), plant.kappa_jacobian(plant.target(0.0))
    return solve_continuous_lyapunov(closed.T, -(np.eye(plant.n) + K.T @ K))


def by_law(task: Task, predictor: npred.Predictor, delay: float, bounds: Any, alpha: float | None = None) -> Step:
    plant = predictor.plant
    controller = npred.controller(
        plant, predictor, None, dt=DT, D_hat=delay, actuator="history", input_bounds=bounds, longest=2 * task.D,
        u0=plant.u_target(0.0), safety=npred.SafetyFilter(alpha) if alpha else None,
    )  # fmt: skip
    return controller.step


def designed(plant: Plant) -> Plant:
    """The plant with the regulator of its linearisation for the cost, in place of its law."""
    return npred.plant(plant.declared, kappa=npred.laws.lqr(plant, np.ones(plant.n), np.ones(plant.m)))


def contenders(task: Task, bounded: bool, solver: str) -> dict[str, Callable[[], Step]]:
    plant, D, nx = task.limited, task.D, task.pending + 1
    bounds = task.bounds if bounded else [(-np.inf, np.inf)] * plant.m
    rk4, euler = (npred.predictor(method, plant, nx) for method in ("rk4", "euler"))
    filtered = npred.predictor("rk4", task.filtered or plant, nx)
    each = {
        "P = X": lambda: by_law(task, rk4, 0.0, bounds),
        "replayed commands": lambda: by_law(task, euler, D, bounds),
        "linear predictor": lambda: by_law(task, LinearPredictor(plant, nx), D, bounds),
        "RK4 predictor": lambda: by_law(task, rk4, D, bounds),
        "RK4 predictor, lqr": lambda: by_law(task, npred.predictor("rk4", designed(plant), nx), D, bounds),
        "RK4 predictor, filter": lambda: by_law(task, filtered, D, bounds, task.alpha),
        "NMPC, predicted state": lambda: Nmpc(task, plant, bounded, False, solver).step,
        "NMPC, pending inputs": lambda: Nmpc(task, plant, bounded, True, solver).step,
    }
    left_out = () if plant.rests else ("linear predictor",)
    left_out += () if bounded else ("RK4 predictor, filter",)
    return {name: make for name, make in each.items() if name not in left_out}


def run(task: Task, step: Step, X: np.ndarray, delay: float, taken: list[float]) -> tuple[bool, float, float]:
    """A loop with that true delay: whether it ends near the target, its cost, and how far beyond limits it was."""
    plant, cost, beyond = task.limited, 0.0, 0.0
    acting = [plant.u_target(0.0)] * round(delay / DT)
    for k in range(round(T_END / DT)):
        t, before = k * DT, time.thread_time()
        U = np.array(step(X))
        taken.append(time.thread_time() - before)
        if not np.abs(U).max() < LIMIT:
            return False, np.inf, np.inf
        acting.append(U)
        now = acting.pop(0)
        cost += DT * (((X - plant.target(t)) ** 2).sum() + ((now - plant.u_target(t)) ** 2).sum())
        beyond = max(beyond, -plant.safe(X).min())
        X = advanced(plant, X, now)
        if not np.isfinite(X).all() or (task.upright is not None and not abs(X[task.upright]) < np.pi / 2):
            return False, np.inf, np.inf
    return bool(np.linalg.norm(X - plant.target(T_END)) < REST), cost, beyond


def advanced(plant: Plant, X: np.ndarray, U: np.ndarray) -> np.ndarray:
    """A control step of the plant, by two steps of RK4."""
    h, f = DT / 2, lambda x: plant.f(x, U)
    for _ in range(2):
        k1 = f(X)
        k2 = f(X + h / 2 * k1)
        k3 = f(X + h / 2 * k2)
        X = X + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(X + h * k3))
    return X


def survived(task: Task, make: Callable[[], Step], starts: np.ndarray) -> str:
    """The true delays around D, whole control steps, with which every loop ends near the target."""

    def keeps(late: int) -> bool:
        return all(run(task, make(), X, late * DT, [])[0] for X in starts)

    if not len(starts):
        return ""
    if not keeps(task.pending):
        return "none"
    low = high = task.pending
    while low > 0 and keeps(low - 1):
        low -= 1
    while high < 3 * task.pending and keeps(high + 1):
        high += 1
    return f"{low * DT:.2f} to {high * DT:.2f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plants", nargs="*", default=[*TASKS])
    parser.add_argument("--starts", type=int, default=6)
    parser.add_argument("--mismatch", type=int, default=1, help="starts of each wrong delay")
    parser.add_argument("--solver", choices=("fatrop", "ipopt"), default="fatrop")
    arguments = parser.parse_args()
    for plant in arguments.plants:
        task = TASKS[plant]
        box = np.array([task.limited.box[name] for name in task.limited.states])
        size = (10 * arguments.starts, task.limited.n)
        starts = randomness.generator(0, "nmpc").uniform(box[:, 0], box[:, 1], size)
        starts = starts[task.limited.safe(starts).min(axis=1) >= 0][: arguments.starts]
        for bounded in (False, True):
            print(f"{plant}, D = {task.D:g} s, {'inputs and states bounded' if bounded else 'nothing bounded'}")
            for name, make in contenders(task, bounded, arguments.solver).items():
                taken: list[float] = []
                ends, costs, violations = zip(*(run(task, make(), X, task.D, taken) for X in starts), strict=True)
                median, tail = np.quantile(1000 * np.array(taken), (0.5, 0.999))
                most = max((b for kept, b in zip(ends, violations, strict=True) if kept), default=np.nan)
                delays = survived(task, make, starts[: arguments.mismatch])
                print(
                    f"  {name:22} {sum(ends)} of {len(ends)}  cost {np.median(costs):6.3f}"
                    f"  beyond {most:.3f}  {median:.3f} ms, p99.9 {tail:.2f}  {delays}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
