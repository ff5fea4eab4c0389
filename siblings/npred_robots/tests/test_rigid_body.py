"""Recursive dynamics against closed forms, energy, and each other."""

import numpy as np
import pytest
from six_joint import SIX

from npred.formulas import array_math
from npred_robots import rigid_body, urdf
from npred_robots.rigid_body import Body

M = array_math.NUMPY
STILL = [0.0] * 6


@pytest.fixture(scope="module")
def bodies():
    return urdf.read(SIX)


def rod(slides=False, mass=2.0, length=0.5):
    """A rod along its own -z, on a joint about (or along) y."""
    inertia = mass * length**2 / 12 * np.diag([1.0, 1.0, 0.0])
    centre = np.array([0.0, 0.0, -length / 2])
    return Body("joint", slides, np.eye(3), np.zeros(3), np.array([0.0, 1.0, 0.0]), mass, centre, inertia, 0.0, np.inf)


def test_a_pendulum():
    H = rigid_body.mass_matrix([rod()], [0.3], M)
    assert H[0][0] == pytest.approx(2.0 * 0.5**2 / 3)
    (load,) = rigid_body.torques([rod()], [0.3], [1.7], [0.0], 9.81, M)
    assert load == pytest.approx(2.0 * 9.81 * 0.25 * np.sin(0.3))


def test_a_slide():
    assert rigid_body.mass_matrix([rod(slides=True)], [0.3], M) == [[2.0]]
    assert rigid_body.torques([rod(slides=True)], [0.3], [1.0], [0.5], 9.81, M) == [pytest.approx(1.0)]


def test_the_mass_matrix_is_that_of_the_torques(bodies):
    """Column i is what a unit acceleration of joint i takes, without motion and weight."""
    q = np.random.default_rng(0).uniform(-1, 1, 6).tolist()
    columns = [rigid_body.torques(bodies, q, STILL, unit.tolist(), 0.0, M) for unit in np.eye(6)]
    H = np.array(rigid_body.mass_matrix(bodies, q, M))
    np.testing.assert_allclose(H, np.array(columns).T, rtol=1e-10, atol=1e-12)
    assert np.linalg.eigvalsh(H).min() > 0


def test_the_loads_are_those_of_lagrange(bodies):
    """d/dt (M q') - d(q' M q' / 2)/dq, by differences of the mass matrix, with weight as its potential's slope."""
    random = np.random.default_rng(1)
    q, rates, h = random.uniform(-1, 1, 6), random.uniform(-1, 1, 6), 1e-5

    def H(at):
        return np.array(rigid_body.mass_matrix(bodies, at.tolist(), M))

    turning = (H(q + h * rates) - H(q - h * rates)) / (2 * h) @ rates
    energies = [rates @ (H(q + h * unit) - H(q - h * unit)) @ rates / (4 * h) for unit in np.eye(6)]
    loads = rigid_body.torques(bodies, q.tolist(), rates.tolist(), STILL, 0.0, M)
    np.testing.assert_allclose(loads, turning - energies, atol=1e-8)


def test_weight_does_no_work_on_a_closed_path(bodies):
    """The loads at rest are the slope of a potential: their Jacobian by the positions is symmetric."""
    q, h = np.random.default_rng(2).uniform(-1, 1, 6), 1e-5

    def weight(at):
        return np.array(rigid_body.torques(bodies, at.tolist(), STILL, STILL, 9.81, M))

    J = np.array([(weight(q + h * unit) - weight(q - h * unit)) / (2 * h) for unit in np.eye(6)])
    np.testing.assert_allclose(J, J.T, atol=1e-8)
    assert np.abs(weight(q)).max() > 1
