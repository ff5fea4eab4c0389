"""Six joints of an arm that follow a wave, every torque 0.2 s late, the state sampled at random times and with noise.

Bhan, Quawas, Krstic, Shi, Sampling-Horizon Neural Operator Predictors for Nonlinear Control under Delayed Inputs,
arXiv:2603.29119. Between samples the controller's prediction Z follows the loop without delay, Z' = f(Z, κ(Z, t + D)).
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

import npred
from npred import plants
from npred.prediction.delays import problem_of
from npred.prediction.methods import RK4
from npred_experiments import latency
from npred_experiments.experiment import (
    AS_MEANT,
    NUMERICAL,
    Experiment,
    Measured,
    Measurements,
    PredictionTime,
    PublishedNumber,
    PublishedTime,
)
from npred_experiments.loop_networks import LoopNetworks
from npred_experiments.network_loop import NetworkLoop, Predict
from npred_robots import rigid_body, xarm6
from npred_robots.xarm6 import XArm6

D, DT, STEPS, LATE, JOINTS = 0.2, 0.001, 20000, 200, 6
NOISE, GAPS, STRONGEST, SECOND = 0.005, (20, 101), 60.0, 1000  # steps of 1 ms
OTHERS, OTHERS_STEPS, OTHERS_CALLS = 60, 12000, 170  # runs to learn from, over a period of the wave
CELL = 20  # steps, of which a network gets the mean torque
ROWS = ("tracking, highest", "tracking, mean of 10 to 20 s", "prediction, highest of the first second",
        "prediction, mean of the first second")  # fmt: skip


class SampledArm(XArm6):
    """The arm with the torque limits of the source, ±60 N m."""

    input_bounds = [(-STRONGEST, STRONGEST)] * JOINTS


class SampledArmLoop(SampledArm):
    """The same without delay: its law is in f, and its inputs move nothing."""

    @staticmethod
    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> list[Any]:
        law = [M.minimum(M.maximum(a, -STRONGEST), STRONGEST) for a in XArm6.kappa(x, t, p, M)]
        return XArm6.f(x, law, t, p, M)


class Kernels:
    """One step of the classical Runge-Kutta method, of the arm with a held torque and of the loop without delay."""

    def __init__(self) -> None:
        arm, loop = plants.make("sampled_arm", SampledArm), plants.make("sampled_arm_loop", SampledArmLoop)
        self._arm, self._loop = (problem_of(plant).advance(RK4.step) for plant in (arm, loop))
        self._control, self.p = problem_of(arm).control(RK4.step), arm.p

    def move(self, X: np.ndarray, torque: np.ndarray) -> None:
        """X (12, B) after a step, in place."""
        self._arm(X, torque, torque, np.ones_like(torque), DT, 0.0, self.p)

    def flow(self, Z: np.ndarray, t: float) -> None:
        """Z (12, B) after a step of the loop without delay from time t, in place."""
        none = np.zeros((JOINTS, Z.shape[1]))
        self._loop(Z, none, none, np.ones_like(none), DT, t, self.p)

    def law(self, Z: np.ndarray, t: float) -> np.ndarray:
        """κ(Z, t) within the limits, (6, B)."""
        U = np.empty((JOINTS, Z.shape[1]))
        self._control(np.stack([Z, Z]), np.zeros((2, *U.shape)), np.zeros(Z.shape[1]), t, self.p, U)
        return np.clip(U, -STRONGEST, STRONGEST)


@cache
def kernels() -> Kernels:
    """They, compiled once."""
    return Kernels()


class Runs(NamedTuple):
    """B runs side by side: X0 (12, B), the noise of each step, (12, B), and the steps to the next sample."""

    X0: np.ndarray
    noise: Callable[[], np.ndarray]
    gap: Callable[[], int]


def published_runs() -> Runs:
    """The published run, with its draws in their order."""
    starts, draws = np.random.default_rng(0), np.random.default_rng(0)
    return Runs(
        starts.uniform(-0.01, 0.01, (2 * JOINTS, 1)),
        lambda: draws.normal(0.0, NOISE, (2 * JOINTS, 1)),
        lambda: int(draws.integers(*GAPS)),
    )


def others(rng: np.random.Generator) -> Runs:
    """Runs to learn from, from wider starts; all sample at the same times."""
    shape = 2 * JOINTS, OTHERS
    return Runs(rng.uniform(-0.1, 0.1, shape), lambda: rng.normal(0.0, NOISE, shape), lambda: int(rng.integers(*GAPS)))


def held(steps: int = 1) -> Predict:
    """P of X (B, 12) and u (B, N + 1, 6), each torque held for so many steps; u's last row is not read.

    The published predictor iterates the trapezoidal rule on quarters of a step to 1e-8; here a step is one of the
    classical Runge-Kutta method, nearer to the same exact prediction.
    """
    arm = kernels()

    def predict(X: np.ndarray, u: np.ndarray, D: np.ndarray, t: Any) -> np.ndarray:
        ahead, nodes = np.array(X.T, dtype=float, order="C"), [X]
        for torque in np.ascontiguousarray(u[:, :-1].transpose(1, 2, 0)):
            for _ in range(steps):
                arm.move(ahead, torque)
            nodes.append(ahead.T.copy())
        return np.stack(nodes, axis=1)

    return predict


def of_means(predict: Predict) -> Predict:
    """A predictor that gets the mean torques of cells of 20 ms: fewer numbers describe the commands under way."""

    def averaged(X: np.ndarray, u: np.ndarray, D: np.ndarray, t: Any) -> np.ndarray:
        means = u[:, :-1].reshape(len(u), -1, CELL, JOINTS).mean(axis=2)
        return predict(X, np.concatenate([means, means[:, -1:]], axis=1), D, t)

    return averaged


class Logged(NamedTuple):
    """X (N + 1, 12, B), Z (N, 12, B) at the begin of each step and at its end, the steps that sampled, and the torques,
    each (6, B), from those before t = 0 on.
    """

    X: np.ndarray
    Z: np.ndarray
    Z_end: np.ndarray
    sampled: list[int]
    torques: list[np.ndarray]


def loop(steps: int = STEPS, predict: Predict | None = None, runs: Runs | None = None) -> Logged:
    """The published loop; another predictor may replace the numerical one, and other runs the published one."""
    predict, arm, (state, noise, gap) = predict or held(), kernels(), runs or published_runs()
    torques, sampled, due, D = _hold(state), [], 0, np.full(state.shape[1], LATE * DT)
    X, (Z, Z_end) = np.empty((steps + 1, *state.shape)), np.empty((2, steps, *state.shape))
    ahead = state = state.copy()
    for k in range(steps):
        X[k] = state
        measured = state + noise()
        if k == due:
            under_way = np.stack([*torques[k:], torques[-1]])
            ahead = predict(measured.T, under_way.transpose(2, 0, 1), D, k * DT)[:, -1].T.copy()
            sampled.append(k)
            due += gap()
        Z[k] = ahead
        torques.append(arm.law(ahead, (k + LATE) * DT))
        arm.move(state, torques[k])
        arm.flow(ahead, (k + LATE) * DT)
        Z_end[k] = ahead
    X[steps] = state
    return Logged(X, Z, Z_end, sampled, torques)


def _hold(X: np.ndarray) -> list[np.ndarray]:
    """The torques before t = 0, which hold the arm against its weight."""
    torques = rigid_body.torques(xarm6.bodies(), [*X[:JOINTS]], [*X[JOINTS:]], [0.0] * JOINTS, 9.81, np)
    return [np.stack(np.broadcast_arrays(*torques, X[0])[:JOINTS])] * LATE


def tracking(X: np.ndarray) -> np.ndarray:
    """|X - reference|, the reference at 0, 1, 2, … ms."""
    return np.linalg.norm(X - npred.plant("xarm6").target(np.arange(len(X)) * DT), axis=1)


def rows(X: np.ndarray, Z: np.ndarray, ahead: np.ndarray) -> dict[str, float]:
    """The numbers of the figures, of states, predictions and the angles (., 6) that these are compared with."""
    errors, distances = tracking(X), np.linalg.norm(Z[:, :JOINTS] - ahead, axis=1)[:SECOND]
    values = errors.max(), errors[STEPS // 2 :].mean(), distances.max(), distances.mean()
    return dict(zip(ROWS, map(float, values), strict=True))


def as_meant(logged: Logged) -> dict[str, float]:
    """The numbers with all of one time."""
    X = logged.X[..., 0]
    return rows(X[:-1], logged.Z[:-LATE, :, 0], X[LATE:-1, :JOINTS])


def measure() -> Measurements:
    """As logged, each state after a step beside the reference before it, and each prediction after its step; and with
    all of one time. The loop itself is the same.
    """
    logged = loop()
    X, right = logged.X[..., 0], as_meant(logged)
    printed = rows(X[1:], logged.Z_end[: -LATE - 1, :, 0], X[LATE + 1 : -1, :JOINTS])
    return {row: Measured(printed[row], right[row]) for row in ROWS}


LOOP = NetworkLoop(
    partial(plants.make, "sampled_arm", SampledArm),
    partial(held, CELL),
    lambda predict, rng: loop(OTHERS_STEPS, of_means(predict), others(rng)),
    lambda predict: as_meant(loop(predict=of_means(predict))),
    calls=OTHERS_CALLS,
    kept=150,
    rounds=2,
    quadratic=True,
)


def clock() -> list[PredictionTime]:
    """The time of RK4 with one step for each millisecond."""
    return latency.of_loop(LOOP, {"RK4, 200 steps": ("rk4", LATE + 1), "RK4, 20 steps": ("rk4", 21)})


EXPERIMENT = Experiment(
    "arm with six joints, sampled and noisy",
    "Bhan, Quawas, Krstic, Shi, arXiv:2603.29119",
    tuple(PublishedNumber(row, "") for row in ROWS),
    measure,
    tuple(PublishedNumber(row, "", "fno") for row in ROWS),
    LoopNetworks({AS_MEANT: LOOP}, {"fno": {"epochs": 40}}),
    times=(PublishedTime(NUMERICAL, "RK4, 200 steps", 25.0), PublishedTime("fno", "RK4, 200 steps", 1.0)),
    clock=clock,
)
