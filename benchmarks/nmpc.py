"""Rivals of another kind: model predictive control, replayed commands, a linear predictor, and no predictor at all.

python benchmarks/nmpc.py              # needs the extra: pip install -e '.[rivals]'
python benchmarks/nmpc.py --starts 3 --mismatch 0  # without the search for delays, which takes minutes

The pendulum on a cart, D = 0.3 s, a control step of 0.02 s: with nothing bounded, and with bounds of force and track
that are active. All have one cost, ∫ |X|² + F² dt, of which the plant's law is the optimum where nothing is bounded and
little moves.

- `P = X`: the law on the measured state.
- `replayed commands`: the law on the state that Euler steps through the commands under way lead to.
- `linear predictor`: the law on e^{AD} X + ∫ e^{A(D-s)} B U ds, A and B of the linearisation (Artstein's reduction, a
  Smith predictor in state space).
- `RK4 predictor`: npred's, and the law.
- `NMPC, predicted state`: an optimal control problem of 2 s from that prediction, solved to convergence in every step,
  the cost-to-go of the law at its end, bounds as constraints (the track's softened by a penalty), warm starts.
- `NMPC, pending inputs`: the same from the measured state, the commands under way being its first inputs, fixed.

Printed are, over the starts: loops that end at rest, the median cost up to 8 s, the longest way of these beyond the
track, the processor time of a control step (median and 99.9 % quantile, milliseconds), and the true delays, next to the
0.3 s that all believe, with which every loop of a few starts still ends at rest. A pole that lies is lost,
and so is a loop that asks for more than 100 N.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov

import npred
from npred import randomness
from npred.plants import Plant

D, DT, T_END = 0.3, 0.02, 8.0  # s
PENDING = round(D / DT)  # commands under way
STEPS, STEP = 50, 0.04  # of the horizon, s
ITERATIONS = 60  # at most; a step takes four or so
PENALTY = 1e3  # per m beyond the track and s
LIMIT = 100.0  # N, where 10 suffice: what asks for more is lost; solvers do not return from infinite guesses
REST = 0.1  # of |X|, at the end of a loop
PLANT = npred.plant("cart_pole")
SETTINGS = {"nothing bounded": (np.inf, np.inf), "force and track bounded": (3.0, 0.6)}  # N, m
Step = Callable[[np.ndarray], float]


class LinearPredictor(npred.Predictor):
    """P(1) = e^{AD} X + ∫ e^{A(D-s)} B u ds, exact for the linearisation and an input held over each step."""

    name = "linear"

    def __init__(self, plant: Plant, nx: int = PENDING + 1):
        super().__init__(plant, nx)
        A, B = plant.jacobians(plant.equilibrium, plant.u_equilibrium)
        held = expm(np.block([[A, B], [np.zeros((1, plant.n + 1))]]) * D / (nx - 1))
        self.A, self.B = held[: plant.n, : plant.n], held[: plant.n, plant.n :]

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        P = [X]
        for j in range(u.shape[1] - 1):
            P.append(P[-1] @ self.A.T + (u[:, j] + u[:, j + 1]) / 2 @ self.B.T)
        return np.stack(P, axis=1)


class Nmpc:
    """The optimal control problem, once a step; `augmented`: from the measured state, its pending inputs fixed."""

    def __init__(self, augmented: bool, force: float, track: float, solver: str) -> None:
        self.augmented, self.force, self.commands = augmented, force, [0.0] * PENDING
        steps = ([DT] * PENDING if augmented else []) + [STEP] * STEPS
        x, u, slack = ca.SX.sym("x", 4), ca.SX.sym("F"), ca.SX.sym("slack")
        h, f = ca.SX.sym("h"), lambda x: ca.vertcat(*PLANT.call("f", ca.vertsplit(x), [u], 0.0, PLANT.p, ca))
        k1 = f(x)
        k2 = f(x + h / 2 * k1)
        k3 = f(x + h / 2 * k2)
        following = ca.Function("following", [x, u, h], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3))])
        self.predict = following.mapaccum(PENDING)
        cost = ca.Function("cost", [x, u, slack], [ca.sumsqr(x) + u**2 + PENALTY * slack])
        X, U = ca.SX.sym("X", 4, len(steps) + 1), ca.SX.sym("U", 2, len(steps))
        variables, total, rows, self.lower, self.upper, equalities = [], 0.0, [], [], [], []
        bounded = np.isfinite(track)
        for k, step in enumerate(steps):
            variables += [X[:, k], U[:, k]]
            total += step * cost(X[:, k], U[0, k], U[1, k])
            rows += [X[:, k + 1] - following(X[:, k], U[0, k], step)]
            self.lower, self.upper = self.lower + [0.0] * 4, self.upper + [0.0] * 4
            equalities += [True] * 4
            if bounded:
                rows += [X[0, k] - U[1, k], X[0, k] + U[1, k]]
                self.lower, self.upper = [*self.lower, -np.inf, -track], [*self.upper, track, np.inf]
                equalities += [False, False]
        total += X[:, -1].T @ ca.DM(cost_to_go()) @ X[:, -1]
        problem = {"x": ca.vertcat(*variables, X[:, -1]), "f": total, "g": ca.vertcat(*rows)}
        quiet = {"ipopt": {"print_level": 0, "sb": "yes", "warm_start_init_point": "yes", "max_iter": ITERATIONS}}
        quiet["fatrop"] = {"print_level": 0, "max_iter": ITERATIONS}
        structure = {"structure_detection": "auto", "equality": equalities} if solver == "fatrop" else {}
        options = {"expand": True, "print_time": False, "error_on_fail": False, solver: quiet[solver]} | structure
        self.solve, self.guess = ca.nlpsol("nmpc", solver, problem, options), np.zeros(6 * len(steps) + 4)
        self.w_lower, self.w_upper = np.full(len(self.guess), -np.inf), np.full(len(self.guess), np.inf)
        self.inputs = np.arange(len(steps)) * 6 + 4
        self.w_lower[self.inputs], self.w_upper[self.inputs] = -force, force
        self.w_lower[self.inputs + 1] = 0.0
        if not bounded:
            self.w_upper[self.inputs + 1] = 0.0

    def step(self, X: np.ndarray) -> float:
        if not self.augmented:
            X = np.array(self.predict(X, self.commands, DT))[:, -1]  # the commands are held: a step of RK4 each
        low, high = self.w_lower.copy(), self.w_upper.copy()
        low[:4] = high[:4] = X
        if self.augmented:
            low[self.inputs[:PENDING]] = high[self.inputs[:PENDING]] = self.commands
        answer = np.array(self.solve(x0=self.guess, lbx=low, ubx=high, lbg=self.lower, ubg=self.upper)["x"]).ravel()
        first = PENDING if self.augmented else 0
        if np.isfinite(answer).all():
            self.guess = answer
        F = float(np.clip(np.nan_to_num(answer[self.inputs[first]]), -self.force, self.force))
        self.commands = [*self.commands[1:], F]
        return F


def cost_to_go() -> np.ndarray:
    """S of (A + B K)' S + S (A + B K) = -(I + K' K)."""
    (A, B), K = PLANT.jacobians(PLANT.equilibrium, PLANT.u_equilibrium), PLANT.kappa_jacobian(PLANT.equilibrium)
    return solve_continuous_lyapunov((A + B @ K).T, -(np.eye(4) + K.T @ K))


def by_law(predictor: npred.Predictor, delay: float, force: float) -> Step:
    bounds = [(-force, force)]
    controller = npred.controller(
        PLANT, predictor, None, dt=DT, D_hat=delay, actuator="history", input_bounds=bounds, longest=2 * D
    )
    return lambda X: float(controller.step(X)[0])


def contenders(force: float, track: float, solver: str) -> dict[str, Callable[[], Step]]:
    rk4, euler = (npred.predictor(name, PLANT, PENDING + 1) for name in ("rk4", "euler"))
    return {
        "P = X": lambda: by_law(rk4, 0.0, force),
        "replayed commands": lambda: by_law(euler, D, force),
        "linear predictor": lambda: by_law(LinearPredictor(PLANT), D, force),
        "RK4 predictor": lambda: by_law(rk4, D, force),
        "NMPC, predicted state": lambda: Nmpc(False, force, track, solver).step,
        "NMPC, pending inputs": lambda: Nmpc(True, force, track, solver).step,
    }


def run(step: Step, X: np.ndarray, delay: float, track: float, taken: list[float]) -> tuple[bool, float, float]:
    """A loop with that true delay: whether it ends at rest, its cost, and how far beyond the track it was."""
    late, cost, beyond = round(delay / DT), 0.0, 0.0
    acting = [0.0] * late
    for _ in range(round(T_END / DT)):
        before = time.thread_time()
        F = step(X)
        taken.append(time.thread_time() - before)
        if not abs(F) < LIMIT:
            return False, np.inf, np.inf
        acting.append(F)
        now = acting.pop(0)
        cost += DT * (X @ X + now**2)
        beyond = max(beyond, abs(X[0]) - track)
        X = advanced(X, now)
        if not abs(X[2]) < np.pi / 2:
            return False, np.inf, np.inf
    return bool(np.linalg.norm(X) < REST), cost, beyond


def advanced(X: np.ndarray, F: float) -> np.ndarray:
    """A control step of the plant, by two steps of RK4."""
    h, f = DT / 2, lambda x: PLANT.f(x, np.array([F]))
    for _ in range(2):
        k1 = f(X)
        k2 = f(X + h / 2 * k1)
        k3 = f(X + h / 2 * k2)
        X = X + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(X + h * k3))
    return X


def survived(make: Callable[[], Step], starts: np.ndarray, track: float) -> str:
    """The true delays around D, whole control steps, with which every loop ends at rest."""

    def keeps(late: int) -> bool:
        return all(run(make(), X, late * DT, track, [])[0] for X in starts)

    if not len(starts):
        return ""
    if not keeps(PENDING):
        return "none"
    low = high = PENDING
    while low > 0 and keeps(low - 1):
        low -= 1
    while high < 3 * PENDING and keeps(high + 1):
        high += 1
    return f"{low * DT:.2f} to {high * DT:.2f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=6)
    parser.add_argument("--mismatch", type=int, default=1, help="starts of each wrong delay")
    parser.add_argument("--solver", choices=("fatrop", "ipopt"), default="fatrop")
    arguments = parser.parse_args()
    box = np.array([PLANT.box[name] for name in PLANT.states])
    starts = randomness.generator(0, "nmpc").uniform(box[:, 0], box[:, 1], (arguments.starts, PLANT.n))
    for title, (force, track) in SETTINGS.items():
        print(f"{title}: force {force:g} N, track {track:g} m")
        for name, make in contenders(force, track, arguments.solver).items():
            taken: list[float] = []
            loops = [run(make(), X, D, track, taken) for X in starts]
            ends, costs, _ = zip(*loops, strict=True)
            median, tail = np.quantile(1000 * np.array(taken), (0.5, 0.999))
            most = max((b for kept, _, b in loops if kept), default=np.nan)
            delays = survived(make, starts[: arguments.mismatch], track)
            print(
                f"  {name:22} {sum(ends)} of {len(ends)}  cost {np.median(costs):6.3f}"
                f"  beyond {max(most, 0.0):.3f} m  {median:.3f} ms, p99.9 {tail:.2f}  {delays}",
                flush=True,
            )


if __name__ == "__main__":
    main()
