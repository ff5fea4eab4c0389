"""The functionals of the stability proof, along a recorded loop [DAPF, sec. IV]."""

import numpy as np


def W(N: np.ndarray, D: float, D_hat: np.ndarray, gamma: float, b: float) -> np.ndarray:
    """W = D log N + (b / gamma) (D - D_hat)² [DAPF, proof of Theorem 3], N = 1 + V + b ∫₀¹ (1+x) w² dx; all (...)."""
    return D * np.log(N) + b / gamma * (D - D_hat) ** 2


def Gamma(X: np.ndarray, X_star: np.ndarray, energy: np.ndarray, D: float, D_hat: np.ndarray) -> np.ndarray:
    """Gamma = |X - X*|² + ∫_{t-D}^t |U - U*|² ds + (D - D_hat)² [DAPF, Theorem 3, shifted to the equilibrium].

    X (..., n); energy, the integral, and D_hat (...).
    """
    return np.sum((X - X_star) ** 2, axis=-1) + energy + (D - D_hat) ** 2
