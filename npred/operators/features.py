"""Features of the actuator state u(x) for networks: linear functionals of its interpolant, the same on every grid."""

from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from npred import grid


def moments(u: Tensor, count: int) -> Tensor:
    """int_0^1 u(x) L_k(x) dx (B, count, m) of u (B, nx, m), with L_k the orthonormal Legendre polynomials on [0, 1]."""
    return moment_matrix(u.shape[-2], count, u.dtype, u.device) @ u


def running_mean(u: Tensor, stride: int = 1) -> Tensor:
    """(1/x) int_0^x u(y) dy at every stride-th node, by trapezoids over all, u(0) at x = 0; (B, nx, m) of u (B, nx, m).

    It bends where u jumps, and so does P: no smooth function of x follows it there.
    """
    sums = torch.cumsum(u[:, 1:] + u[:, :-1], dim=1)[:, stride - 1 :: stride]  # 2 (nx - 1) int_0^x u
    steps = torch.arange(stride, u.shape[1], stride, dtype=u.dtype, device=u.device)[:, None]
    return torch.cat([u[:, :1], sums / (2 * steps)], dim=1)


@lru_cache(maxsize=32)
@torch.inference_mode(False)  # what an inference run caches must serve training too
def legendre(nx: int, count: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """The Legendre polynomials of degree 0 to count - 1 on [0, 1], each 1 at x = 1, at the nodes: (nx, count)."""
    values = np.polynomial.legendre.legvander(2 * grid.nodes(nx) - 1, count - 1)
    return torch.as_tensor(values, dtype=dtype, device=device)


@lru_cache(maxsize=32)
@torch.inference_mode(False)  # what an inference run caches must serve training too
def moment_matrix(nx: int, count: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """(count, nx): nodal values to the moments of their piecewise linear interpolant, exact by Gauss's rule."""
    points, weights = np.polynomial.legendre.leggauss(count // 2 + 1)
    s, h = (points + 1) / 2, 1 / (nx - 1)  # where in its interval a point lies
    x = h * (np.arange(nx - 1)[:, None] + s)  # (nx - 1, points)
    L = np.polynomial.legendre.legvander(2 * x - 1, count - 1) * np.sqrt(2 * np.arange(count) + 1)
    L *= weights[:, None] * h / 2
    matrix = np.zeros((nx, count))
    matrix[:-1] += np.einsum("jpk,p->jk", L, 1 - s)
    matrix[1:] += np.einsum("jpk,p->jk", L, s)
    return torch.as_tensor(matrix.T, dtype=dtype, device=device)
