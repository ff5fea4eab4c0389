"""The strict-feedforward plants: predictions by integrals, a loop with a formula, V, and what every plant must show."""

import numpy as np
import plant_claims
import pytest

import npred
from npred import plants
from npred_experiments import feedforward_closed_form

TWO, THREE = plants.resolve("strict_feedforward2"), plants.resolve("strict_feedforward3")
X = np.random.default_rng(0).uniform(-1, 1, (20, 3))


class TestClaims(plant_claims.Claims):
    plant, D, X0, t_end = THREE, 1.0, (0.5, -0.5, 0.5), 30.0


def test_the_loop_of_the_second_order_plant_is_its_formula():
    loop = npred.simulate(
        TWO, npred.predictor(TWO, "rk4"), D=1.0, D_hat=1.0, X0=feedforward_closed_form.Z0, t_end=8.0, dt=0.005
    )
    np.testing.assert_allclose(loop.X, feedforward_closed_form.closed_form(loop.t), atol=2e-3)


@pytest.mark.parametrize("c", [1.0, -0.5])
def test_the_law_of_the_second_order_plant_makes_it_linear(c):
    plant = plants.resolve("strict_feedforward2", {"c": c})
    z1, z2 = X[:, 0], X[:, 1]
    y, (z1_rate, z2_rate) = z1 + c * z2**3 / 3, plant.f(X[:, :2], plant.kappa(X[:, :2])).T
    np.testing.assert_allclose(z1_rate + c * z2**2 * z2_rate, z2, atol=1e-13)
    np.testing.assert_allclose(z2_rate, -y - 2 * z2, atol=1e-13)
    slope = 3 * y * z2 + z2 * z2 + y * z2_rate + z2 * z2_rate
    np.testing.assert_allclose(slope, -(y**2) - z2**2, atol=1e-12)


def test_the_law_of_the_third_order_plant_is_the_printed_polynomial_but_for_one_coefficient():
    """Written out, its bracket ends on -z3³ / 8; a public code of the example has -z3³ / 4, for which ζ1' is not
    -w (1 + 3 z3 / 4), as forwarding makes it.
    """
    np.testing.assert_allclose(THREE.kappa(X)[:, 0], polynomial(1 / 8), rtol=1e-12, atol=1e-13)
    assert np.abs(THREE.kappa(X)[:, 0] - polynomial(1 / 4)).max() > 0.05


def polynomial(cubic):
    a, b, c = X.T
    inner = -a - 2 * b + c / 2 + b * c / 2 + 5 * c**2 / 8 - cubic * c**3 - 3 * (b - c**2 / 2) ** 2 / 8
    return -a - 3 * b - 3 * c - 3 * b**2 / 8 + 3 * c * inner / 4


def test_V_of_the_third_order_plant_falls_as_it_says():
    step, velocity = 1e-6, THREE.f(X, THREE.kappa(X))
    slope = (THREE.V(X + step * velocity) - THREE.V(X - step * velocity)) / (2 * step)
    second = X[:, 1] + X[:, 2] - X[:, 2] ** 2 / 2
    w = -THREE.kappa(X)[:, 0] - X[:, 2] - second
    np.testing.assert_allclose(slope, -(w**2) - second**2 - X[:, 2] ** 2 - (w + second + X[:, 2]) ** 2, atol=1e-7)


def test_the_prediction_of_the_third_order_plant_is_a_polynomial_for_a_held_command():
    """With ζ = z2 - z3² / 2: z3 = c + u s, ζ' = z3, z1' = ζ + 3 z3² / 2, each integrated by hand over the delay s."""
    s, u = 0.8, 0.7
    P = npred.predictor(THREE, "rk4", nx=101)(X, np.full((101, 1), u), s)[:, -1]
    a, b, c = X.T
    last, zeta = c + u * s, b - c**2 / 2
    first = a + zeta * s + c * s**2 / 2 + u * s**3 / 6 + (last**3 - c**3) / (2 * u)
    second = zeta + c * s + u * s**2 / 2 + last**2 / 2
    np.testing.assert_allclose(P, np.stack([first, second, last], axis=-1), atol=1e-9)
