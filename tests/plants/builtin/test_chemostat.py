"""The chemostat: its published set point, the law's one-sided term, and what every plant must show."""

import numpy as np
import plant_claims
import pytest
import torch

from npred import plants
from npred.estimation.adaptation import DelayAdaptation
from npred.loop.closed_loop import simulate
from npred.prediction.methods import RK4

PLANT = plants.resolve("chemostat")
X_STAR, U_STAR = (3.0, 2.0), 0.9
LAW = DelayAdaptation(gamma=1.0, b=1.0, bounds=(1.0, 2.0))


def growth(S):
    return 3.5 * S / (1 + S + S**2)


def test_the_published_set_point_is_the_equilibrium_and_a_saddle_without_control():
    np.testing.assert_allclose(PLANT.f(np.array(X_STAR), np.array([U_STAR])), 0.0, atol=1e-15)
    np.testing.assert_allclose(PLANT.equilibrium, X_STAR, rtol=1e-15)
    np.testing.assert_allclose(PLANT.u_equilibrium, [U_STAR], rtol=1e-15)
    f_X, f_U = PLANT.jacobians(PLANT.equilibrium, PLANT.u_equilibrium)
    assert np.sort(np.linalg.eigvals(f_X).real).round(2).tolist() == [-0.94, 0.68]
    loop = f_X + f_U @ PLANT.kappa_jacobian(PLANT.equilibrium)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(loop).real), [-0.9, -0.9], rtol=1e-6)


@pytest.mark.parametrize(("Z", "S"), [(3.0, 2.0), (2.0, 1.0), (1.5, 0.5), (2.5, 0.2), (3.0, 2.7), (1.0, 5.0)])
def test_the_law_is_the_published_one(Z, S):
    more = 10 * 0.1 * abs(growth(S) - 1) ** 1.5 if S <= 2 else 0.0
    np.testing.assert_allclose(PLANT.kappa(np.array([Z, S])), [0.9 * growth(S) * Z / 3 + more], rtol=1e-14)


def test_the_one_sided_term_has_a_derivative_in_torch_and_on_the_tape():
    """0.5 is the other substrate of the same growth: |.|^(3/2) has its root there too, within S < S*."""
    X = np.array([[3.0, 2.0], [3.0, 0.5], [2.0, 2.0], [2.0, 2.0 - 1e-9], [2.0, 3.0], [2.0, 1.0]])
    tensor = torch.tensor(X, requires_grad=True)
    (gradient,) = torch.autograd.grad(PLANT.kappa(tensor).sum(), tensor)
    assert torch.isfinite(gradient).all()
    np.testing.assert_allclose(gradient, [PLANT.kappa_jacobian(x)[0] for x in X], rtol=1e-9, atol=1e-12)


class TestClaims(plant_claims.Claims):
    plant, D, X0, t_end = PLANT, 2.0, (2.0, 2.0), 40.0


def test_the_published_loop_is_that_of_an_independent_solver():
    loop = simulate(PLANT, RK4(PLANT, 101), D=1.5, D_hat=1.8, X0=[2.0, 2.0], t_end=10.0, adaptation=LAW, u0=[0.0])
    np.testing.assert_allclose(loop.X, plant_claims.replayed(PLANT, loop, 1.5), rtol=0, atol=1e-6)


def test_the_published_loop_converges_and_its_input_stays_positive():
    loop = simulate(PLANT, RK4(PLANT, 101), D=1.5, D_hat=1.8, X0=[2.0, 2.0], t_end=35.0, adaptation=LAW, u0=[0.0])
    np.testing.assert_allclose(loop.X[-1], X_STAR, atol=1e-3)
    assert loop.U.min() > 0
    assert ((loop.D_hat >= 1.0) & (loop.D_hat <= 2.0)).all()


def test_V_falls_along_the_law_on_the_box():
    X = plant_claims.box(PLANT, 500)
    slope = 2 * np.sum((X - X_STAR) * PLANT.f(X, PLANT.kappa(X)), axis=1)
    assert (slope < -0.46 * PLANT.V(X)).all()
