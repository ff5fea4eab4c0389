"""Units to numbers near one and back: constants of the training data, saved with the model."""

from collections.abc import Callable, Iterable
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn


class SampleArrays(Protocol):
    """The samples that the constants are taken from."""

    @property
    def X(self) -> np.ndarray: ...  # (N, n)
    @property
    def u(self) -> np.ndarray: ...  # (N, nx, m)
    @property
    def D_hat(self) -> np.ndarray: ...  # (N,)
    @property
    def P(self) -> np.ndarray: ...  # (N, nx, n)


class Moments:
    """Mean and variance by component of rows that come in parts, without cancellation [Chan, Golub, LeVeque 1983]."""

    def __init__(self) -> None:
        self.count, self.mean, self.variance = 0, np.zeros(()), np.zeros(())

    def add(self, rows: np.ndarray) -> None:
        """Take in rows (N, k); a part may have none."""
        if not len(rows):
            return
        self.count += len(rows)
        share = len(rows) / self.count
        gap = rows.mean(axis=0) - self.mean
        self.variance = self.variance + share * (rows.var(axis=0) - self.variance + (1 - share) * gap**2)
        self.mean = self.mean + share * gap

    @property
    def std(self) -> np.ndarray:
        return self.variance**0.5

    @property
    def square(self) -> np.ndarray:
        """The mean square."""
        return self.variance + self.mean**2


class Scaling(nn.Module):
    """Mean and spread of asinh(X / X_bend), u, D_hat and P by component, and the speed |P - X| / D_hat, as buffers.

    Shapes: X, P, speed (n,), u (m,), D_hat (); in the units of the plant. Far states, whose data are few,
    are drawn in by asinh, which is a logarithm there: what drives the plant are often ratios of states.
    """

    X_bend: Tensor
    X_mean: Tensor
    X_std: Tensor
    u_mean: Tensor
    u_std: Tensor
    D_hat_mean: Tensor
    D_hat_std: Tensor
    P_mean: Tensor
    P_std: Tensor
    speed: Tensor

    def __init__(self, n: int, m: int) -> None:
        super().__init__()
        for name, shape in {"X": (n,), "u": (m,), "D_hat": (), "P": (n,)}.items():
            self.register_buffer(f"{name}_mean", torch.zeros(shape))
            self.register_buffer(f"{name}_std", torch.ones(shape))
        self.register_buffer("X_bend", torch.ones(n))
        self.register_buffer("speed", torch.ones(n))

    @classmethod
    def of(cls, data: SampleArrays) -> "Scaling":
        """The constants of these samples; the spread of a constant component is taken as one."""
        return cls.of_parts(lambda: [data])

    @classmethod
    def of_parts(cls, parts: Callable[[], Iterable[SampleArrays]]) -> "Scaling":
        """The same constants, to rounding, of samples that come in parts: `parts` is called twice."""
        bend = Moments()
        for part in parts():
            bend.add(part.X)
        n, moments = len(bend.mean), {name: Moments() for name in ("X", "u", "D_hat", "P", "displacement")}
        X_bend = _positive(bend.std).float()
        for part in parts():
            moments["X"].add(np.arcsinh(part.X / X_bend.numpy()))
            moments["u"].add(part.u.reshape(-1, part.u.shape[-1]))
            moments["P"].add(part.P.reshape(-1, n))
            moments["D_hat"].add(part.D_hat[:, None])
            moments["displacement"].add(part.P[:, -1] - part.X)
        scaling = cls(n, len(moments["u"].mean))
        scaling.X_bend.copy_(X_bend)
        for name in ("X", "u", "P"):
            scaling._set(name, moments[name].mean, moments[name].std)
        scaling._set("D_hat", moments["D_hat"].mean[0], moments["D_hat"].std[0])
        scaling.speed.copy_(_positive((moments["displacement"].square / moments["D_hat"].square) ** 0.5))
        return scaling

    def inputs(self, X: Tensor, u: Tensor, D_hat: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The bent and standardised X (B, n), u (B, nx, m) and D_hat (B,)."""
        return (
            (torch.asinh(X / self.X_bend) - self.X_mean) / self.X_std,
            (u - self.u_mean) / self.u_std,
            (D_hat - self.D_hat_mean) / self.D_hat_std,
        )

    def _set(self, name: str, mean: np.ndarray, std: np.ndarray) -> None:
        self.get_buffer(f"{name}_mean").copy_(torch.as_tensor(mean))
        self.get_buffer(f"{name}_std").copy_(_positive(std))


def _positive(std: np.ndarray) -> Tensor:
    """A constant input carries no spread: rounding must not be blown up to a signal."""
    return torch.as_tensor(np.where(std > 1e-8, std, 1.0))
