"""Fourier neural operator [Li et al. 2021, arXiv:2010.08895] over x in [0, 1], its transforms as real matrices."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from npred.lab.training.operators.deeponet import as_tensors, mlp, running_mean
from npred.networks import matrices

transforms = as_tensors(matrices.fourier)


class FNOnetwork(nn.Module):
    """N = project(v_L), v_l+1 = silu(spectral_l(v_l) + W_l v_l), v_0 = lift(X, D_hat, u^(x), x).

    u^ is the running mean of u: P hangs on integrals of u alone, and u^ has them exactly, on any coarser grid too. The
    weights know nothing of the grid: any nx, with both ends of [0, 1] in.
    """

    def __init__(self, n: int, m: int, clock: int = 0, *, width: int = 32, modes: int = 8, layers: int = 4) -> None:
        super().__init__()
        self.lift = nn.Linear(n + clock + 1 + m + 1, width)
        self.spectral = nn.ModuleList(Spectral(width, modes) for _ in range(layers))
        self.local = nn.ModuleList(nn.Linear(width, width) for _ in range(layers))
        self.project = mlp([width, 2 * width, n], bias=False)

    def forward(self, X: Tensor, u: Tensor, D_hat: Tensor, stride: int = 1) -> Tensor:
        """N (B, nx, n), on every stride-th node, of scaled X (B, n + clock), u (B, nx, m) and D_hat (B,)."""
        means = running_mean(u, stride)
        batch, nx, _ = means.shape
        x = torch.linspace(-1, 1, nx, dtype=u.dtype, device=u.device)[:, None].expand(batch, nx, 1)
        constants = torch.cat([X, D_hat[:, None]], dim=1)[:, None].expand(batch, nx, -1)
        v = self.lift(torch.cat([constants, means, x], dim=2))  # (B, nx, width)
        for spectral, local in zip(self.spectral, self.local, strict=True):
            v = functional.silu(spectral(v) + local(v))
        return self.project(v)


class Spectral(nn.Module):
    """y = F^-1 (R_k F v): a complex matrix for each of the lowest modes, as one real matrix of twice the size."""

    def __init__(self, width: int, modes: int) -> None:
        super().__init__()
        self.modes = modes
        self.real = nn.Parameter(_drawn(modes, width))
        self.imag = nn.Parameter(_drawn(modes, width))

    def forward(self, v: Tensor) -> Tensor:
        """v (B, nx, width) to the same shape."""
        forward, inverse = transforms(v.shape[1], self.modes, v.dtype, v.device)
        v_hat = (forward @ v).unflatten(1, (self.modes, 2)).flatten(2).transpose(0, 1)  # (modes, B, 2 width)
        y_hat = torch.bmm(v_hat, self.matrix()).transpose(0, 1)  # (B, modes, 2 width)
        return inverse @ y_hat.unflatten(2, (2, -1)).flatten(1, 2)

    def matrix(self) -> Tensor:
        """[[Re, Im], [-Im, Re]] of R_k: (Re v, Im v) in a row to (Re R v, Im R v); (modes, 2 width, 2 width)."""
        return torch.cat([torch.cat([self.real, self.imag], dim=2), torch.cat([-self.imag, self.real], dim=2)], dim=1)


def _drawn(modes: int, width: int) -> Tensor:
    """One normal matrix per mode; none where a network is built for its shapes alone, on torch's meta device."""
    # To draw there would bring in torch's compiler, which takes a second.
    weights = torch.empty(modes, width, width)
    return weights if weights.is_meta else weights.normal_().div_(2 * width)
