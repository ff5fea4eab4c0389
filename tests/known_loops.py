"""Loops of one state of which all is known: at 1 until they settle, then where they end."""

from collections.abc import Sequence

import numpy as np

from npred.loop.closed_loop import Samples, Trajectories

T = np.arange(101.0)  # s
NEVER = 999


def known_loops(settled: Sequence[int], ends: Sequence[float]) -> Trajectories:
    """A loop for each time (s) at which it settles; one that NEVER does stays at 1."""
    X = np.where(np.array(settled)[:, None] > T, 1.0, np.array(ends)[:, None])[..., None]
    zeros, never = np.zeros(X.shape[:-1]), np.full(len(X), -1)
    nothing = Samples(*[np.empty((len(X), 0))] * 3)
    return Trajectories(
        T, X, zeros[..., None], zeros, zeros, zeros, never, nothing, X, never, 0.0 * never, 0.0 * never,
        X[:, 0], zeros > 0, 0 * never, zeros > 0, 0 * never, zeros > 0, 0 * never, len(T),
    )  # fmt: skip
