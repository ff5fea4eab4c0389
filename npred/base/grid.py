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
    """Nodal values (..., nodes, m) of a smooth function on nx nodes: the cubic through four neighbours.

    Linear where there are fewer than four nodes. For inputs, which jump: `means`.
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


def lines(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The begin and the end (..., nodes - 1, m) of the straight lines by which inputs (..., nodes, m) are read.

    A node has the mean of u over the cell around it. npred/kernels/c/reading.h is this in C, and says how.
    """
    nothing = np.zeros_like(u[..., :1, :])
    rise = np.diff(u, axis=-2)
    d0, d1, d2, d3 = (
        np.concatenate([*before * [nothing], rise, *after * [nothing]], axis=-2)[..., cut, :]
        for before, after, cut in (
            (2, 0, slice(None, -1)),
            (1, 0, slice(None)),
            (0, 1, slice(None)),
            (0, 2, slice(1, None)),
        )
    )
    size, outer = np.abs(d1 + d2), np.maximum(np.abs(d0), np.abs(d3))
    q = np.minimum(np.minimum(np.abs(d1), np.abs(d2)), np.maximum(0.125 * size, 0.5 * size - outer))
    q = np.where(d1 * d2 > 0, np.sign(d1) * q, 0.0)
    before, after = q[..., :-1, :], q[..., 1:, :]
    first = 0.5 * (rise + before - after)
    mean, room = u[..., :-1, :] + first, np.minimum(np.abs(first), np.abs(rise - first))
    slope = np.maximum(np.minimum(rise - before - after, room), -room)
    return mean - slope, mean + slope


def means(u: np.ndarray, nx: int) -> np.ndarray:
    """Inputs (..., nodes, m), means over the cells of their nodes, on nx other nodes (..., nx, m), read by `lines`."""
    last = u.shape[-2] - 1
    if nx == last + 1:
        return u
    begin, end = lines(u)
    before = np.concatenate([0 * u[..., :1, :], np.cumsum((begin + end) / 2, axis=-2)], axis=-2)
    edges = np.clip((np.arange(nx + 1) - 0.5) / (nx - 1), 0.0, 1.0) * last
    cell = np.minimum(edges.astype(int), last - 1)
    part = (edges - cell)[:, None]
    first = begin[..., cell, :]
    total = before[..., cell, :] + part * (first + part / 2 * (end[..., cell, :] - first))
    return np.diff(total, axis=-2) / np.diff(edges)[:, None]


def straight(values: np.ndarray, nx: int) -> np.ndarray:
    """Nodal values (..., nodes, m) on nx nodes, by straight lines between the nodes."""
    last = values.shape[-2] - 1
    s = nodes(nx) * last
    cell = np.minimum(s.astype(int), last - 1)
    first = values[..., cell, :]
    return first + (s - cell)[:, None] * (values[..., cell + 1, :] - first)
