"""The plant's own simulator as a predictor: called with rows, refused where there is none, a rival of the benchmark."""

import textwrap

import numpy as np
import pytest

from npred import plants
from npred.base.errors import ConfigError
from npred.lab import config
from npred.lab.stages.bench import candidates
from npred.prediction.methods import Euler, numerical
from npred.prediction.methods.rollout import Rollout

FILE = """
import numpy as np


class Tank:
    traced = False
    states, inputs, box = ("h",), ("q",), {"h": (0.5, 2.0)}

    def f(X, u, t, p):
        return u - X

    def kappa(X, t, p):
        return 1.0 - 0.0 * X

    def V(X, t, p):
        return X[:, 0] ** 2

    def rollout(X, u, D_hat, t, p):
        P = [X]
        for k in range(u.shape[1] - 1):
            P.append(P[-1] + (D_hat / (u.shape[1] - 1))[:, None] * (u[:, k] - P[-1]))
        return np.stack(P, axis=1)
"""


@pytest.fixture
def tank(tmp_path):
    def made(old="", new=""):
        path = tmp_path / "tank.py"
        path.write_text(textwrap.dedent(FILE).replace(old, new))
        return plants.resolve(f"{path}:Tank")

    return made


def test_it_is_the_declared_function_on_rows(tank):
    plant = tank()
    random = np.random.default_rng(0)
    X, u, D_hat = random.random((3, 1)), random.random((3, 6, 1)), np.array([0.1, 0.5, 1.0])
    np.testing.assert_allclose(numerical("rollout", plant, 6)(X, u, D_hat), Euler(plant, 6)(X, u, D_hat), rtol=1e-13)


def test_a_plant_without_a_simulator_refuses_it(tank):
    traced = plants.resolve("scalar")
    for plant in (traced, tank("def rollout", "def rolled")):
        with pytest.raises(ConfigError, match=r"rollout: expected traced = False and rollout\(X, u.*use rk4"):
            Rollout(plant)
    with pytest.raises(ConfigError, match="rollout expected traced = False"):
        traced.rollout(np.ones((1, 1)), np.ones((1, 2, 1)), np.ones(1), 0.0)


def test_a_simulator_that_fails_or_returns_another_shape_is_one_line(tank):
    X, u = np.ones((1, 1)), np.ones((1, 6, 1))
    with pytest.raises(ConfigError, match=r"plant Tank: rollout failed .*tank\.py:\d+"):
        Rollout(tank("P = [X]", "P = [missing]"))(X, u, 0.5)
    with pytest.raises(ConfigError, match=r"expected to return P \(1, 6, 1\)"):
        Rollout(tank("np.stack(P, axis=1)", "X"))(X, u, 0.5)


def test_the_benchmark_knows_it_where_the_plant_has_one(tank):
    pipeline = config.Pipeline(plant="any")
    assert candidates.one_step_methods(pipeline, tank())["rollout"] is Rollout
    assert "rollout" not in candidates.one_step_methods(pipeline, plants.resolve("scalar"))
