"""The losses against hand-computed values."""

import numpy as np
import torch
from operator_samples import PLANT

from npred import plants
from npred.lab.config import DeepONet
from npred.lab.training.loss import SHARE, Criterion, sensitivity, weights

P = torch.tensor([[[0.0, 10.0], [0.2, 10.0]], [[0.0, 14.0], [0.2, 14.0]]])


def test_raw_loss_by_hand():
    P_hat = torch.tensor([[[0.0, 11.0], [0.5, 10.0]], [[0.0, 12.0], [0.2, 14.0]]])
    loss = Criterion("square", weights(DeepONet(loss="raw"), PLANT, P))
    torch.testing.assert_close(loss(P_hat, P), torch.tensor((1 + 0.09 + 4) / 8))


def test_norms_heed_every_row_alike():
    P_hat = P + torch.tensor([[[3.0, 0.0]], [[30.0, 0.0]]])
    loss = Criterion("norm", torch.ones(2))
    torch.testing.assert_close(loss(P_hat, P), torch.tensor((3 + 30) / 2 / 2**0.5))


def test_slope_of_the_norm_is_finite_where_the_error_is_zero():
    P_hat = P.clone().requires_grad_()
    Criterion("norm", torch.ones(2))(P_hat, P).backward()
    assert P_hat.grad is not None and P_hat.grad.abs().max() == 0


def test_standardised_loss_divides_by_the_spread():
    expected = 1 / P.flatten(0, 1).std(dim=0)
    torch.testing.assert_close(weights(DeepONet(loss="standardised"), PLANT, P), expected)


def test_constant_component_has_weight_one():
    flat = torch.ones(3, 4, 2)
    assert weights(DeepONet(loss="standardised"), PLANT, flat).tolist() == [1, 1]


def test_kappa_weights_are_the_gains_at_rest():
    """kappa'(x*) = (-1.97013785918703, 0.0345073280414935): an error of x1 costs 57 times one of x2."""
    gains = sensitivity(PLANT, P.double())
    np.testing.assert_allclose(gains, [1.97013785918703, 0.0345073280414935], rtol=1e-12)
    w = weights(DeepONet(loss="kappa"), PLANT, P.double())
    np.testing.assert_allclose(w / w[0], gains / gains[0], rtol=1e-12)


def test_kappa_loss_of_the_mean_is_one():
    mean = P.double().mean(dim=(0, 1)).expand_as(P)
    loss = Criterion("square", weights(DeepONet(loss="kappa"), PLANT, P.double()))
    np.testing.assert_allclose(loss(mean, P.double()), 3 / 4, rtol=1e-10)  # n - 1 in the spread, of four values


def test_state_that_the_law_hardly_sees_keeps_a_share():
    narrow = P.double() * torch.tensor([1.0, 1e-3])
    spread = narrow.flatten(0, 1).std(dim=0)
    w = weights(DeepONet(loss="kappa"), PLANT, narrow)
    torch.testing.assert_close(w[1] * spread[1], SHARE * w[0] * spread[0])


def test_kappa_weights_of_a_linear_law():
    scalar = plants.resolve("scalar")
    shifted = torch.tensor([[1.0]], dtype=torch.float64)
    slope = abs(float(scalar.kappa(shifted + 1) - scalar.kappa(shifted)))
    np.testing.assert_allclose(sensitivity(scalar, torch.randn(5, 3, 1, dtype=torch.float64)), [slope], rtol=1e-9)
