"""A corrected network is the formula of its docstring, and its correction reads the first network's answer."""

import pytest
import torch
from torch import nn

from npred.operators.corrected import FNOGRU, Corrected, DeepONetGRU


class Ramp(nn.Module):
    """N_0(x) = x X."""

    def forward(self, X, u, D_hat, stride=1):
        x = torch.linspace(0, 1, u.shape[1], dtype=u.dtype)[::stride]
        return x[:, None] * X[:, None]


@torch.no_grad()
def test_it_is_the_recurrence_written_out():
    torch.manual_seed(0)
    model = Corrected(Ramp(), n=2, width=4, steps=5).double()
    X, u = torch.randn(3, 2).double(), torch.zeros(3, 11, 1).double()
    cell = nn.GRUCell(3, 4).double()
    cell.load_state_dict({name[:-3]: value for name, value in model.recurrent.state_dict().items()})
    h, states = torch.zeros(3, 4).double(), []
    for k in range(5):
        states.append(h)
        mean = (k + 0.5) / 5 * X  # of the ramp over a cell
        h = cell(torch.cat([mean, torch.full((3, 1), 2 * k / 5 - 1).double()], dim=1), h)
    states.append(h)
    for k, state in enumerate(states):
        N_0, x = k / 5 * X, torch.full((3, 1), 2 * k / 5 - 1).double()
        expected = N_0 + model.project(torch.cat([state, N_0, x], dim=1))
        assert torch.allclose(model(X, u, torch.ones(3).double())[:, 2 * k], expected, atol=1e-12)


@torch.no_grad()
@pytest.mark.parametrize("kind", [FNOGRU, DeepONetGRU])
def test_without_a_correction_it_is_the_first_network(kind):
    torch.manual_seed(0)
    model = kind(2, 1)
    for parameter in model.project[-1].parameters():
        parameter.zero_()
    X, u, D_hat = torch.randn(3, 2), torch.randn(3, 21, 1), torch.rand(3)
    assert torch.equal(model(X, u, D_hat), model.first(X, u, D_hat))
