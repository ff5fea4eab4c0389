"""The averaging operator is the formula of its docstring, and averages over the whole domain."""

import torch
from operator_samples import PIPELINES
from torch import nn
from torch.nn.functional import silu

from npred.base import registry

AveragingNetwork, _ = registry.load("network", f"{PIPELINES}/averaging.py:AveragingNetwork")


def network(**sizes: int) -> nn.Module:
    torch.manual_seed(0)
    return AveragingNetwork(2, 1, width=5, **sizes).double()


def inputs(nx: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return tuple(torch.randn(shape, generator=generator).double() for shape in ((3, 2), (3, nx, 1), (3,)))  # type: ignore[return-value]


@torch.no_grad()
def test_one_hidden_layer_by_hand():
    """N = Q(silu(W v + b + int v dx), x) with v = R(X, D_hat, u(x), x); by the trapezoidal rule on three nodes."""
    model, (X, u, D_hat) = network(), inputs(3)
    x = (-1.0, 0.0, 1.0)
    v = [
        model.lift(torch.cat([X, D_hat[:, None], u[:, j], torch.full((3, 1), x[j]).double()], dim=1)) for j in range(3)
    ]
    average = (v[0] + 2 * v[1] + v[2]) / 4
    for j in range(3):
        hidden = silu(model.hidden[0](v[j]) + average)
        N = model.project(torch.cat([hidden, torch.full((3, 1), x[j]).double()], dim=1))
        torch.testing.assert_close(model(X, u, D_hat)[:, j], N)


@torch.no_grad()
def test_the_prediction_at_the_start_sees_the_input_at_the_end():
    model, (X, u, D_hat) = network(layers=2), inputs(41)
    later = u.clone()
    later[:, 30:] += 1.0
    assert (model(X, later, D_hat) - model(X, u, D_hat))[:, 0].abs().min() > 1e-6
