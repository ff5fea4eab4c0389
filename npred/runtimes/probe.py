"""Held-out samples on any grid, to compare runtimes and methods on."""

import numpy as np

from npred import grid
from npred.data.dataset import Dataset

Probe = tuple[np.ndarray, np.ndarray, np.ndarray]


def probe(held_out: Dataset, count: int, nx: int) -> Probe:
    """X (B, n), u (B, nx, m) and D_hat (B,) of at most `count` samples, spread over the data."""
    rows = np.linspace(0, len(held_out) - 1, min(count, len(held_out))).astype(int)
    return held_out.X[rows], grid.refine(held_out.u[rows], nx), held_out.D_hat[rows]
