"""The predictors' maps for plants that are not traced: the same formulas on arrays (n, B), f called as it is.

A lane that leaves the finite numbers is NaN from there on, which its reader says in words: NumPy warns of nothing.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred import grid
from npred.plants.black_box import BlackBox


def on_lanes(plant: BlackBox) -> Callable[[np.ndarray, np.ndarray, Any], np.ndarray]:
    """f(x, u, t) with lanes last: x (n, B), u (m, B), t a number or (B,), to (n, B)."""
    return lambda x, u, t: plant.f(x.T, u.T, t).T


def sweep(plant: BlackBox, step: Callable[..., Any]) -> Callable[..., None]:
    """A one-step method over the nodes."""
    f = on_lanes(plant)

    @np.errstate(all="ignore")
    def predict(X: Any, u: np.ndarray, D_hat: np.ndarray, t: float, p: Any, P: np.ndarray) -> None:
        nx, h = len(P), D_hat / (len(P) - 1)
        middle = grid.refine(np.moveaxis(u, -1, 0), 2 * nx - 1)[:, 1::2].transpose(1, 2, 0)
        P[0] = X
        for j in range(nx - 1):
            P[j + 1] = step(f, P[j], u[j], middle[j], u[j + 1], t + j * h, h)

    return predict


def picard(plant: BlackBox, tolerance: float, sweeps: int) -> Callable[..., None]:
    """Successive approximations, all nodes in one call of f."""

    @np.errstate(all="ignore")
    def predict(X: Any, u: np.ndarray, D_hat: np.ndarray, t: float, p: Any, P: np.ndarray) -> None:
        h, times = D_hat / (len(P) - 1), t + np.arange(len(P))[:, None] * D_hat / (len(P) - 1)
        P[:] = X
        for _ in range(sweeps):
            f = np.moveaxis(plant.f(np.moveaxis(P, 1, -1), np.moveaxis(u, 1, -1), times), -1, 1)
            new = np.concatenate([P[:1], X + np.cumsum(h / 2 * (f[:-1] + f[1:]), axis=0)])
            change, size = np.abs(new - P).max(axis=(0, 1)), np.abs(new).max(axis=(0, 1))
            P[:] = new
            if (change <= tolerance * (1.0 + size)).all():
                return
        P[..., ~(change <= tolerance * (1.0 + size))] = np.nan

    return predict
