"""A network whose answer gated recurrent units read along x and correct: FNO + GRU and DeepONet + GRU."""

import torch
from torch import Tensor, nn

from npred.operators.deeponet import DeepONetwork, mlp
from npred.operators.fno import FNOnetwork
from npred.operators.gru import matrices


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
