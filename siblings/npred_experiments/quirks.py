"""The steps of the published loops that differ from their equations, apart from npred's engine, which does none of it.

Batched: a state is a tuple of components, a line of nodes an array (nx, m, ...); a component may be a float, too.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

State = tuple[Any, ...]


def half_cell_short(
    f: Callable[[State, Any], State], X: State, line: Iterable[Any], D_hat: Any, dx: float
) -> list[State]:
    """P at the nodes by P_j = X + D_hat trapz(F_0 … F_j), with F_j = f(P_j-1, u_j-1) one node late and F_0 = 0.

    That is Euler's method less half of its last cell; on nodes 0, dx, …, 1 - dx it ends (nx - 3/2) dx D_hat ahead, not
    D_hat. Right is any consistent rule on all of [0, 1].
    """
    half = 0.5 * dx * D_hat
    nodes, before = [X], (0.0,) * len(X)
    for inputs in line:
        rates = f(nodes[-1], inputs)
        nodes.append(tuple([p + half * (r + b) for p, r, b in zip(nodes[-1], rates, before, strict=True)]))
        before = rates
    del nodes[-1]  # the last node's own input is read by none
    return nodes


def in_rows(f: Callable[[State, Any], State], dx: float) -> Callable[..., np.ndarray]:
    """That rule with the call of npred's predictors: P (B, nx, n) of X (B, n), u (B, nx, m) and D_hat (B,)."""

    def predict(X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        nodes = half_cell_short(f, tuple(X.T), u.transpose(1, 2, 0), D_hat, dx)
        return np.array(nodes).transpose(2, 0, 1)

    return predict


def upwind(line: np.ndarray, courant: Any, inflow: Any) -> np.ndarray:
    """The actuator's line u_t = u_x / D after a step of dt, by u_j + courant (u_j+1 - u_j), courant = dt / (D dx).

    It smears what it carries, and nodes 0, dx, …, 1 - dx take it (nx - 1) dx D long. Right is to shift by D exactly.
    `courant` broadcasts to (nx - 1, m, ...), the inflow at the last node to (m, ...).
    """
    shifted = np.empty_like(line)
    shifted[:-1] = line[:-1] + courant * (line[1:] - line[:-1])
    shifted[-1] = inflow
    return shifted


def clipped(X: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The state within the joints' limits, as if a joint stopped there without a force. No loop reaches one."""
    return np.clip(X, low, high)


def logged(values: np.ndarray) -> np.ndarray:
    """Values as they come back from a float32 log: 3e-8 of a prediction error of 0 remain."""
    return values.astype(np.float32).astype(float)


def static_hold(command: np.ndarray, steps: int) -> list[np.ndarray]:
    """The commands before t = 0: as many copies of one, so that the plant rests until the first prediction acts."""
    return [command] * steps


def uniform(draws: np.random.RandomState, runs: int, *ranges: Sequence[Any]) -> list[np.ndarray]:
    """Per run, in this order, a draw of each range (low, high, size); the legacy generator of NumPy."""
    rows = [[draws.uniform(low, high, size) for low, high, size in ranges] for _ in range(runs)]
    return [np.stack(column, axis=-1) for column in zip(*rows, strict=True)]
