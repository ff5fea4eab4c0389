"""The functionals of the stability proof, along a recorded loop [DAPF, sec. IV]."""

import numpy as np
from numpy.typing import ArrayLike


def W(N: ArrayLike, D: float, D_hat: ArrayLike, gamma: float, b: float) -> np.ndarray:
    """W = D log N + (b / gamma) (D - D_hat)² [DAPF, proof of Theorem 3], N = 1 + V + b ∫₀¹ (1+x) w² dx; all (...)."""
    return D * np.log(N) + b / gamma * (D - np.asarray(D_hat)) ** 2


def Gamma(X: ArrayLike, X_star: ArrayLike, energy: ArrayLike, D: float, D_hat: ArrayLike) -> np.ndarray:
    """Gamma = |X - X*|² + ∫_{t-D}^t |U - U*|² ds + (D - D_hat)² [DAPF, Theorem 3, shifted to the equilibrium].

    X (..., n); energy, the integral, and D_hat (...).
    """
    return np.sum(np.subtract(X, X_star) ** 2, axis=-1) + energy + (D - np.asarray(D_hat)) ** 2
