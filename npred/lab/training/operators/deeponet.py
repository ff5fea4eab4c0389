"""DeepONet [Lu et al. 2021, doi:10.1038/s42256-021-00302-5], and the view of u(x) that other networks build on too.

Features of u are linear functionals of its interpolant, the same on every grid.
"""

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils._pytree import tree_map

from npred.networks import matrices
from npred.networks.deeponet import DEGREE


class DeepONetwork(nn.Module):
    """N_i(x) = sum_k b_ik t_k(x) + sum_j a_ij u_j^(x), with a, b = branch(X, u, D_hat) and t = trunk(x).

    u^(x) is the running mean of u: it carries the kinks of P where u jumps, which no smooth t_k follows.
    The branch sees u as its Legendre moments; t depends on x alone, so that its values are folded at inference.
    """

    def __init__(
        self, n: int, m: int, clock: int = 0, *,
        width: int = 96, depth: int = 4, basis: int = 48, trunk: int = 64, moments: int = 16,
    ) -> None:  # fmt: skip
        super().__init__()
        self.n, self.basis, self.moments = n, basis, moments
        self.branch = mlp([n + clock + moments * m + 1, *[width] * depth, n * (basis + m)], bias=False)
        self.trunk = mlp([DEGREE, trunk, trunk, basis])

    def forward(self, X: Tensor, u: Tensor, D_hat: Tensor, stride: int = 1) -> Tensor:
        """N (B, nx, n), on every stride-th node, of scaled X (B, n + clock), u (B, nx, m) and D_hat (B,)."""
        a, b = self.coefficients(X, u, D_hat)
        t = self.trunk(legendre(u.shape[1], DEGREE, u.dtype, u.device)[::stride])  # (nx, basis)
        return (b @ t.T + a @ running_mean(u, stride).mT).mT

    def coefficients(self, X: Tensor, u: Tensor, D_hat: Tensor) -> tuple[Tensor, Tensor]:
        """a (B, n, m), of the running means, and b (B, n, basis), of the trunk's functions."""
        features = torch.cat([X, moments(u, self.moments).flatten(1), D_hat[:, None]], dim=1)
        coefficients = self.branch(features).unflatten(1, (self.n, -1))  # (B, n, basis + m)
        return coefficients[..., self.basis :], coefficients[..., : self.basis]


def mlp(sizes: list[int], bias: bool = True) -> nn.Sequential:
    """Linear layers of these sizes with SiLU between them: smooth, as P is, and cheap. `bias` is that of the last."""
    layers: list[nn.Module] = []
    for fan_in, fan_out in pairwise(sizes[:-1]):
        layers += [nn.Linear(fan_in, fan_out), nn.SiLU()]
    return nn.Sequential(*layers, nn.Linear(sizes[-2], sizes[-1], bias))


def as_tensors(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of sizes that gives one matrix or several, as one of sizes, type and device that gives tensors."""

    @lru_cache(maxsize=32)
    @torch.inference_mode(False)  # a tensor that an inference run caches must serve training too
    def tensors(*arguments: Any) -> Any:
        *sizes, dtype, device = arguments
        return tree_map(lambda a: torch.as_tensor(a, dtype=dtype, device=device), function(*sizes))

    return tensors


legendre, moment_matrix = as_tensors(matrices.legendre), as_tensors(matrices.moments)


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
