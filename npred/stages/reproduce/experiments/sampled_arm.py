"""Six joints of an arm that follow a wave, every torque 0.2 s late, the state sampled at random times and with noise.

Bhan, Quawas, Krstic, Shi, Sampling-Horizon Neural Operator Predictors for Nonlinear Control under Delayed Inputs,
arXiv:2603.29119. Between samples the controller's prediction Z follows the loop without delay, Z' = f(Z, κ(Z, t + D)).
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np

import npred
from npred import plants
from npred.delays import family_of
from npred.plants.builtin.xarm6 import XArm6
from npred.predictors import RK4
from npred.results.reproduce import PredictionTime
from npred.robots import rigid_body, xarm6
from npred.stages.reproduce import latency
from npred.stages.reproduce.experiment import (
    NUMERICAL,
    Experiment,
    Measured,
    Measurements,
    PublishedNumber,
    PublishedTime,
)

D, DT, STEPS, LATE, JOINTS = 0.2, 0.001, 20000, 200, 6
NOISE, GAPS, STRONGEST, SECOND = 0.005, (20, 101), 60.0, 1000  # of 1 ms
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
        self._arm, self._loop = (family_of(plant).advance(RK4.step) for plant in (arm, loop))
        self._control, self.p = family_of(arm).control(RK4.step), arm.p
        self._whole, self._none = np.ones((JOINTS, 1)), np.zeros((JOINTS, 1))

    def move(self, X: np.ndarray, torque: np.ndarray) -> None:
        """X (12, 1) after a step, in place."""
        self._arm(X, torque, torque, self._whole, DT, 0.0, self.p)

    def flow(self, Z: np.ndarray, t: float) -> None:
        """Z (12, 1) after a step of the loop without delay from time t, in place."""
        self._loop(Z, self._none, self._none, self._whole, DT, t, self.p)

    def law(self, Z: np.ndarray, t: float) -> np.ndarray:
        """κ(Z, t) within the limits, (6, 1)."""
        U = np.empty((JOINTS, 1))
        self._control(np.stack([Z, Z]), np.zeros((2, JOINTS, 1)), np.zeros(1), t, self.p, U)
        return np.clip(U, -STRONGEST, STRONGEST)


@cache
def kernels() -> Kernels:
    """They, compiled once."""
    return Kernels()


class Logged(NamedTuple):
    """X (N + 1, 12), Z (N, 12) at the begin of each step and at its end, the steps that sampled, and the torques, each
    (6, 1), from those before t = 0 on.
    """

    X: np.ndarray
    Z: np.ndarray
    Z_end: np.ndarray
    sampled: list[int]
    torques: list[np.ndarray]


def loop(steps: int = STEPS) -> Logged:
    """The published loop.

    The published predictor iterates the trapezoidal rule on quarters of a step to 1e-8; here a step is one of the
    classical Runge-Kutta method, nearer to the same exact prediction.
    """
    starts, draws, arm = np.random.default_rng(0), np.random.default_rng(0), kernels()
    state = np.concatenate([starts.uniform(-0.01, 0.01, JOINTS), starts.uniform(-0.01, 0.01, JOINTS)])[:, None]
    torques, sampled, due = _held(state[:, 0]), [], 0
    X, (Z, Z_end), ahead = np.empty((steps + 1, 12)), np.empty((2, steps, 12)), state.copy()
    for k in range(steps):
        X[k] = state[:, 0]
        noise = np.concatenate([draws.normal(0.0, NOISE, JOINTS), draws.normal(0.0, NOISE, JOINTS)])
        if k == due:
            ahead = state + noise[:, None]
            for torque in torques[k:]:
                arm.move(ahead, torque)
            sampled.append(k)
            due += int(draws.integers(*GAPS))
        Z[k] = ahead[:, 0]
        torques.append(arm.law(ahead, k * DT + D))
        arm.move(state, torques[k])
        arm.flow(ahead, k * DT + D)
        Z_end[k] = ahead[:, 0]
    X[steps] = state[:, 0]
    return Logged(X, Z, Z_end, sampled, torques)


def _held(X: np.ndarray) -> list[np.ndarray]:
    """The torques before t = 0, which hold the arm against its weight."""
    q, rates = X[:JOINTS].tolist(), X[JOINTS:].tolist()
    hold = rigid_body.torques(xarm6.bodies(), q, rates, [0.0] * JOINTS, 9.81, np)
    return [np.array(hold, dtype=float)[:, None]] * LATE


def tracking(X: np.ndarray) -> np.ndarray:
    """|X - reference|, the reference at 0, 1, 2, … ms."""
    return np.linalg.norm(X - npred.plant("xarm6").target(np.arange(len(X)) * DT), axis=1)


def rows(X: np.ndarray, Z: np.ndarray, ahead: np.ndarray) -> dict[str, float]:
    """The numbers of the figures, of states, predictions and the angles (., 6) that these are compared with."""
    errors, distances = tracking(X), np.linalg.norm(Z[:, :JOINTS] - ahead, axis=1)[:SECOND]
    values = errors.max(), errors[STEPS // 2 :].mean(), distances.max(), distances.mean()
    return dict(zip(ROWS, map(float, values), strict=True))


def measure() -> Measurements:
    """As logged, each state after a step beside the reference before it, and each prediction after its step; and with
    all of one time. The loop itself is the same.
    """
    X, Z, Z_end, *_ = loop()
    logged = rows(X[1:], Z_end[: -LATE - 1], X[LATE + 1 : -1, :JOINTS])
    right = rows(X[:-1], Z[:-LATE], X[LATE:-1, :JOINTS])
    return {row: Measured(logged[row], right[row]) for row in ROWS}


def calls() -> latency.PredictorInputs:
    """Predictions from exact states of the loop's first seconds, with the torques that are under way."""
    logged = loop(STEPS // 10)
    starts = range(LATE, len(logged.torques) - LATE, 20)
    u = np.array([logged.torques[k : k + LATE + 1] for k in starts])[..., 0]
    t = DT * np.array(starts)
    return latency.PredictorInputs(logged.X[[*starts]], u, np.full(len(t), D), t)


def clock() -> list[PredictionTime]:
    """The time of RK4 with one step for each millisecond."""
    methods = {"RK4, 200 steps": ("rk4", LATE + 1)}
    return latency.numerical(plants.make("sampled_arm", SampledArm), calls(), methods)


EXPERIMENT = Experiment(
    "arm with six joints, sampled and noisy",
    "Bhan, Quawas, Krstic, Shi, arXiv:2603.29119",
    tuple(PublishedNumber(row, "") for row in ROWS),
    measure,
    times=(PublishedTime(NUMERICAL, "RK4, 200 steps", 25.0), PublishedTime("fno", "RK4, 200 steps", 1.0)),
    clock=clock,
)
