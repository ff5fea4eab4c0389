"""The planar arm: mechanics that conserve energy, a law that gives linear errors, and any number of links."""

import numpy as np
import pytest

from npred import plants
from npred.plants.base import Plant
from npred.plants.planar_arm import arm


def test_one_link_is_the_rod_pendulum():
    rod = Plant("rod", arm(1), {"friction": 0.0})
    angle, rate, torque = 0.7, 0.3, 0.2
    expected = (torque - 9.81 * 0.25 * np.sin(angle)) / (0.5**2 / 3)
    np.testing.assert_allclose(rod.f(np.array([angle, rate]), np.array([torque])), [rate, expected], rtol=1e-12)


@pytest.mark.parametrize("links", [2, 5, 7])
def test_energy_is_kept_without_friction_and_torque(links):
    """Half a second by RK4: kinetic energy from the rods' centres, apart from the mass matrix of the plant."""
    chain = Plant("chain", arm(links), {"friction": 0.0})
    X = np.concatenate([np.linspace(0.2, 1.4, links), np.linspace(-1, 1, links)])
    before, u, h = _energy(X, links), np.zeros(links), 1e-3
    for _ in range(500):
        k1 = chain.f(X, u)
        k2 = chain.f(X + h / 2 * k1, u)
        k3 = chain.f(X + h / 2 * k2, u)
        X = X + h / 6 * (k1 + 2 * k2 + 2 * k3 + chain.f(X + h * k3, u))
    assert _energy(X, links) == pytest.approx(before, abs=1e-6)


def _energy(X, links, mass=1.0, length=0.5, gravity=9.81):
    angles, rates = X[:links], X[links:]
    joint, speed, energy = np.zeros(2), np.zeros(2), 0.0
    for angle, rate in zip(angles, rates, strict=True):
        along, across = np.array([np.sin(angle), -np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
        centre, velocity = joint + length / 2 * along, speed + length / 2 * rate * across
        energy += mass * (velocity @ velocity / 2 + gravity * centre[1]) + mass * length**2 / 12 * rate**2 / 2
        joint, speed = joint + length * along, speed + length * rate * across
    return energy


def test_law_makes_the_errors_linear_and_rests_at_the_pose():
    plant, random = plants.resolve("planar_arm"), np.random.default_rng(0)
    assert (plant.n, plant.m) == (10, 5)
    np.testing.assert_allclose(plant.equilibrium[:5], 0.3 * np.arange(1, 6), atol=1e-12)
    X = random.uniform(-1, 1, (4, 10))
    without_friction = plants.resolve("planar_arm", {"friction": 0.0})
    accelerations = without_friction.f(X, without_friction.kappa(X))[..., 5:]
    np.testing.assert_allclose(accelerations, -4 * (X[:, :5] - 0.3 * np.arange(1, 6)) - 4 * X[:, 5:], rtol=1e-9)


def test_weight_is_held_at_rest():
    plant = plants.resolve("planar_arm")
    weights = 9.81 * 0.5 * (4.5 - np.arange(5)) * np.sin(plant.equilibrium[:5])
    np.testing.assert_allclose(plant.u_equilibrium, weights[::-1].cumsum()[::-1], rtol=1e-12)
