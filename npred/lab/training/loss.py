"""The training loss: errors of P, weighed by the cost of a component in the control law."""

from dataclasses import dataclass

import torch
from torch import Tensor

from npred.lab.config import Training
from npred.plants.base import Plant

SHARE = 0.1  # a state that kappa hardly sees still counts a tenth of the one that it sees best: phi needs it too
TINY = 1e-12  # keeps the slope of the square root finite where an error is zero


def weights(config: Training, plant: Plant, P: Tensor) -> Tensor:
    """Weights (n,) of the errors in P of the data, (N, nx, n), in `criterion`.

    raw: 1 [DAPF, sec. V]. standardised: one over the spread of P_i. kappa: |d kappa / d X_i| at rest, what an error of
    P_i costs in the control (root mean square over the inputs, and over the data's P(1) where nothing rests), in units
    of the spread of the control that the data's P would give, so that the loss starts near one.
    """
    if config.loss == "raw":
        return torch.ones_like(P[0, 0])
    spread = P.std(dim=(0, 1))
    spread = torch.where(spread > 0, spread, 1.0)
    if config.loss == "standardised":
        return 1 / spread
    slopes = sensitivity(plant, P)
    slopes = torch.maximum(slopes, SHARE * (slopes * spread).max() / spread)
    return slopes / (slopes * spread).square().mean().sqrt()


def sensitivity(plant: Plant, P: Tensor) -> Tensor:
    """|d kappa / d X_i| (n,) at the equilibrium, or over the data's P(1)."""
    if not plant.traced:
        X = plant.equilibrium[None] if plant.rests else P[:, -1].numpy(force=True)
        return torch.as_tensor(plant.kappa_jacobian(X)).to(P).square().sum(1).mean(0).sqrt()
    points = (torch.as_tensor(plant.equilibrium).to(P)[None] if plant.rests else P[:, -1]).detach().requires_grad_()
    outputs = plant.kappa(points)
    rows = [torch.autograd.grad(outputs[:, j].sum(), points, retain_graph=True)[0] for j in range(plant.m)]
    return torch.stack(rows).square().sum(0).mean(0).sqrt()


@dataclass(frozen=True)
class Criterion:
    """(P_hat, P) -> the mean over the rows of e² (`square`) or of e (`norm`), with e² the mean over nodes and
    components of (w_i (P_hat_i - P_i))².

    Squares are dominated by the few rows that are far off, of loops that leave the data; norms weigh every row alike,
    also where the loops end, which serves the loop.
    """

    rows: str
    weights: Tensor  # (n,)

    def __call__(self, P_hat: Tensor, P: Tensor) -> Tensor:
        power = 1.0 if self.rows == "square" else 0.5
        return (((P_hat - P) * self.weights).square().mean((-2, -1)) + TINY).pow(power).mean(-1)
