"""A network of your own: the neural operator of [DAPF, Definition 1] with the averaging kernel of its Theorem 1.

As `network = "averaging.py:AveragingNetwork"` in a table [train.NAME].
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from npred.base import grid
from npred.lab.training.operators.deeponet import as_tensors, mlp

trapezoid = as_tensors(grid.trapezoid)


class AveragingNetwork(nn.Module):
    """N = Q(v_L, x), v_l = silu(W_l v_l-1 + b_l + int_0^1 v_l-1 dx), v_0 = R(X, u(x), D_hat, x).

    One hidden layer approximates every continuous operator, with enough channels [DAPF, Theorem 1; Lanthaler, Li and
    Stuart 2024]. P hangs on the integrals of u up to x, and this kernel averages over the whole of [0, 1] at every x,
    as the definition has it: the channels have to separate what is before x from what is behind it, which takes more
    of them than a kernel that knows the direction. The integral is the trapezoidal rule's, so the weights know nothing
    of the grid.
    """

    def __init__(self, n: int, m: int, clock: int = 0, *, width: int = 64, layers: int = 1) -> None:
        super().__init__()
        self.lift = mlp([n + clock + 1 + m + 1, width, width])
        self.hidden = nn.ModuleList(nn.Linear(width, width) for _ in range(layers))
        self.project = mlp([width + 1, width, n], bias=False)

    def forward(self, X: Tensor, u: Tensor, D_hat: Tensor, stride: int = 1) -> Tensor:
        """N (B, nx, n), on every stride-th node, of scaled X (B, n + clock), u (B, nx, m) and D_hat (B,)."""
        batch, nx, _ = u.shape
        x = torch.linspace(-1, 1, nx, dtype=u.dtype, device=u.device)[:, None].expand(batch, nx, 1)
        weights = trapezoid(nx, u.dtype, u.device)
        constants = torch.cat([X, D_hat[:, None]], dim=1)[:, None].expand(batch, nx, -1)
        h, linear = self.lift[:-1](torch.cat([constants, u, x], dim=2)), self.lift[-1]
        for depth, layer in enumerate(self.hidden, start=1):
            average = linear(weights @ h)[:, None]  # the mean of v = linear(h)
            if depth == len(self.hidden):
                h, x = h[:, ::stride], x[:, ::stride]
            h, linear = functional.silu(layer(linear(h)) + average), nn.Identity()
        return self.project(torch.cat([h, x], dim=2))
