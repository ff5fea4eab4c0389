"""Held-out samples on any grid, to compare runtimes and methods on."""

import numpy as np

from npred import grid
from npred.data.dataset import Dataset
from npred.plants.base import Plant
from npred.predictors.rk4 import RK4

Probe = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # X (B, n), u (B, nx, m), D_hat and t (B,)


def probe(held_out: Dataset, count: int, nx: int) -> Probe:
    """At most `count` samples, spread over the data; a time that is not known is 0."""
    rows = np.linspace(0, len(held_out) - 1, min(count, len(held_out))).astype(int)
    return held_out.X[rows], grid.refine(held_out.u[rows], nx), held_out.D_hat[rows], np.nan_to_num(held_out.t[rows])


def eps(plant: Plant, P_hat: np.ndarray, samples: Probe) -> float:
    """sup |P̂ - P| over samples and nodes [DAPF, Theorem 2], P by RK4 on the nodes of P_hat (B, nx, n)."""
    P = RK4(plant, P_hat.shape[1])(*samples)
    return float(np.linalg.norm(P_hat - P, axis=-1).max())
