"""DeepONet, FNO, recurrent and averaging networks: each is its formula, on every grid, with the sizes of its table."""

import runpy

import numpy as np
import pytest
import torch
from operator_samples import PIPELINES, operator, samples, tensors
from torch import nn
from torch.nn.functional import silu

from npred.base import registry
from npred.lab.config import FNO, DeepONet
from npred.lab.training.operators.deeponet import DeepONetwork, legendre, moments, running_mean
from npred.lab.training.operators.fno import Spectral, transforms
from npred.networks.matrices import PERIOD, gregory

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


def by_fft(layer: Spectral, v: torch.Tensor) -> torch.Tensor:
    """The layer through torch.fft: weigh by the rule, continue by zero to the period, transform, cut, return."""
    nx, points = v.shape[1], round(PERIOD * (v.shape[1] - 1))
    padded = torch.zeros(v.shape[0], points, v.shape[2], dtype=v.dtype)
    padded[:, :nx] = v * torch.as_tensor(gregory(nx) * (nx - 1), dtype=v.dtype)[:, None]
    v_hat = torch.fft.rfft(padded, dim=1)[:, : layer.modes]
    y_hat = torch.zeros(v.shape[0], points // 2 + 1, v.shape[2], dtype=v_hat.dtype)
    y_hat[:, : layer.modes] = torch.einsum("bki,kio->bko", v_hat, torch.complex(layer.real, layer.imag))
    return torch.fft.irfft(y_hat, n=points, dim=1)[:, :nx]


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-13), (torch.float32, 1e-6)])
@pytest.mark.parametrize("nx", [33, 101])
def test_matrices_equal_the_fft(dtype, tolerance, nx):
    torch.manual_seed(0)
    layer = Spectral(width=8, modes=7).to(dtype)
    v = torch.randn(5, nx, 8, dtype=dtype)
    with torch.no_grad():
        expected = by_fft(layer, v)
        torch.testing.assert_close(layer(v), expected, rtol=0, atol=tolerance * float(expected.abs().max()))


def test_transform_of_a_constant_is_its_integral():
    forward, _ = transforms(51, 4, torch.float64, torch.device("cpu"))
    v_hat = (forward @ torch.ones(51, dtype=torch.float64)).numpy()
    omega = 2 * np.pi * np.arange(1, 4) / PERIOD
    expected = (1 - np.exp(-1j * omega)) / (1j * omega)
    np.testing.assert_allclose(v_hat[:2], [1, 0], atol=1e-14)
    np.testing.assert_allclose(v_hat[2::2] + 1j * v_hat[3::2], expected, atol=1e-6)


def test_weights_know_nothing_of_the_grid():
    layer = Spectral(width=4, modes=5)
    x = [torch.linspace(0, 1, nx)[None, :, None] for nx in (401, 801)]
    with torch.no_grad():
        coarse, fine = (layer(torch.cat([torch.sin(3 * y), y, y**2, torch.cos(y)], dim=2)) for y in x)
    torch.testing.assert_close(coarse, fine[:, ::2], rtol=0, atol=1e-4)


@pytest.mark.parametrize("nx", [10, 26, 101])
def test_rule_is_exact_for_polynomials_of_degree_five(nx):
    x = np.linspace(0, 1, nx)
    for degree in range(6):
        np.testing.assert_allclose(gregory(nx) @ x**degree, 1 / (degree + 1), rtol=1e-12)


def test_rule_of_a_short_grid_is_the_trapezoid():
    np.testing.assert_allclose(gregory(4), np.array([0.5, 1, 1, 0.5]) / 3)


def test_default_size():
    assert sum(p.numel() for p in operator(FNO()).parameters()) <= 140_000


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
