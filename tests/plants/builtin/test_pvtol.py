"""The aircraft: its equations, what its law makes linear, V, and what every plant must show."""

import numpy as np
import plant_claims
import pytest
from scipy.linalg import solve_continuous_lyapunov

from npred import plants
from npred.plants.builtin import pvtol

PLANT = plants.resolve("pvtol")


class TestClaims(plant_claims.Claims):
    plant, D, X0, t_end = PLANT, 0.5, (1.0, 0.5, 0.0, 0.0, 0.0, 0.0), 30.0


def test_it_hovers_with_its_weight_as_thrust():
    np.testing.assert_allclose(PLANT.equilibrium, 0.0, atol=1e-15)
    np.testing.assert_allclose(PLANT.u_equilibrium, [1.0, 0.0], atol=1e-15)


def test_power_is_that_of_thrust_and_moment():
    """(|v|² / 2 + y)' = thrust along the body's axis + ε moment along its wing, each by the velocity there."""
    X, u = plant_claims.box(PLANT, 30), np.random.default_rng(0).uniform(-2, 2, (30, 2))
    _, _, theta, vx, vy, omega = X.T
    rates = PLANT.f(X, u)
    power = vx * rates[:, 3] + vy * rates[:, 4] + vy
    up, wing = -vx * np.sin(theta) + vy * np.cos(theta), vx * np.cos(theta) + vy * np.sin(theta)
    np.testing.assert_allclose(power, u[:, 0] * up + 0.5 * u[:, 1] * wing, atol=1e-13)
    np.testing.assert_allclose(rates[:, [0, 1, 2, 5]].T, [vx, vy, omega, u[:, 1]])


@pytest.mark.parametrize("epsilon", [0.5, 0.0, 2.0])
def test_the_law_makes_height_and_roll_linear(epsilon):
    """b'' = -b - 2 b', and (tan θ)'' = a + 4 a' - 6 tan θ - 4 (tan θ)', by differences along the law's own loop."""
    plant, h = plants.resolve("pvtol", {"epsilon": epsilon}), 1e-3
    X = plant_claims.box(plant, 20)
    ends = [_moved(plant, X, sign * h) for sign in (-1, 1)]
    second = lambda of: (of(ends[0]) - 2 * of(X) + of(ends[1])) / h**2
    first = lambda of: (of(ends[1]) - of(ends[0])) / (2 * h)
    a = lambda X: X[:, 0] - epsilon * np.sin(X[:, 2])
    b = lambda X: X[:, 1] + epsilon * (np.cos(X[:, 2]) - 1)
    slope = lambda X: np.tan(X[:, 2])
    np.testing.assert_allclose(second(b), -b(X) - 2 * first(b), atol=1e-5)
    np.testing.assert_allclose(second(slope), a(X) + 4 * first(a) - 6 * slope(X) - 4 * first(slope), atol=1e-4)
    np.testing.assert_allclose(second(a), -(1 + second(b)) * slope(X), atol=1e-5)


def _moved(plant, X, h, steps=8):
    """Classical Runge-Kutta along the loop without delay, whose inputs are the law's throughout."""

    rate = lambda X: plant.f(X, plant.kappa(X))
    for _ in range(steps):
        s = h / steps
        k1 = rate(X)
        k2 = rate(X + s / 2 * k1)
        k3 = rate(X + s / 2 * k2)
        X = X + s / 6 * (k1 + 2 * k2 + 2 * k3 + rate(X + s * k3))
    return X


def test_V_is_that_of_the_lyapunov_equation_and_falls_on_the_box():
    chain = np.diag(np.ones(3), 1)
    chain[3] = [-1, -4, -6, -4]
    S = solve_continuous_lyapunov(chain.T, -np.eye(4))
    np.testing.assert_allclose([S[place] for place in pvtol.S], list(pvtol.S.values()), rtol=1e-12)
    X = plant_claims.box(PLANT, 5000)
    velocity, h = PLANT.f(X, PLANT.kappa(X)), 1e-6
    slope = (PLANT.V(X + h * velocity) - PLANT.V(X - h * velocity)) / (2 * h)
    assert (slope < -0.06 * PLANT.V(X)).all()
