"""The planar arm: mechanics that conserve energy, a law that gives linear errors, and any number of links."""

import numpy as np
import plant_claims
import pytest

from npred import plants
from npred.diagnosis import equilibrium
from npred.loop import metrics
from npred.loop.closed_loop import simulate
from npred.plants.base import Plant
from npred.plants.builtin.planar_arm import arm
from npred.prediction.methods import RK4


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


@pytest.mark.parametrize("links", [2, 5])
def test_law_makes_the_errors_linear_about_the_reference(links):
    plant, t = plants.resolve(f"planar_arm{links}", {"friction": 0.0}), np.linspace(0, 6, 7)
    X = np.random.default_rng(0).uniform(-1, 1, (7, 2 * links))
    goal, h = plant.target(t), 1e-4
    wanted = (plant.target(t + h) - plant.target(t - h))[:, links:] / (2 * h)
    errors = X - goal
    accelerations = plant.f(X, plant.kappa(X, t))[:, links:]
    np.testing.assert_allclose(accelerations - wanted, -4 * errors[:, :links] - 4 * errors[:, links:], atol=1e-7)


def test_friction_damps_the_errors_as_forces_on_an_arm_without_it():
    links, friction, t = 3, 5.0, np.linspace(0, 6, 7)
    with_it, without = (plants.resolve(f"planar_arm{links}", {"friction": value}) for value in (friction, 0.0))
    X = np.random.default_rng(0).uniform(-1, 1, (7, 2 * links))
    errors = X - without.target(t)
    forces = -friction * (errors[:, links:] + 2 * errors[:, :links])
    pushed = forces[:, ::-1].cumsum(axis=1)[:, ::-1]  # a rod takes its joint's torque, less the next one's
    torques = without.kappa(X, t) + pushed
    np.testing.assert_allclose(with_it.f(X, with_it.kappa(X, t)), without.f(X, torques), rtol=1e-9)


@pytest.mark.parametrize("links", [2, 7])
def test_the_reference_is_a_trajectory_of_the_law(links):
    assert equilibrium.slip(plants.resolve(f"planar_arm{links}"), 20.0)[0] < 1e-9
    np.testing.assert_allclose(plants.resolve("planar_arm2").target(0.0)[0], 0.3 + 0.1 * np.sin(1.0))


def test_weight_is_held_where_nothing_moves():
    plant = plants.resolve("planar_arm5", {"amplitude": 0.0})
    weights = 9.81 * 0.5 * (4.5 - np.arange(5)) * np.sin(0.3 * np.arange(1, 6))
    np.testing.assert_allclose(plant.u_target(1.0), weights[::-1].cumsum()[::-1], rtol=1e-12)


def test_gain_is_the_inverse_of_the_stiffness_against_a_torque_at_rest():
    """A constant torque e turns a link by e / (M stiffness + friction damping / 2), M = m l² / 3."""
    rod = Plant("rod", arm(1), {"amplitude": 0.0})
    assert metrics.gain(rod, 30.0) == pytest.approx(1 / (0.25 / 3 * 4 + 0.1 * 2), rel=1e-4)


class TestClaims(plant_claims.Claims):
    """The arm of two links. A held input is half a step late on a moving reference: that leaves 3e-3."""

    plant, D, X0, t_end = plants.resolve("planar_arm2"), 0.5, (0.6, 0.7, 0.1, -0.1), 30.0
    pipeline, near = "planar_arm", 5e-3


class TestPublishedDelay:
    """Five links and D = 0.5 s, as the literature has it."""

    plant = plants.resolve("planar_arm5")

    def test_the_loop_is_the_golden_one(self):
        """Steps of 0.0025 s: with 0.005 s RK4 itself is 4e-6 away from DOP853."""
        X0, dt = self.plant.target(0.0) + 0.1, 0.0025
        golden = plant_claims.golden_loop(self.plant, 0.5, X0, 1.5, dt)
        held = plant_claims.Held(self.plant, 401)
        loop = simulate(self.plant, held, D=0.5, D_hat=0.5, X0=X0, t_end=1.5, dt=dt)
        np.testing.assert_allclose(loop.X, golden, rtol=0, atol=1e-6)

    def test_it_tracks_with_the_predictor_and_only_with_it(self):
        """With it up to half a step of the held input, which is of first order in dt."""
        exact, half, without = (self.radii(*case) for case in ((0.5, 0.005), (0.5, 0.0025), (0.0, 0.005)))
        assert without.min() > 0.1 and exact.max() < 0.02
        np.testing.assert_allclose(half / exact, 0.5, atol=0.03)

    def radii(self, D_hat, dt):
        X0, every = plant_claims.box(self.plant, 4), round(0.1 / dt)
        predictor = RK4(self.plant, round(0.5 / dt) + 1)
        loops = simulate(self.plant, predictor, D=0.5, D_hat=D_hat, X0=X0, t_end=15.0, dt=dt, every=every)
        return metrics.radius(loops, self.plant.target(loops.t))
