"""A pendulum that one command turns twice, at once and h = π/4 s later: x1' = x2, x2' = sin x1 + u(t) + u(t - h).

Ponomarev, Nonlinear predictor feedback for input-affine systems with distributed input delays, arXiv:1601.00098,
eqs. 89-93 and 104. With y = ξ(h) and B = (0, 1) + β(h) the law is u = -B'y, where over 0 <= s <= h
    ξ' = (ξ2, sin ξ1 + u(t + s - h)), ξ(0) = x(t),    β' = [[0, 1], [cos ξ1, 0]] β, β(0) = (0, 1):
y is where x comes if no more commands are sent. The numbers are those of a public re-implementation.
"""

import math
from typing import Any

import numpy as np

import npred
from npred import plants
from npred_experiments.experiment import Experiment, Measured, Measurements, PublishedNumber

H, T, DT, U0 = math.pi / 4, 10.0, 0.01, 1.0
START = (math.pi, math.pi / 2)
CELLS = 160  # cells of h, in the loop as it is meant
PRINTED = {"x1(10)": "0.0392582942", "x2(10)": "-0.0211772422", "U(0+)": "-6.811116128"}


class CoastingPendulum:
    """ξ and β as the plant that the delayed command alone turns, to be predicted over h."""

    states, inputs = ("x1", "x2", "b1", "b2"), ("u",)

    @staticmethod
    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> list[Any]:
        return [x.x2, M.sin(x.x1) + u.u, x.b2, M.cos(x.x1) * x.b1]

    @staticmethod
    def kappa(x: Any, t: Any, p: Any, M: Any) -> list[Any]:
        """-B'y."""
        return [-(x.b1 * x.x1 + (1 + x.b2) * x.x2)]


def published(dt: float = DT, start: tuple[float, float] = START) -> np.ndarray:
    """x1(10), x2(10) and u(0+) of the re-implementation: Euler's method, h rounded to whole steps of dt for the plant
    and for the places of the commands, and divided into as many equal steps for ξ and β.
    """
    lag = round(H / dt)
    ds, count = H / lag, round(T / dt)
    u = np.concatenate([np.full(lag, U0), np.zeros(count)])
    x = np.array(start)
    for k in range(count):
        # the place of t + s - h, rounded to the grid, and not before the first command
        places = np.maximum(np.rint((k * dt + np.arange(lag) * ds - H) / dt).astype(int) + lag, 0)
        x1, x2, b1, b2 = *x.tolist(), 0.0, 1.0
        for command in u[places].tolist():
            x1, x2, b1, b2 = x1 + ds * x2, x2 + ds * (math.sin(x1) + command), b1 + ds * b2, b2 + ds * math.cos(x1) * b1
        u[lag + k] = -(b1 * x1 + (1 + b2) * x2)
        x = x + dt * np.array([x[1], math.sin(x[0]) + u[lag + k] + u[places[0]]])
    return np.array([*x, u[lag]])


def held(cells: int) -> np.ndarray:
    """The same with npred's RK4 for commands that are held over h / cells: of first order in it."""
    plant = plants.make("coasting_pendulum", CoastingPendulum)
    predictor = npred.predictor(plant, "rk4", nx=cells + 1)
    dt, c, x = H / cells, np.full(cells, U0), np.array(START)
    sent: list[float] = []
    while (left := T - len(sent) * dt) > 0:
        means = np.concatenate([c[:1], (c[:-1] + c[1:]) / 2, c[-1:]])  # about each node
        P = np.asarray(predictor([*x, 0.0, 1.0], means[:, None], H))[-1]
        sent.append(float(plant.kappa(P)[0]))
        x = _turned(x, sent[-1] + c[0], min(dt, left))
        c = np.append(c[1:], sent[-1])
    return np.array([*x, sent[0]])


def _turned(x: np.ndarray, torque: float, dt: float) -> np.ndarray:
    """x after dt under a constant torque, by the classical Runge-Kutta method."""

    def rate(x: np.ndarray) -> np.ndarray:
        return np.array([x[1], math.sin(x[0]) + torque])

    a = rate(x)
    b = rate(x + dt / 2 * a)
    c = rate(x + dt / 2 * b)
    return x + dt / 6 * (a + 2 * b + 2 * c + rate(x + dt * c))


def meant() -> np.ndarray:
    """The limit of commands that are never held, by Richardson's extrapolation of the first order."""
    return 2 * held(2 * CELLS) - held(CELLS)


def measure() -> Measurements:
    """The state after 10 s from (π, π / 2), and the first command."""
    pairs = zip(published().tolist(), meant().tolist(), strict=True)
    return {metric: Measured(*pair) for metric, pair in zip(PRINTED, pairs, strict=True)}


EXPERIMENT = Experiment(
    "pendulum, a command that acts twice",
    "ponomarev-2016-reproduction; Ponomarev, arXiv:1601.00098",
    tuple(PublishedNumber(metric, digits) for metric, digits in PRINTED.items()),
    measure,
)
