"""The grid of a network as NumPy matrices: features of u, and the transforms of an FNO."""

import numpy as np

from npred.base import grid

PERIOD = 2.0  # P is not periodic on [0, 1]: its functions are continued by zero to this length before the transform
GREGORY = np.array([95 / 288, 317 / 240, 23 / 30, 793 / 720, 157 / 160])  # the first weights of the rule, in intervals


def legendre(nx: int, count: int) -> np.ndarray:
    """The Legendre polynomials of degree 0 to count - 1 on [0, 1], each 1 at x = 1, at the nodes: (nx, count)."""
    return np.polynomial.legendre.legvander(2 * grid.nodes(nx) - 1, count - 1)


def moments(nx: int, count: int) -> np.ndarray:
    """(count, nx): nodal values to the moments of their piecewise linear interpolant, exact by Gauss's rule."""
    points, weights = np.polynomial.legendre.leggauss(count // 2 + 1)
    s, h = (points + 1) / 2, 1 / (nx - 1)  # where in its interval a point lies
    x = h * (np.arange(nx - 1)[:, None] + s)  # (nx - 1, points)
    L = np.polynomial.legendre.legvander(2 * x - 1, count - 1) * np.sqrt(2 * np.arange(count) + 1)
    L *= weights[:, None] * h / 2
    matrix = np.zeros((nx, count))
    matrix[:-1] += np.einsum("jpk,p->jk", L, 1 - s)
    matrix[1:] += np.einsum("jpk,p->jk", L, s)
    return matrix.T


def fourier(nx: int, modes: int) -> tuple[np.ndarray, np.ndarray]:
    """The real DFT of v, continued by zero over PERIOD and weighed by Gregory's rule, and its inverse on [0, 1].

    v_hat_k = int_0^1 v e^(-2 pi i k x / PERIOD) dx: (2 modes, nx), rows Re and Im of each mode;
    v(x) = (1/PERIOD) Re [v_hat_0 + 2 sum_k v_hat_k e^(2 pi i k x / PERIOD)]: (nx, 2 modes).
    """
    k = np.arange(modes)[:, None]
    angle = 2 * np.pi * k * grid.nodes(nx) / PERIOD  # (modes, nx)
    pairs = np.stack([np.cos(angle), -np.sin(angle)], axis=1).reshape(2 * modes, nx)
    twice = np.where(k > 0, 2.0, 1.0).repeat(2, axis=0) / PERIOD
    return pairs * gregory(nx), (pairs * twice).T


def gregory(nx: int) -> np.ndarray:
    """Trapezoidal weights (nx,), corrected at both ends to sixth order, so that a coarse grid trains for a fine one."""
    if nx < 2 * len(GREGORY):
        return grid.trapezoid(nx)
    weights = np.ones(nx)
    weights[: len(GREGORY)] = GREGORY
    weights[-len(GREGORY) :] = GREGORY[::-1]
    return weights / (nx - 1)
