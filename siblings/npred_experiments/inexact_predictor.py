"""Two commands that come after 0.4 and 0.5 s, and a predictor that takes 0.45 s for both.

Fang, Zhang, Inexact predictor feedback for multi-input nonlinear systems with distinct input delays, Automatica 159
(2024) 111399, eqs. 35-40:
    x1' = x2,  x2' = -x1 + sin x1 + x2 + u1(t - 0.4) + tanh u1(t - 0.4) + sin u2(t - 0.5),
    u1 = -3 P1 - 5 P2,  u2 = -10 P1 - 10 P2,
from (1, 1) with zero inputs before. The numbers are those of a public audit of that example.
"""

import cmath
import math
from typing import Any

import numpy as np

import npred
from npred import plants
from npred_experiments.experiment import Experiment, Measured, Measurements, PublishedNumber

D0, D1, D2, T, START, DT = 0.45, 0.4, 0.5, 10.0, (1.0, 1.0), 0.0005
DIGITS, MOST = 2e-13, 60  # accuracy and number of fixed-point iterations for the command of now
NEAR = 0.68 + 53.15j  # where Newton's method for the root starts
PRINTED = {
    "P1(0)": "1.53888738890506",
    "P2(0)": "1.39688078315917",
    "U1(0+)": "-11.6010660825110",
    "U2(0+)": "-29.3576817206423",
    "|x(10)|, step 0.0005 s": "0.0146589049",
    "real part of the root": "0.68210181334501",
    "imaginary part of the root": "53.14886591907897",
}
Pair = tuple[float, float]


class InexactlyPredicted:
    """The plant as its predictor takes it: one delay."""

    states, inputs = ("x1", "x2"), ("u1", "u2")

    @staticmethod
    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> list[Any]:
        return [x.x2, -x.x1 + M.sin(x.x1) + x.x2 + u.u1 + M.tanh(u.u1) + M.sin(u.u2)]

    @staticmethod
    def kappa(x: Any, t: Any, p: Any, M: Any) -> list[Any]:
        return [-3 * x.x1 - 5 * x.x2, -10 * x.x1 - 10 * x.x2]


def law(P: Pair) -> Pair:
    """u1 and u2."""
    return -3 * P[0] - 5 * P[1], -10 * P[0] - 10 * P[1]


def force(u1: float, u2: float) -> float:
    """The commands' share of x2'."""
    return u1 + math.tanh(u1) + math.sin(u2)


def forces(start: Pair, end: Pair) -> tuple[float, float, float]:
    """The forces at the start, the middle and the end of a step, for commands that are linear in it."""
    middle = force((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
    return force(*start), middle, force(*end)


def stepped(x: Pair, by: tuple[float, float, float], h: float) -> Pair:
    """x after a step of the classical Runge-Kutta method."""
    (x1, x2), (first, middle, last) = x, by
    a1, a2 = x2, -x1 + math.sin(x1) + x2 + first
    y1, y2 = x1 + h / 2 * a1, x2 + h / 2 * a2
    b1, b2 = y2, -y1 + math.sin(y1) + y2 + middle
    y1, y2 = x1 + h / 2 * b1, x2 + h / 2 * b2
    c1, c2 = y2, -y1 + math.sin(y1) + y2 + middle
    y1, y2 = x1 + h * c1, x2 + h * c2
    d1, d2 = y2, -y1 + math.sin(y1) + y2 + last
    return x1 + h / 6 * (a1 + 2 * b1 + 2 * c1 + d1), x2 + h / 6 * (a2 + 2 * b2 + 2 * c2 + d2)


def audited(dt: float = DT, t_end: float = T) -> tuple[Pair, Pair, Pair]:
    """P(0), U(0+) and x(t_end) of the audit: commands linear between steps of dt, that of now by iteration."""
    ahead, late1, late2 = (round(D / dt) for D in (D0, D1, D2))
    zero, count = (0.0, 0.0), round(t_end / dt)
    U: list[Pair] = []
    pushes: list[tuple[float, float, float]] = []  # for the step after each time
    x, first = START, START

    def command(k: int, which: int) -> Pair:
        """That input at the start and the end of step k; both are 0 before t = 0."""
        return (U[k][which], U[k + 1][which]) if k >= 0 else zero

    for k in range(count + 1):
        P = x
        for j in range(k - ahead, k - 1):
            P = stepped(P, pushes[j] if j >= 0 else (0.0, 0.0, 0.0), dt)
        if k == 0:
            first = stepped(P, (0.0, 0.0, 0.0), dt)
            U.append(law(first))
        else:
            U.append(_current(P, U[-1], dt))
            pushes.append(forces(U[-2], U[-1]))
        if k < count:
            (a, b), (c, d) = command(k - late1, 0), command(k - late2, 1)
            x = stepped(x, forces((a, c), (b, d)), dt)
    return first, U[0], x


def _current(P: Pair, last: Pair, dt: float) -> Pair:
    """The command of now: the last step of the prediction ends with it."""
    u = last
    for _ in range(MOST):
        before, u = u, law(stepped(P, forces(last, u), dt))
        if max(abs(u[0] - before[0]), abs(u[1] - before[1])) < DIGITS * max(1.0, abs(u[0]), abs(u[1])):
            break
    return u


def held(dt: float = DT, t_end: float = T) -> np.ndarray:
    """P(0), U(0+) and |x(t_end)| with npred's RK4, each command held over dt, which divides 0.05 s: of first order."""
    plant = plants.make("inexactly_predicted", InexactlyPredicted)
    ahead, late1, late2 = (round(D / dt) for D in (D0, D1, D2))
    predictor = npred.predictor(plant, "rk4", nx=ahead + 1)
    past, x = np.zeros((late2, 2)), START  # the commands of the last 0.5 s
    first = np.zeros(4)
    for k in range(round(t_end / dt)):
        c = past[-ahead:]
        means = np.concatenate([c[:1], (c[:-1] + c[1:]) / 2, c[-1:]])  # about each node
        P = np.asarray(predictor(x, means, D0))[-1]
        u = plant.kappa(P)
        first = np.concatenate([P, u]) if k == 0 else first
        push = force(float(past[-late1, 0]), float(past[0, 1]))
        x, past = stepped(x, (push, push, push), dt), np.concatenate([past[1:], u[None]])
    return np.array([*first, math.hypot(*x)])


def determinant(s: complex) -> complex:
    """det M(s) of the loop at rest: M = s - A - C1 - C2 - exp(A D0) [C1 (e^-sD1 - e^-sD0) + C2 (e^-sD2 - e^-sD0)].

    A = [[0, 1], [0, 1]], and C1 = [[0, 0], [-6, -10]] and C2 = [[0, 0], [-10, -10]] are the inputs' effects times the
    law. P' = A P + (C1 + C2) P + exp(A D0) [what acts on x less what was predicted to act], by the formula for P.
    """
    e1, e2 = (cmath.exp(-s * D) - cmath.exp(-s * D0) for D in (D1, D2))
    row = -6 * e1 - 10 * e2, -10 * e1 - 10 * e2
    grown = math.exp(D0)  # exp(A D0) takes (0, 1) to (grown - 1, grown)
    a, b = s - (grown - 1) * row[0], -1 - (grown - 1) * row[1]
    return a * (s - 1 + 20 - grown * row[1]) - b * (16 - grown * row[0])


def root(s: complex = NEAR) -> complex:
    """The root of `determinant` near s, by the secant method."""
    before, value = s + 1e-3, determinant(s + 1e-3)
    for _ in range(MOST):
        here = determinant(s)
        if here == value or abs(s - before) < 1e-15 * abs(s):
            break
        before, value, s = s, here, s - here * (s - before) / (here - value)
    return s


def measure() -> Measurements:
    """The first prediction and commands, the distance after 10 s, and a root of the loop at rest."""
    first, u, x = audited()
    s = root()
    published, right = [*first, *u, math.hypot(*x), s.real, s.imag], [*held().tolist(), None, None]
    return {metric: Measured(*pair) for metric, *pair in zip(PRINTED, published, right, strict=True)}


EXPERIMENT = Experiment(
    "two distinct delays, predicted as one",
    "fang-2024-reproduction; Fang, Zhang, Automatica 159 (2024) 111399",
    tuple(PublishedNumber(metric, digits) for metric, digits in PRINTED.items()),
    measure,
)
