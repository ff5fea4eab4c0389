"""The baselines of pipeline/interpreted.py: the values of Euler's method, in plain Python."""

import numpy as np
import pytest
from conftest import HERE
from golden import case

from npred import plants
from npred.base import grid, registry
from npred.base.errors import ConfigError
from npred.plants.black_box import BlackBox
from npred.prediction import methods as predictors
from npred.prediction.methods import Euler

FILE = HERE.parent / "pipeline" / "interpreted.py"
Published, EulerPython = (registry.BASELINES.load("test", f"{FILE}:{name}") for name in ("Published", "EulerPython"))
PLANT = plants.resolve("activator_repressor")


@pytest.mark.parametrize("baseline", [EulerPython, Published])
def test_they_equal_euler(baseline):
    golden, nx = case("B"), 41
    u = golden.u(grid.nodes(nx))[:, None]
    np.testing.assert_allclose(baseline(PLANT, nx)(golden.X, u, 1.0), Euler(PLANT, nx)(golden.X, u, 1.0), rtol=1e-12)


def test_a_prediction_that_leaves_the_floats_is_nan_from_there_on():
    plant = plants.resolve("van_der_pol")
    X, u, D_hat = np.full((1, plant.n), 30.0), np.zeros((1, 201, plant.m)), np.full(1, 9.0)
    compiled, interpreted = Euler(plant, 201), EulerPython(plant, 201)
    P, Q = (np.isfinite(one.predict(X, u, D_hat, np.zeros(1))).all(axis=2)[0] for one in (compiled, interpreted))
    assert P[0] and not P[-1] and (P == Q).all()


def test_euler_in_python_works_on_floats_of_python():
    """NumPy's numbers would make the baseline several times slower, and flatter what is compared with it."""
    euler = EulerPython(plants.resolve("planar_arm2"), 11)
    values = euler._f(*[0.1] * 4, *[0.2] * 2, 0.0, *euler.plant.p.tolist())
    assert {type(value) for value in values} == {float}


@pytest.mark.parametrize("baseline", [EulerPython, Published])
def test_they_call_a_plant_that_is_not_traced(baseline):
    class Box:
        traced, states, inputs, box = False, ("x",), ("U",), {"x": (0, 1)}

        def f(X, u, t, p):
            return u - X**2

        def kappa(X, t, p):
            return -X

        def V(X, t, p):
            return X[:, 0] ** 2

    plant, (X, u) = BlackBox("box", Box), (np.array([0.4]), np.full((5, 1), 0.3))
    np.testing.assert_allclose(
        baseline(plant, 5)(X, u, 0.2), predictors.numerical("euler", plant, 5)(X, u, 0.2), rtol=1e-12
    )


@pytest.mark.parametrize("name", ["unicycle", "unicycle_time_delay"])
def test_a_plant_with_other_delays_is_refused(name: str):
    with pytest.raises(ConfigError, match=rf"published: expected a plant with one constant delay .* plant {name} is"):
        Published(plants.resolve(name))
