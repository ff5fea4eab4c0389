"""Features of the actuator state u(x) for networks: linear functionals of its interpolant, the same on every grid."""

from functools import lru_cache

import torch
from torch import Tensor

from npred.operators import matrices


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
    """npred.operators.matrices.legendre, (nx, count), as a tensor."""
    return torch.as_tensor(matrices.legendre(nx, count), dtype=dtype, device=device)


@lru_cache(maxsize=32)
@torch.inference_mode(False)  # what an inference run caches must serve training too
def moment_matrix(nx: int, count: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """npred.operators.matrices.moments, (count, nx), as a tensor."""
    return torch.as_tensor(matrices.moments(nx, count), dtype=dtype, device=device)
