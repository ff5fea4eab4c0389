"""The wheeled robot under a law of Pomet's kind, on arrays, with the law as three published loops have it."""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred import plants
from npred.plants import Plant
from npred.plants.builtin.unicycle import Unicycle
from npred_experiments import quirks
from npred_experiments.quirks import State

Law = Callable[[State, Any], tuple[Any, Any]]


class UnicycleOneDelay(Unicycle):
    """The robot with both inputs equally late, and the law as it is meant."""

    delays = period = None


def f(X: State, u: Any) -> State:
    """x' = v cos θ, y' = v sin θ, θ' = ω with u = (v, ω)."""
    return u[0] * np.cos(X[2]), u[0] * np.sin(X[2]), u[1]


def published_law(X: State, t: Any) -> tuple[Any, Any]:
    """(v, ω) with v = -p + 5 q sin 3t - cos 3t + q ω: the bracket of 5 q (sin 3t - cos 3t) is lost.

    Without delay it does not lead to the origin: |X| comes back to 0.35.
    """
    p, q, omega = _turn(X, t)
    return -p + 5 * q * np.sin(3 * t) - np.cos(3 * t) + q * omega, omega


def right_law(X: State, t: Any) -> tuple[Any, Any]:
    """(v, ω) with v = -p + 5 q (sin 3t - cos 3t) + q ω (Pomet, Systems & Control Letters 18, 1992, 147-158)."""
    p, q, omega = _turn(X, t)
    return -p + 5 * q * (np.sin(3 * t) - np.cos(3 * t)) + q * omega, omega


def _turn(X: State, t: Any) -> tuple[Any, Any, Any]:
    """p, q and ω."""
    x, y, theta = X
    p, q = x * np.cos(theta) + y * np.sin(theta), x * np.sin(theta) - y * np.cos(theta)
    swing = np.cos(3 * t)
    return p, q, -5 * p**2 * swing - p * q * (1 + 25 * swing**2) - theta


half_cell_short = quirks.in_rows(f, dx=0.01)  # the published predictor


def plant() -> Plant:
    """The robot with one delay."""
    return plants.make("unicycle_one_delay", UnicycleOneDelay)
