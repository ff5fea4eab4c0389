"""Nodes on [0, 1], both ends in, and the quadrature over them."""

import numpy as np


def nodes(nx: int) -> np.ndarray:
    """x_j = j / (nx - 1), shape (nx,)."""
    return np.linspace(0.0, 1.0, nx)


def trapezoid(nx: int) -> np.ndarray:
    """Weights q with sum_j q_j g(x_j) ~ the integral of g over [0, 1]; second order. Shape (nx,)."""
    weights = np.full(nx, 1.0 / (nx - 1))
    weights[[0, -1]] /= 2
    return weights


def count(dx: float) -> int:
    """The nx whose spacing is dx: dx = 0.01 is nx = 101."""
    return round(1 / dx) + 1
