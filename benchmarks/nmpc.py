"""Rivals of another kind: model predictive control, replayed commands, a linear predictor, and no predictor at all.

python benchmarks/nmpc.py [cart_pole] [pvtol] [planar_arm2]
python benchmarks/nmpc.py --starts 3 --mismatch 0  # without the search for delays, which takes minutes

On Linux with a C compiler, in an environment of its own, because the package of acados brings a part of CasADi, for
Python 3.12 alone, into the folder of the whole one. That one has to come last:

python -m venv rivals && rivals/bin/pip install . scipy 'comma-deps-acados>=0.2.2.post92'
rivals/bin/pip install --force-reinstall --no-deps 'casadi>=3.8'

A pendulum on a cart, an aircraft that takes off vertically, and an arm that follows a reference, each with nothing
bounded, and with bounds of inputs and limits on states (`safe`). All have one cost up to 8 s, with the target x*, u*:
∫ |X - x*|² + |U - u*|² dt.

- `P = X`: the plant's law on the measured state.
- `replayed commands`: the law on the state that Euler steps through the commands under way lead to.
- `linear predictor`: the law on e^{AD} X + ∫ e^{A(D-s)} B U ds, A and B of the linearisation (Artstein's reduction, a
  Smith predictor in state space); of a plant that rests.
- `RK4 predictor`: npred's, and the law; `…, lqr`: with the law that npred.laws.lqr designs from f for that cost;
  `…, filter`: the plant's law with npred.SafetyFilter, where there are limits.
- `acados, one iteration`: an optimal control problem of 2 s from the predicted state in C by acados, the law's
  cost-to-go at its end, bounds as constraints (limits on states softened by a penalty). A control step is one iteration
  of SQP from the last one's solution (real-time iteration), its quadratic programme by HPIPM after partial condensing,
  with the quickest settings of some twenty on the cart. `acados, converged`: SQP to 1e-5 in every step.

Printed are, over the starts: loops that end near the target, the median cost, the largest violation of a limit in
these, microseconds of a control step (median and 99.9 % quantile), and the true delays, next to the D that all believe,
with which every loop of a few starts still ends there. A loop that tips over is lost, and so is one that asks for
inputs above 100. Of each control step counts the least time of a few runs, which are alike: processor time of the whole
call from Python, then for acados its own clock, which sees neither Python nor the prediction.
"""

import contextlib
import ctypes
import io
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import acados
import casadi as ca
import harness
import numpy as np
from plants import Arm, derived
from promises import OfCasadi
from scipy.linalg import expm, solve_continuous_lyapunov

import npred
from npred.base import randomness
from npred.plants import Plant
from npred.plants.builtin import cart_pole, pvtol

DT, T_END = 0.02, 8.0  # s
STEPS, STEP = 50, 0.04  # of the horizon, s
FIRST, MOST = 10, 60  # iterations of the first control step, and at most where they go on to convergence
PENALTY = 1e3  # per unit of a limit and s
LIMIT = 100.0  # what asks for more is lost; solvers do not return from infinite guesses
REST = 0.1  # of |X - x*|, at the end of a loop
Step = Callable[[np.ndarray], np.ndarray]

for variable, place in ("SOURCE_DIR", acados.DIR), ("PYTHON_INTERFACE_PATH", acados.TEMPLATE_DIR):
    os.environ[f"ACADOS_{variable}"] = place
for library in ("blasfeo", "hpipm", "qpOASES_e", "acados"):  # they do not find each other
    ctypes.CDLL(f"{acados.LIB_DIR}/lib{library}.so", mode=ctypes.RTLD_GLOBAL)
from acados.acados_template import AcadosOcp, AcadosOcpSolver  # noqa: E402  it reads the variables

ENDS = {"safe": lambda x, t, p, M: [0.6 - x.p, 0.6 + x.p]}  # of the cart's track
ROLL = {"safe": lambda x, t, p, M: [0.12 - x.theta, 0.12 + x.theta]}  # of the aircraft, which its law exceeds


@dataclass(frozen=True)
class Task:
    """A plant with limits, its delay, the bounds of its inputs, and the angle that may not tip."""

    limited: Plant
    D: float
    bounds: Sequence[tuple[float, float]]
    upright: int | None = None

    @property
    def pending(self) -> int:
        """How many commands are under way."""
        return round(self.D / DT)


TASKS = {
    "cart_pole": Task(npred.plant(derived("Cart", cart_pole.CartPole, **ENDS)), 0.3, [(-3.0, 3.0)], 2),
    "pvtol": Task(npred.plant(derived("Aircraft", pvtol.PVTOL, **ROLL)), 0.2, [(0.0, 2.0), (-1.0, 1.0)], 2),
    "planar_arm2": Task(npred.plant(Arm), 0.1, [(-20.0, 20.0), (-10.0, 10.0)]),
}


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


class Problem:
    """The optimal control problem of 2 s in C, compiled by acados, as a new solver for each loop: `solver`."""

    def __init__(self, task: Task, bounded: bool, converged: bool) -> None:
        plant, M, problem = task.limited, OfCasadi(), AcadosOcp()
        n, m, x, u, h = plant.n, plant.m, ca.SX.sym("x", plant.n), ca.SX.sym("u", plant.m), ca.SX.sym("h")

        def f(x: Any) -> Any:
            return ca.vertcat(*plant.call("f", ca.vertsplit(x), ca.vertsplit(u), 0.0, plant.p, M))

        following = ca.Function("following", [x, u, h], [harness.rk4(f, x, h)])
        self.plant, self.pending, self.bounded, self.converged = plant, task.pending, bounded, converged
        self.predict = following.mapaccum(task.pending)

        model, cost, rows, options = problem.model, problem.cost, problem.constraints, problem.solver_options
        model.name, model.x, model.u, model.disc_dyn_expr = "nmpc", x, u, following(x, u, STEP)
        problem.dims.N, options.tf, options.integrator_type = STEPS, STEPS * STEP, "DISCRETE"
        cost.cost_type = cost.cost_type_e = "LINEAR_LS"  # halves of squares, times STEP
        cost.W, cost.W_e, cost.Vx_e = 2 * np.eye(n + m), 2 * cost_to_go(plant), np.eye(n)
        cost.Vx, cost.Vu = np.eye(n + m)[:, :n], np.eye(n + m)[:, n:]
        cost.yref, cost.yref_e = np.append(plant.target(0.0), plant.u_target(0.0)), plant.target(0.0)
        rows.x0 = np.zeros(n)
        if bounded:
            (rows.lbu, rows.ubu), rows.idxbu = np.array(task.bounds).T, np.arange(m)
            low, high = state_bounds(ca.vertcat(*plant.call("safe", ca.vertsplit(x), None, 0.0, plant.p, M)), x)
            rows.idxbx = np.flatnonzero(np.isfinite(low))
            rows.lbx, rows.ubx, rows.idxsbx = low[rows.idxbx], high[rows.idxbx], np.arange(len(rows.idxbx))
            cost.zl = cost.zu = np.full(len(rows.idxbx), PENALTY)
            cost.Zl = cost.Zu = np.zeros(len(rows.idxbx))
        options.qp_solver, options.qp_solver_cond_N = "PARTIAL_CONDENSING_HPIPM", 5
        options.nlp_solver_type, options.hpipm_mode = "SQP_RTI", "SPEED_ABS"
        options.qp_tol, options.ext_fun_compile_flags = 1e-6, "-O3 -march=native"
        if converged:
            options.nlp_solver_type, options.hpipm_mode, options.nlp_solver_max_iter = "SQP", "BALANCE", MOST
            options.tol, options.qp_tol = 1e-5, 1e-7
        self.folder, self.problem = tempfile.TemporaryDirectory(), problem
        problem.code_export_directory, self.file = self.folder.name, str(Path(self.folder.name, "nmpc.json"))
        self._made(True)

    def _made(self, build: bool) -> AcadosOcpSolver:
        with contextlib.redirect_stdout(io.StringIO()):
            return AcadosOcpSolver(self.problem, self.file, build=build, generate=build, verbose=False)

    def solver(self) -> AcadosOcpSolver:
        """One whose guess is the target at t = 0."""
        solver = self._made(False)
        for k in range(STEPS + 1):
            solver.set(k, "x", self.plant.target(0.0))
            if k < STEPS:
                solver.set(k, "u", self.plant.u_target(0.0))
        return solver


def state_bounds(safe: Any, x: Any) -> tuple[np.ndarray, np.ndarray]:
    """The low and high (n,) that 0 <= safe(x) says, each row being linear in one state that has both."""
    slopes, rest = np.array(ca.evalf(ca.jacobian(safe, x))), np.array(ca.evalf(ca.substitute(safe, x, 0 * x))).ravel()
    low, high = np.full(x.numel(), -np.inf), np.full(x.numel(), np.inf)
    for slope, constant in zip(slopes, rest, strict=True):
        (i,) = np.flatnonzero(slope)
        (low if slope[i] > 0 else high)[i] = -constant / slope[i]
    return low, high


class Nmpc:
    """Model predictive control of a loop; `own` are the seconds of its control steps by the solver's own clock."""

    def __init__(self, problem: Problem) -> None:
        plant, self.problem, self.solver, self.k = problem.plant, problem, problem.solver(), 0
        self.commands, self.own = np.tile(plant.u_target(0.0), (problem.pending, 1)), []

    def __call__(self, X: np.ndarray) -> np.ndarray:
        problem, plant, solver = self.problem, self.problem.plant, self.solver
        X = np.array(problem.predict(X, self.commands.T, DT))[:, -1]
        if not plant.rests:
            times = (self.k + problem.pending) * DT + np.arange(STEPS + 1) * STEP
            targets = np.hstack([plant.target(times), plant.u_target(times)])
            for k, target in enumerate(targets):
                solver.set(k, "yref", target[: None if k < STEPS else plant.n])
        solver.set(0, "lbx", X)
        solver.set(0, "ubx", X)
        for _ in range(0 if self.k or problem.converged else FIRST):  # there is no last solution yet
            solver.solve()
        before = time.thread_time()
        solver.solve()
        self.own.append(min(time.thread_time() - before, float(solver.get_stats("time_tot")[0])))
        U = np.nan_to_num(solver.get(0, "u"))
        self.commands, self.k = np.vstack([self.commands[1:], U]), self.k + 1
        return U


def cost_to_go(plant: Plant) -> np.ndarray:
    """S of (A + B K)' S + S (A + B K) = -(I + K' K)."""
    (closed, _), K = plant.linearised(0.0), plant.kappa_jacobian(plant.target(0.0))
    return solve_continuous_lyapunov(closed.T, -(np.eye(plant.n) + K.T @ K))


def by_law(task: Task, predictor: npred.Predictor, delay: float, bounds: Any, safety: Any = None) -> Step:
    plant = predictor.plant
    controller = npred.controller(
        plant, predictor, None, dt=DT, D_hat=delay, actuator="history", input_bounds=bounds, history_length=2 * task.D,
        u0=plant.u_target(0.0), safety=safety,
    )  # fmt: skip
    return controller.step


def designed(plant: Plant) -> Plant:
    """The plant with the regulator of its linearisation for the cost, in place of its law."""
    return npred.plant(plant.declared, kappa=npred.laws.lqr(plant, np.ones(plant.n), np.ones(plant.m)))


def contenders(task: Task, bounded: bool) -> dict[str, Callable[[], Step]]:
    plant, D, nx = task.limited, task.D, task.pending + 1
    bounds = task.bounds if bounded else [(-np.inf, np.inf)] * plant.m
    rk4, euler = (npred.predictor(plant, method, nx) for method in ("rk4", "euler"))
    once, converged = (Problem(task, bounded, until) for until in (False, True))
    each = {
        "P = X": lambda: by_law(task, rk4, 0.0, bounds),
        "replayed commands": lambda: by_law(task, euler, D, bounds),
        "linear predictor": lambda: by_law(task, LinearPredictor(plant, nx), D, bounds),
        "RK4 predictor": lambda: by_law(task, rk4, D, bounds),
        "RK4 predictor, lqr": lambda: by_law(task, npred.predictor(designed(plant), "rk4", nx), D, bounds),
        "RK4 predictor, filter": lambda: by_law(task, rk4, D, bounds, npred.SafetyFilter()),
        "acados, one iteration": lambda: Nmpc(once),
        "acados, converged": lambda: Nmpc(converged),
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
    f = partial(plant.f, u=U)
    return harness.rk4(f, harness.rk4(f, X, DT / 2), DT / 2)


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


def timed(task: Task, make: Callable[[], Step], X: np.ndarray, runs: int) -> tuple[Any, list[np.ndarray]]:
    """A loop, and the least microseconds of each of its control steps in a few runs: whole calls, then the solver's."""
    calls, own = [], []
    for _ in range(runs):
        step, taken = make(), []
        loop = run(task, step, X, task.D, taken)
        calls.append(taken)
        own.append(getattr(step, "own", []))
    return loop, [1e6 * np.min(times, axis=0) for times in (calls, own)]


if __name__ == "__main__":
    arguments = harness.options(__doc__, {"plants": TASKS}, starts=6, mismatch=1, runs=5)
    for plant in arguments.plants:
        task = TASKS[plant]
        starts = harness.starts(task.limited, 10 * arguments.starts, randomness.generator(0, "nmpc"))
        starts = starts[task.limited.safe(starts).min(axis=1) >= 0][: arguments.starts]
        for bounded in (False, True):
            print(f"{plant}, D = {task.D:g} s, {'inputs and states bounded' if bounded else 'nothing bounded'}")
            for name, make in contenders(task, bounded).items():
                loops, times = zip(*(timed(task, make, X, arguments.runs) for X in starts), strict=True)
                ends, costs, violations = zip(*loops, strict=True)
                most = max((b for kept, b in zip(ends, violations, strict=True) if kept), default=np.nan)
                said = [
                    "{:.1f} µs, p99.9 {:.0f}".format(*np.quantile(np.concatenate(each), (0.5, 0.999)))
                    for each in zip(*times, strict=True) if each[0].size
                ]  # fmt: skip
                delays = survived(task, make, starts[: arguments.mismatch])
                counts = f"{name:22} {sum(ends)} of {len(ends)}  cost {np.median(costs):6.3f}  beyond {most:.3f}"
                print(f"  {counts}  {'; its own clock '.join(said)}  {delays}", flush=True)
