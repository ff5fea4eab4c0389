"""The spectral layer against its complex FFT form; the FNO's size."""

import numpy as np
import pytest
import torch
from operator_samples import operator

from npred.lab.config import FNO
from npred.lab.training.operators.fno import Spectral, transforms
from npred.networks.matrices import PERIOD, gregory


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
