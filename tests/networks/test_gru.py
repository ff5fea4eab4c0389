"""Recurrent predictors look back only, and read the same means of u on every grid; corrected ones are their formula."""

import runpy

import numpy as np
import pytest
import torch
from operator_samples import PIPELINES
from torch import nn

GRU = runpy.run_path(str(PIPELINES / "gru.py"))
Corrected, GRUNetwork, matrices = GRU["Corrected"], GRU["GRUNetwork"], GRU["matrices"]
CPU = torch.device("cpu")


@pytest.mark.parametrize("nx", [2, 5, 11, 64])
@pytest.mark.parametrize("steps", [1, 4, 10])
def test_means_are_those_of_the_linear_interpolant(nx, steps):
    u = np.random.default_rng(0).normal(size=nx)
    fine = np.linspace(0, 1, 2520 * 63 + 1)  # every cell and every interval ends on one of its nodes
    values = np.interp(fine, np.linspace(0, 1, nx), u)
    cells = ((values[1:] + values[:-1]) / 2).reshape(steps, -1).mean(axis=1)
    means, _ = matrices(nx, steps, torch.float64, CPU)
    np.testing.assert_allclose(means @ torch.as_tensor(u), cells, rtol=0, atol=1e-9)


@pytest.mark.parametrize("nx", [2, 9, 30])
def test_between_the_steps_values_are_linear(nx):
    _, between = matrices(nx, 7, torch.float64, CPU)
    ends = np.random.default_rng(0).normal(size=8)
    expected = np.interp(np.linspace(0, 1, nx), np.linspace(0, 1, 8), ends)
    np.testing.assert_allclose(between @ torch.as_tensor(ends), expected, rtol=0, atol=1e-13)


@torch.no_grad()
def test_what_comes_later_is_not_seen():
    torch.manual_seed(0)
    model = GRUNetwork(2, 1, width=6, steps=10)
    X, u, D_hat = torch.randn(3, 2), torch.randn(3, 41, 1), torch.rand(3)
    later = u.clone()
    later[:, 21:] += 1.0  # behind x = 0.5, where a step ends
    change = (model(X, later, D_hat) - model(X, u, D_hat)).abs().amax(dim=(0, 2))
    assert change[:21].max() == 0 and change[21:].min() > 0


@torch.no_grad()
def test_layers_are_stacked_and_their_starts_are_of_the_state():
    torch.manual_seed(0)
    model = GRUNetwork(2, 1, width=6, steps=4, layers=3)
    X, u, D_hat = torch.randn(3, 2), torch.randn(3, 9, 1), torch.rand(3)
    assert model(X, u, D_hat).shape == (3, 9, 2)
    assert (model(X + 1, u, D_hat) - model(X, u, D_hat))[:, 0].abs().min() > 0


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
@pytest.mark.parametrize("kind", [GRU["FNOGRU"], GRU["DeepONetGRU"]], ids=["FNOGRU", "DeepONetGRU"])
def test_without_a_correction_it_is_the_first_network(kind):
    torch.manual_seed(0)
    model = kind(2, 1)
    for parameter in model.project[-1].parameters():
        parameter.zero_()
    X, u, D_hat = torch.randn(3, 2), torch.randn(3, 21, 1), torch.rand(3)
    assert torch.equal(model(X, u, D_hat), model.first(X, u, D_hat))
