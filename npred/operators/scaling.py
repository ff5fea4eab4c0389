"""Units to numbers near one and back: constants of the training data, saved with the model."""

from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn


class Samples(Protocol):
    """What the constants are taken from."""

    @property
    def X(self) -> np.ndarray: ...  # (N, n)
    @property
    def u(self) -> np.ndarray: ...  # (N, nx, m)
    @property
    def D_hat(self) -> np.ndarray: ...  # (N,)
    @property
    def P(self) -> np.ndarray: ...  # (N, nx, n)


class Scaling(nn.Module):
    """Mean and spread of X, u, D_hat and P by component, and the spread of the displacement P - X, as buffers.

    Shapes: X, P, dP (n,), u (m,), D_hat (); in the units of the plant and seconds.
    """

    X_mean: Tensor
    X_std: Tensor
    u_mean: Tensor
    u_std: Tensor
    D_hat_mean: Tensor
    D_hat_std: Tensor
    P_mean: Tensor
    P_std: Tensor
    dP_std: Tensor

    def __init__(self, n: int, m: int) -> None:
        super().__init__()
        for name, shape in {"X": (n,), "u": (m,), "D_hat": (), "P": (n,)}.items():
            self.register_buffer(f"{name}_mean", torch.zeros(shape))
            self.register_buffer(f"{name}_std", torch.ones(shape))
        self.register_buffer("dP_std", torch.ones(n))

    @classmethod
    def of(cls, data: Samples) -> "Scaling":
        """The constants of these samples; the spread of a constant component is taken as one."""
        n, m = data.X.shape[-1], data.u.shape[-1]
        scaling = cls(n, m)
        for name, values in {"X": data.X, "u": data.u.reshape(-1, m), "P": data.P.reshape(-1, n)}.items():
            scaling._set(name, values.mean(axis=0), values.std(axis=0))
        scaling._set("D_hat", data.D_hat.mean(), data.D_hat.std())
        displacement = data.P[:, -1] - data.X
        scaling.dP_std.copy_(_positive((displacement**2).mean(axis=0) ** 0.5))
        return scaling

    def inputs(self, X: Tensor, u: Tensor, D_hat: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The standardised X (B, n), u (B, nx, m) and D_hat (B,)."""
        return (
            (X - self.X_mean) / self.X_std,
            (u - self.u_mean) / self.u_std,
            (D_hat - self.D_hat_mean) / self.D_hat_std,
        )

    def _set(self, name: str, mean: np.ndarray, std: np.ndarray) -> None:
        self.get_buffer(f"{name}_mean").copy_(torch.as_tensor(mean))
        self.get_buffer(f"{name}_std").copy_(_positive(std))


def _positive(std: np.ndarray) -> Tensor:
    """A constant input carries no spread: rounding must not be blown up to a signal."""
    return torch.as_tensor(np.where(std > 1e-8, std, 1.0))
