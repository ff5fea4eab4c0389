"""DeepONet [Lu et al. 2021, doi:10.1038/s42256-021-00302-5], on any grid of the actuator state."""

from itertools import pairwise

import torch
from torch import Tensor, nn

from npred.operators.features import legendre, moments, running_mean
from npred.operators.layouts import DEGREE


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
