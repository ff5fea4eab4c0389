"""The constants of the training data: what they are, and that they belong to the model."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from operator_samples import SMALL, Arrays, operator, samples, tensors

from npred.lab.training.operators import Scaling


def test_inputs_come_out_standardised():
    data = samples(300)
    X, u, D_hat = Scaling.of(data).inputs(*tensors(data))
    for values in (X, u.flatten(0, 1), D_hat):
        torch.testing.assert_close(values.mean(0), torch.zeros_like(values[0]), rtol=0, atol=1e-5)
        torch.testing.assert_close(values.std(0, correction=0), torch.ones_like(values[0]), rtol=1e-5, atol=0)


def test_constants_by_hand():
    X = np.array([[1.0, 10.0], [3.0, 10.0]])
    u = np.array([[[0.0], [2.0]], [[4.0], [6.0]]])
    P = X[:, None] + np.array([[[0, 0], [3, -8]], [[0, 0], [4, 6]]])
    scaling = Scaling.of(Arrays(X, u, np.array([1.0, 2.0]), P))
    assert scaling.X_bend.tolist() == [1, 1] and scaling.X_std.tolist()[1] == 1
    np.testing.assert_allclose(scaling.X_mean, [np.arcsinh([1, 3]).mean(), np.arcsinh(10)], rtol=1e-6)
    assert scaling.u_mean.tolist() == [3] and scaling.D_hat_std.item() == 0.5
    np.testing.assert_allclose(scaling.u_std, np.sqrt(5), rtol=1e-6)
    np.testing.assert_allclose(scaling.speed, np.sqrt(np.array([12.5, 50]) / 2.5), rtol=1e-6)
    np.testing.assert_allclose(scaling.P_mean, P.mean((0, 1)), rtol=1e-6)


@pytest.mark.parametrize("cuts", [[300], [1, 299], [100, 0, 150, 50]])
def test_parts_give_the_constants_of_the_whole(cuts):
    data, stops = samples(300), np.cumsum(cuts)
    far = replace(data, X=data.X + np.array([0, 1e4]), P=data.P + np.array([0, 1e4]))  # cancellation would show

    def parts():
        for count, stop in zip(cuts, stops, strict=True):
            some = slice(stop - count, stop)
            yield Arrays(far.X[some], far.u[some], far.D_hat[some], far.P[some])

    whole, joined = Scaling.of(far).state_dict(), Scaling.of_parts(parts).state_dict()
    for name in whole:
        torch.testing.assert_close(joined[name], whole[name], rtol=1e-6, atol=0)


def test_constant_input_stays_finite():
    data = samples()
    flat = Arrays(data.X, np.zeros_like(data.u), np.full_like(data.D_hat, 1.0), data.P)
    assert all(bool(torch.isfinite(t).all()) for t in Scaling.of(flat).inputs(*tensors(flat)))


def test_scaling_is_part_of_the_saved_tensors():
    names = set(operator(SMALL[0]).state_dict())
    constants = {f"scaling.{v}_{s}" for v in ("X", "u", "D_hat", "P") for s in ("mean", "std")}
    assert constants | {"scaling.X_bend", "scaling.speed", "X_rest", "u_rest"} <= names
