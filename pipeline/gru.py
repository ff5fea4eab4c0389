"""Networks of your own: gated recurrent units [Cho et al. 2014, arXiv:1406.1078] along x, on any grid.

Alone as `network = "gru.py:GRUNetwork"` in a table [train.NAME], or correcting another network, as gru.py:FNOGRU does.
"""

import numpy as np
import torch
from torch import Tensor, nn

from npred.lab.training.operators.deeponet import DeepONetwork, as_tensors, mlp, running_mean
from npred.lab.training.operators.fno import FNOnetwork


class GRUNetwork(nn.Module):
    """N(x) = Q(h(x), u^(x), x), h_k+1 = GRU(h_k; X, D_hat, mean of u over cell k, x_k), h_0 = tanh(W (X, D_hat) + b).

    h takes `steps` equal steps over [0, 1], however many nodes u has, as a numerical predictor carries P: the cells'
    means are those of u's interpolant, the same on every grid, so weights trained on one grid hold on another. Between
    the steps h is linear in x; the running mean u^ carries the kinks of P where u jumps within a cell.
    """

    def __init__(self, n: int, m: int, clock: int = 0, *, width: int = 48, steps: int = 25, layers: int = 1) -> None:
        super().__init__()
        self.steps, self.layers = steps, layers
        constants = n + clock + 1
        self.start = nn.Linear(constants, layers * width)
        self.recurrent = nn.GRU(constants + m + 1, width, layers, batch_first=True)
        self.project = mlp([width + m + 1, 2 * width, n], bias=False)

    def forward(self, X: Tensor, u: Tensor, D_hat: Tensor, stride: int = 1) -> Tensor:
        """N (B, nx, n), on every stride-th node, of scaled X (B, n + clock), u (B, nx, m) and D_hat (B,)."""
        means, between = matrices(u.shape[1], self.steps, u.dtype, u.device)
        constants = torch.cat([X, D_hat[:, None]], dim=1)
        x = torch.linspace(-1, 1, self.steps + 1, dtype=u.dtype, device=u.device)[:, None].expand(X.shape[0], -1, 1)
        begin = torch.tanh(self.start(constants)).unflatten(1, (self.layers, -1)).transpose(0, 1).contiguous()
        repeated = constants[:, None].expand(-1, self.steps, -1)
        h, _ = self.recurrent(torch.cat([repeated, means @ u, x[:, :-1]], dim=2), begin)
        h = torch.cat([begin[-1][:, None], h], dim=1)  # (B, steps + 1, width)
        between = between[::stride]
        return self.project(torch.cat([between @ h, running_mean(u, stride), between @ x], dim=2))


class Corrected(nn.Module):
    """N(x) = N_0(x) + Q(h(x), N_0(x), x), h_k+1 = GRU(h_k; mean of N_0 over cell k, x_k), h_0 = 0.

    N_0 is another network's answer. The recurrence takes `steps` equal steps over [0, 1] on any grid, as that of
    GRUNetwork does, and is linear in x between them.
    """

    def __init__(self, first: nn.Module, n: int, width: int, steps: int) -> None:
        super().__init__()
        self.first, self.steps = first, steps
        self.recurrent = nn.GRU(n + 1, width, batch_first=True)
        self.project = mlp([width + n + 1, 2 * width, n], bias=False)

    def forward(self, X: Tensor, u: Tensor, D_hat: Tensor, stride: int = 1) -> Tensor:
        """N (B, nx, n), on every stride-th node, of scaled X (B, n + clock), u (B, nx, m) and D_hat (B,)."""
        N = self.first(X, u, D_hat, stride)
        means, between = matrices(N.shape[1], self.steps, u.dtype, u.device)
        x = torch.linspace(-1, 1, self.steps + 1, dtype=u.dtype, device=u.device)[:, None].expand(N.shape[0], -1, 1)
        h, _ = self.recurrent(torch.cat([means @ N, x[:, :-1]], dim=2))
        h = nn.functional.pad(h, (0, 0, 1, 0))  # (B, steps + 1, width)
        return N + self.project(torch.cat([between @ h, N, between @ x], dim=2))


class FNOGRU(Corrected):
    """An FNO, corrected."""

    def __init__(
        self, n: int, m: int, clock: int = 0, *, width: int = 32, modes: int = 8, layers: int = 3, units: int = 24,
        steps: int = 11,
    ) -> None:  # fmt: skip
        super().__init__(FNOnetwork(n, m, clock, width=width, modes=modes, layers=layers), n, units, steps)


class DeepONetGRU(Corrected):
    """A DeepONet, corrected."""

    def __init__(
        self, n: int, m: int, clock: int = 0, *, width: int = 96, depth: int = 4, basis: int = 48, trunk: int = 64,
        moments: int = 16, units: int = 24, steps: int = 11,
    ) -> None:  # fmt: skip
        first = DeepONetwork(n, m, clock, width=width, depth=depth, basis=basis, trunk=trunk, moments=moments)
        super().__init__(first, n, units, steps)


@as_tensors
def matrices(nx: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """(steps, nx): nodal values to the means of their linear interpolant over equal cells; (nx, steps + 1): from the
    cells' ends to the nodes, linear between them.
    """
    hats, h = np.eye(nx), 1 / (nx - 1)
    sums = np.concatenate([np.zeros((1, nx)), np.cumsum(hats[1:] + hats[:-1], axis=0)]) / 2  # int_0^x_j u / h
    first, share = _located(steps + 1, nx)
    slope = hats[first + 1] - hats[first]
    integrals = h * (sums[first] + share * hats[first] + share**2 / 2 * slope)
    first, share = _located(nx, steps + 1)
    ends = np.eye(steps + 1)
    between = (1 - share) * ends[first] + share * ends[first + 1]
    return steps * np.diff(integrals, axis=0), between


def _located(count: int, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """The interval of a grid of `nodes` that each of `count` equally spaced points is in, and its share before it."""
    points = np.arange(count) * (nodes - 1) / (count - 1)
    first = np.minimum(points.astype(int), nodes - 2)
    return first, (points - first)[:, None]
