"""A linearly implicit method, for stiff plants of any kind, and the A y = b that it solves.

The matrix I - h γ f_X of an implicit method may have any pivots. Rows are exchanged by M.where on the values, so that a
kernel needs no branch; a pivot that is 1 by structure, as of a position whose rate is a state, is taken without a
search, and entries that are 0 by structure cost nothing. Golub, Van Loan, Matrix Computations, sec. 3.4.
"""

import math
from collections.abc import Callable

import numpy as np

from npred.formulas import Array, Value, ldl, programs
from npred.formulas.called_functions import whole
from npred.formulas.tape import M, Symbol, nonzero
from npred.formulas.trace import Trace
from npred.prediction.methods.base import OneStep

GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
Vector = list[Value]
Replay = Callable[[Vector], None]  # applies a step of the elimination to a right side


class Rosenbrock(OneStep):
    """ROS2 with gamma = 1 - 1/sqrt(2): order 2, L-stable, two linear systems with one matrix per step.

    With W = I - gamma h f_X and d = f_t h + f_U (u1 - u0):
        W k1 = f(x, u0, t) + gamma d,   W k2 = f(x + h k1, u1, t + h) - 2 k1 - gamma d,
        x(t + h) = x + h (3 k1 + k2) / 2.
    The term d keeps the order where a stiff plant follows its inputs; f_X, f_t and f_U come from the traced f.
    Verwer, Spee, Blom, Hundsdorfer, SIAM J. Sci. Comput. 20 (1999) 1456. Raises ConfigError for a plant that is not
    traced.
    """

    name, order = "rosenbrock", 2

    @staticmethod
    @whole
    def step(f: Trace, x: Array, u0: Array, um: Array, u1: Array, t: Value, h: Value) -> Array:
        velocity, jacobian, d = linearised(f, x, u0, t, None if u0 is u1 else u1 - u0, h)
        solve = solver((np.eye(len(x)) - GAMMA * h * jacobian).tolist())
        k1 = np.array(solve([*(velocity + GAMMA * d)]), dtype=object)
        k2 = np.array(solve([*(f(x + h * k1, u1, t + h) - 2.0 * k1 - GAMMA * d)]), dtype=object)
        return x + h * (1.5 * k1 + 0.5 * k2)


def linearised(
    f: Callable[..., np.ndarray], x: np.ndarray, u: np.ndarray, t: Value, du: np.ndarray | None, dt: Value
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """f (n,), f_X (n, n) and its change f_U du + f_t dt (n,) at symbols x, u, t; without du the inputs are constant.

    What vanishes by structure is the number 0, so that programs leave it out.
    """
    y = f(x, u, t)
    units = np.eye(len(x)).tolist()
    columns = [programs.derivative(y, x, unit) for unit in units]
    moving = [] if du is None else list(zip(u, du, strict=True))
    moving += [(t, dt)] if isinstance(t, Symbol) else []
    change = programs.derivative(y, *zip(*moving, strict=True)) if moving else [0.0] * len(y)
    return np.asarray(y), np.array(columns, dtype=object).T, np.array(change, dtype=object)


def solver(A: list[Vector]) -> Callable[[Vector], Vector]:
    """The function b -> y of A y = b, for several right sides with the same factors."""
    rows, order = [list(row) for row in A], []
    replays: list[Replay] = []
    left = list(range(len(rows)))
    while left:
        pivot = next((i for i in left if _is_one(rows[i][i])), left[0])
        searched = not _is_one(rows[pivot][pivot])
        left.remove(pivot)
        below = [i for i in left if nonzero(rows[i][pivot])]
        for i in below if searched else ():
            replays.append(_exchange(rows, pivot, i, [pivot, *left]))
        rows[pivot][pivot] = 1.0 / rows[pivot][pivot]
        for i in below:
            replays.append(_eliminate(rows, pivot, i, left))
        order.append(pivot)

    def solve(b: Vector) -> Vector:
        y = list(b)
        for replay in replays:
            replay(y)
        for k in reversed(range(len(order))):
            i = order[k]
            y[i] = ldl.minus(y[i], (rows[i][j] * y[j] for j in order[k + 1 :])) * rows[i][i]
        return y

    return solve


def _is_one(a: Value) -> bool:
    return not isinstance(a, Symbol) and a == 1


def _exchange(rows: list[Vector], k: int, i: int, columns: list[int]) -> Replay:
    """Rows k and i exchanged where the pivot of i is larger."""
    larger = abs(rows[k][k]) < abs(rows[i][k])
    for j in columns:
        a, b = rows[k][j], rows[i][j]
        rows[k][j], rows[i][j] = M.where(larger, b, a), M.where(larger, a, b)

    def replay(y: Vector) -> None:
        y[k], y[i] = M.where(larger, y[i], y[k]), M.where(larger, y[k], y[i])

    return replay


def _eliminate(rows: list[Vector], k: int, i: int, columns: list[int]) -> Replay:
    """Row i less the multiple of row k that its entry below the pivot asks for."""
    factor = rows[i][k] * rows[k][k]
    for j in columns:
        rows[i][j] = rows[i][j] - factor * rows[k][j]

    def replay(y: Vector) -> None:
        y[i] = y[i] - factor * y[k]

    return replay
