"""The DeepONet's features of u are what they say, on every grid; its sizes follow its table."""

import numpy as np
import pytest
import torch
from operator_samples import operator, samples, tensors

from npred.lab.config import DeepONet
from npred.lab.training.operators.deeponet import DeepONetwork, legendre, moments, running_mean

X = torch.linspace(0, 1, 41, dtype=torch.float64)


def column(values: torch.Tensor) -> torch.Tensor:
    return values[None, :, None]


def test_moments_of_a_constant_and_a_line_are_exact():
    np.testing.assert_allclose(moments(column(torch.ones_like(X)), 6)[0, :, 0], [1, 0, 0, 0, 0, 0], atol=1e-14)
    expected = [0.5, np.sqrt(3) / 6, 0, 0, 0, 0]  # x = 1/2 + (sqrt 3 / 6) sqrt 3 (2 x - 1)
    np.testing.assert_allclose(moments(column(X), 6)[0, :, 0], expected, atol=1e-14)


def test_moments_are_those_of_the_linear_interpolant_on_every_grid():
    coarse = torch.as_tensor(np.random.default_rng(0).normal(size=11))
    fine = torch.as_tensor(np.interp(np.linspace(0, 1, 101), np.linspace(0, 1, 11), coarse.numpy()))
    torch.testing.assert_close(moments(column(coarse), 8), moments(column(fine), 8), rtol=0, atol=1e-13)


def test_moments_are_the_coefficients_of_the_series():
    u = torch.exp(-2 * X)
    series = legendre(41, 9, torch.float64, X.device) * torch.sqrt(2 * torch.arange(9) + 1.0)
    torch.testing.assert_close(series @ moments(column(u), 9)[0, :, 0], u, rtol=0, atol=3e-4)


def test_running_mean_by_hand():
    u = torch.tensor([[[4.0], [2.0], [0.0]]])
    assert running_mean(u).flatten().tolist() == [4.0, 3.0, 2.0]


def test_running_mean_is_a_mean_of_each_input():
    u = torch.stack([torch.full_like(X, 7.0), X], dim=-1)[None]
    torch.testing.assert_close(running_mean(u)[0], torch.stack([torch.full_like(X, 7.0), X / 2], dim=-1))


def test_prediction_bends_where_the_input_jumps():
    u = torch.zeros(1, 201, 1, dtype=torch.float64)
    u[:, 120:] = 0.1
    data = samples(1, nx=201)
    state, D_hat = torch.as_tensor(data.X), torch.as_tensor(data.D_hat)
    with torch.no_grad():
        bend = operator(DeepONet()).double()(state, u, D_hat).diff(n=2, dim=1).norm(dim=-1)[0]
    assert bend[118:120].max() > 3 * max(bend[110:117].max(), bend[122:130].max())


def test_trunk_does_not_see_the_sample_and_branch_does_not_see_x():
    network = operator(DeepONet()).network
    assert isinstance(network, DeepONetwork)
    a, b = network.coefficients(*tensors(samples(3)))
    assert a.shape == (3, 2, 1) and b.shape == (3, 2, network.basis)
    assert network.trunk(legendre(21, 12, torch.float32, torch.device("cpu"))).shape == (21, network.basis)


def test_hot_path_is_small():
    network = operator(DeepONet()).network
    assert isinstance(network, DeepONetwork)
    assert sum(p.numel() for p in network.branch.parameters()) <= 80_000


@pytest.mark.parametrize("moments", [1, 2, 24])
def test_any_number_of_moments(moments):
    assert operator(DeepONet(moments=moments))(*tensors(samples(2))).shape == (2, 21, 2)
