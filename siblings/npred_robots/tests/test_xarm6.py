"""The arm xArm6: its table against the description that a package brings, its dynamics against Pinocchio's."""

import importlib.util
from pathlib import Path

import numpy as np
import pin_models
import pytest

from npred import plants
from npred_robots import urdf, xarm6

BODIES = xarm6.bodies()


def test_accelerations_and_law_are_pinocchios():
    pin = pytest.importorskip("pinocchio", reason="needs the extra npred[pin]")
    plant, random = plants.resolve("xarm6"), np.random.default_rng(0)
    model, data = pin_models.model(pin, BODIES)
    X, u, t = random.uniform(-1, 1, (10, 12)), random.uniform(-5, 5, (10, 6)), random.uniform(0, 9, 10)
    phases = np.linspace(0, np.pi / 2, 6)
    for x, torque, moment in zip(X, u, t, strict=True):
        q, rates = x[:6], x[6:]
        np.testing.assert_allclose(plant.f(x, torque)[6:], pin.aba(model, data, q, rates, torque), rtol=1e-9)
        turn = 0.6 * moment + phases
        goal, speed, pull = 0.2 * np.sin(turn), 0.12 * np.cos(turn), -0.072 * np.sin(turn)
        sought = pull + 14 * (speed - rates) + 40 * (goal - q)
        law = pin.rnea(model, data, q, rates, sought)
        np.testing.assert_allclose(plant.kappa(x, moment), law, rtol=1e-9, atol=1e-10)


def test_a_plant_of_a_sibling_is_npreds():
    """Its trained networks load by their key, as those of a built-in plant."""
    assert plants.is_builtin("xarm6") and not plants.is_builtin("round_tank")


def test_the_table_is_that_of_the_description():
    """The URDF file comes with the package pybullet, which nothing here needs otherwise."""
    package = importlib.util.find_spec("pybullet_data")
    if package is None or not package.submodule_search_locations:
        pytest.skip("needs the package pybullet, for its file xarm6_robot.urdf")
    path = Path(next(iter(package.submodule_search_locations))) / "xarm" / "xarm6_robot.urdf"
    for body, expected in zip(BODIES, urdf.read(path), strict=True):
        assert (body.joint, body.mass, body.effort) == (expected.joint, expected.mass, expected.effort)
        for part in ("turn", "position", "axis", "centre", "inertia"):
            np.testing.assert_allclose(getattr(body, part), getattr(expected, part), rtol=0, atol=1e-15)
