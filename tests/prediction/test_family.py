"""The family of kernels that serves a plant: one for each kind, and no kind of plant is told apart elsewhere."""

import re
from pathlib import Path

import numpy as np
import pytest

import npred
from npred import plants
from npred.base import grid
from npred.base.errors import ConfigError
from npred.plants import Plant
from npred.plants.black_box import BlackBox
from npred.prediction.delays import PROBLEMS, problem_of


class OnArrays:
    """x' = -x + u, called on arrays."""

    states, inputs, traced = ("x",), ("u",), False

    def f(X, u, t, p):
        return u - X

    def kappa(X, t, p):
        return 0 * X

    def V(X, t, p):
        return X[:, 0] ** 2


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
