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


def refine(values: np.ndarray, nx: int) -> np.ndarray:
    """Nodal values (..., nodes, m) on nx nodes: the cubic through four neighbours, as RK4 reads u between nodes.

    Linear where there are fewer than four nodes.
    """
    return read(values, nodes(nx))


def read(values: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Nodal values (..., nodes, m) at points x (k,) of [0, 1], (..., k, m), as `refine` reads them; exact at nodes."""
    first, weights = stencil(values.shape[-2], x)
    result = np.zeros(())
    for k, weight in enumerate(weights):
        result = result + weight[:, None] * values[..., first + k, :]
    return result


def stencil(nx: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first of the nodes that points x (k,) are read from, (k,), and the weights of these and the next ones."""
    width = 4 if nx > 3 else 2
    s = x * (nx - 1)
    first = np.clip(np.floor(s).astype(int) - (width // 2 - 1), 0, nx - width)
    t = s - first  # position among the neighbours 0 … width - 1
    others = [[j for j in range(width) if j != k] for k in range(width)]
    return first, np.array([np.prod([(t - j) / (k - j) for j in others[k]], axis=0) for k in range(width)])
