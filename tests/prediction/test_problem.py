"""The family of kernels that serves a plant, and the plant's own simulator as a predictor."""

import re
import textwrap
from pathlib import Path

import numpy as np
import pytest

import npred
from npred import plants
from npred.base import grid
from npred.base.errors import ConfigError
from npred.lab import config
from npred.lab.stages.bench import candidates
from npred.plants import Plant
from npred.plants.black_box import BlackBox
from npred.prediction.delays import PROBLEMS, problem_of
from npred.prediction.methods import Euler, numerical
from npred.prediction.methods.rollout import Rollout


class OnArrays:
    """x' = -x + u, called on arrays."""

    states, inputs, traced = ("x",), ("u",), False
    f = lambda X, u, t, p: u - X
    kappa = lambda X, t, p: 0 * X
    V = lambda X, t, p: X[:, 0] ** 2


EACH = {
    "ConstantDelay": plants.resolve("planar_arm2"),
    "DelayPerInput": plants.resolve("unicycle"),
    "ArrayProblem": BlackBox("arrays", OnArrays),
}


@pytest.mark.parametrize("name", EACH)
def test_one_family_serves_a_plant(name: str):
    assert [kind.__name__ for kind in PROBLEMS if kind.serves(EACH[name])] == [name]
    assert type(problem_of(EACH[name])).__name__ == name


def test_what_a_family_lacks_is_refused_with_the_cure():
    family = problem_of(EACH["DelayPerInput"])
    for kernel, cure in ((lambda: family.picard(1e-9, 9), "use rk4"), (family.update, "freeze the estimate")):
        with pytest.raises(ConfigError, match=rf"expected one delay, plant unicycle has delays 0.25 s, 0.6 s; {cure}"):
            kernel()


def test_kinds_of_plants_are_told_apart_by_their_families_alone():
    package = Path(npred.__file__).parent
    asking = [path for path in package.rglob("*.py") if re.search(r"isinstance\([^)]*BlackBox", path.read_text())]
    assert [str(path.relative_to(package)) for path in asking] == ["prediction/delays/arrays.py"]


class Swelling:
    """x' = x cos 3t + u: the equation of a prediction's error is linear, and holds for errors of any size."""

    states, inputs = ("x",), ("u",)
    f = lambda x, u, t, p, M: [x.x * M.cos(3 * t) + u.u]
    kappa = lambda x, t, p, M: [-x.x]


def test_a_prediction_is_corrected_to_second_order_from_the_state_on():
    """P in closed form; what is corrected starts at another state, and is wrong by half."""
    correct, t, D_hat, X, errors = problem_of(Plant("swelling", Swelling)).correction(), 0.7, 1.3, 0.8, []
    for nx in (41, 81, 161):
        x = grid.nodes(nx)
        exact = X * np.exp((np.sin(3 * (t + D_hat * x)) - np.sin(3 * t)) / 3)
        P_hat, P = (exact + 0.3 + 0.4 * x**2)[:, None, None], np.empty((nx, 1, 1))
        correct(P_hat, np.array([[X]]), np.zeros((nx, 1, 1)), np.array([D_hat]), t, np.zeros(0), P)
        errors.append(np.abs(P[:, 0, 0] - exact).max())
    assert errors[0] < 5e-3
    assert np.polyfit(np.log([40, 80, 160]), np.log(errors), 1)[0] == pytest.approx(-2, abs=0.1)


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
    for plant in (traced, tank("def rollout", "def _rolled")):
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
