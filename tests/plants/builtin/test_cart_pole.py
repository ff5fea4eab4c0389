"""The pendulum on a cart: Lagrange's equations, gains and V from scipy, and what every plant must show."""

import numpy as np
import plant_claims
import pytest
from scipy.linalg import solve_continuous_are, solve_continuous_lyapunov

from npred import plants
from npred.estimation.adaptation import DelayAdaptation
from npred.loop.closed_loop import simulate
from npred.prediction.methods import RK4

PLANT = plants.resolve("cart_pole")
LAW = DelayAdaptation(gamma=1.0, b=1.0, bounds=(0.1, 0.3))
REST = np.zeros(4)


def test_accelerations_satisfy_the_equations_of_motion():
    random = np.random.default_rng(0)
    X, F = random.uniform(-2, 2, (50, 4)), random.uniform(-5, 5, (50, 1))
    _, _, theta, omega = X.T
    _, a, _, alpha = PLANT.f(X, F).T
    push = 1.1 * a + 0.1 * (alpha * np.cos(theta) - omega**2 * np.sin(theta))
    np.testing.assert_allclose(push, F[:, 0], atol=1e-13)
    np.testing.assert_allclose(a * np.cos(theta) + alpha, 9.81 * np.sin(theta), atol=1e-13)


def test_energy_is_kept_without_force():
    """1/2 M v² + 1/2 m |velocity of the mass|² + m g l cos θ."""
    loop = simulate(PLANT, None, D=1.0, D_hat=0.0, X0=[0.0, 0.3, 0.5, 0.1], t_end=5.0, dt=0.001)
    _, v, theta, omega = loop.X.T
    speed = (v + omega * np.cos(theta)) ** 2 + (omega * np.sin(theta)) ** 2
    energy = 0.5 * v**2 + 0.05 * speed + 0.981 * np.cos(theta)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-10)


def test_upright_is_the_equilibrium_and_unstable_at_the_stated_rate():
    np.testing.assert_array_equal(PLANT.equilibrium, REST)
    f_X, _ = PLANT.jacobians(REST, np.zeros(1))
    assert np.linalg.eigvals(f_X).real.max() == pytest.approx(np.sqrt(9.81 * 1.1))


def test_gains_and_V_are_those_of_the_regulator():
    f_X, f_U = PLANT.jacobians(REST, np.zeros(1))
    K = -f_U.T @ solve_continuous_are(f_X, f_U, np.eye(4), np.eye(1))
    np.testing.assert_allclose(PLANT.kappa_jacobian(REST), K, atol=5.1e-5)
    loop = f_X + f_U @ K
    S = solve_continuous_lyapunov(loop.T, -np.eye(4) - K.T @ K)
    X = plant_claims.box(PLANT, 100)
    np.testing.assert_allclose(PLANT.V(X), np.einsum("bi,ij,bj->b", X, S, X), rtol=1e-3, atol=1e-4)
    assert np.linalg.eigvalsh(S).min() > 0


def test_V_falls_along_the_law_on_the_box():
    X = plant_claims.box(PLANT, 500)
    velocity, h = PLANT.f(X, PLANT.kappa(X)), 1e-6
    slope = (PLANT.V(X + h * velocity) - PLANT.V(X - h * velocity)) / (2 * h)
    assert (slope < -0.3 * PLANT.V(X)).all()


class TestClaims(plant_claims.Claims):
    plant, D, X0, t_end = PLANT, 0.25, (0.1, 0.0, 0.1, 0.0), 20.0


def test_the_loop_is_that_of_an_independent_solver():
    """For 2.5 s: replayed without feedback, the inputs let a rounding error grow at 3.3 1/s."""
    loop = simulate(PLANT, RK4(PLANT, 51), D=0.2, D_hat=0.3, X0=[0.1, 0.0, 0.1, 0.0], t_end=2.5, adaptation=LAW)
    np.testing.assert_allclose(loop.X, plant_claims.replayed(PLANT, loop, 0.2), rtol=0, atol=1e-6)


def test_the_estimate_adapts_and_the_loop_comes_to_rest():
    X0 = plant_claims.box(PLANT, 16)
    loops = simulate(PLANT, RK4(PLANT, 51), D=0.2, D_hat=0.3, X0=X0, t_end=20.0, adaptation=LAW, every=20)
    np.testing.assert_allclose(loops.X[:, -1], 0.0, atol=1e-4)
    assert (loops.D_hat[:, -1] < 0.3).all()
