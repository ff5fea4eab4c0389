"""Newton's method for the equilibrium."""

from collections.abc import Callable

import numpy as np

Residual = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
REST = 1e-9  # of max(1, |X|): below this residual X rests


def solve(residual: Residual, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
    """X, the residual there, and whether it is a root; `residual` gives value and Jacobian.

    The step is halved while the residual grows; ends when a step no longer changes X.
    """
    X = guess.copy()
    g, J = residual(X)
    for _ in range(100):
        if not np.isfinite(g).all() or not np.isfinite(J).all() or np.linalg.matrix_rank(J) < len(X):
            break
        step, scale = np.linalg.solve(J, g), 1.0
        while scale > 1e-8 and not np.linalg.norm(residual(X - scale * step)[0]) <= np.linalg.norm(g):
            scale /= 2
        if scale <= 1e-8 or np.array_equal(X - scale * step, X):
            break
        X = X - scale * step
        g, J = residual(X)
    return X, g, bool(np.linalg.norm(g) <= REST * max(1.0, float(np.linalg.norm(X))))
