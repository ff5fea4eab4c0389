"""Rollouts through pieces against SciPy, and their derivatives against differences."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import npred
from npred.identification.fit import lag_states
from npred.identification.log import Log, Segments
from npred.identification.model import RolloutModel

BOX = """
import numpy as np

class Box:
    traced = False
    states, inputs, box = ("X", "Y"), ("U",), {"X": (-1.0, 1.0)}
    parameters = {"a": 1.5}

    def f(X, u, t, p):
        return np.stack([X[:, 1], p.a * np.sin(X[:, 0]) - X[:, 1] + u[:, 0]], axis=1)

    def kappa(X, t, p):
        return -2.0 * X[:, :1]

    def V(X, t, p):
        return X[:, 0] ** 2
"""


class Swing:
    """The same, traced, with the position as its output."""

    states, inputs = ("X", "Y"), ("U",)
    parameters = {"a": 1.5}
    outputs = ("angle",)
    f = lambda x, u, t, p, M: [x.Y, p.a * M.sin(x.X) - x.Y + u.U]
    kappa = lambda x, t, p, M: [-2.0 * x.X]
    output = lambda x, t, p, M: [p.a * x.X * x.X + x.Y]


def segments(outputs: int) -> Segments:
    rng = np.random.default_rng(3)
    t_U, t = np.arange(12) * 0.3, np.sort(rng.uniform(0.9, 3.4, 20))
    log = Log(t, rng.standard_normal((20, outputs)), t_U, rng.standard_normal((12, 1)), t_U[:1], np.arange(20))
    return Segments.of(log, 7, 1.0)


def swing() -> npred.plants.Plant:
    return npred.plants.make("swing", Swing)


@pytest.fixture(params=["traced", "called"])
def plant(request: pytest.FixtureRequest, tmp_path: Path):
    if request.param == "traced":
        return swing()
    (tmp_path / "box.py").write_text(BOX)
    return npred.plant(f"{tmp_path}/box.py:Box")


def test_states_are_those_of_scipy(plant):
    parts, X, theta = segments(2), np.random.default_rng(0).standard_normal((3, 2)), np.array([1.2, 0.3])
    model = RolloutModel(plant, (0, 1), steps=8)
    x = model.states(X, theta, parts.pieces([0.25]))
    for s in range(3):
        expected = _solved(parts, s, X[s], lambda t: 0.3 + _held(parts.log, t - 0.25))
        assert np.allclose(x[s][parts.mask[s]], expected, atol=1e-5)


def test_a_lag_is_that_of_scipy(plant):
    parts, X, tau = segments(2), np.random.default_rng(0).standard_normal((3, 2)), np.array([0.2])
    model = RolloutModel(plant, (0,), lag=True, steps=16)
    a = lag_states(parts, np.array([0.1]), tau)
    x = model.states(X, np.array([1.2]), parts.pieces([0.1]), (a, tau))
    rate = lambda t, a: (_held(parts.log, t - 0.1) - a) / 0.2
    filtered = solve_ivp(rate, (0.0, 3.5), [parts.log.U[0, 0]], max_step=5e-4, dense_output=True).sol
    assert np.allclose(a[:, 0], [filtered(t)[0] for t in parts.t[:, 0]], atol=2e-3)
    for s in range(3):
        expected = _solved(parts, s, X[s], lambda t: float(filtered(t)[0]))
        assert np.allclose(x[s][parts.mask[s]], expected, atol=2e-3)


def test_derivatives_are_those_of_differences(plant):
    parts, X, theta = segments(2), np.random.default_rng(0).standard_normal((3, 2)), np.array([1.2, 0.3])
    model, pieces = RolloutModel(plant, (0, 1), steps=2), parts.pieces([0.25])
    x, J = model.run(X, theta, pieces)
    assert np.allclose(x, model.states(X, theta, pieces))
    h = 1e-5
    for k, unit in enumerate(np.eye(4)):
        ends = [model.states(X + side * h * unit[:2], theta + side * h * unit[2:], pieces) for side in (-1, 1)]
        assert np.allclose(J[..., k], (ends[1] - ends[0]) / (2 * h), atol=2e-4)


def test_outputs_have_the_derivatives_of_differences():
    plant, parts = swing(), segments(1)
    X, theta = np.random.default_rng(0).standard_normal((3, 2)), np.array([1.2, 0.3])
    model, pieces = RolloutModel(plant, (0, 1)), parts.pieces([0.25])
    x, J = model.run(X, theta, pieces)
    y, G = model.outputs(x, J, parts.t, model.parameters(theta))
    assert np.allclose(y[..., 0], 1.2 * x[..., 0] ** 2 + x[..., 1])
    h = 1e-6
    for k, unit in enumerate(np.eye(4)):
        ends = []
        for side in (-1, 1):
            moved = theta + side * h * unit[2:]
            z = model.states(X + side * h * unit[:2], moved, pieces)
            ends.append(moved[0] * z[..., 0] ** 2 + z[..., 1])
        assert np.allclose(G[..., 0, k], (ends[1] - ends[0]) / (2 * h), atol=1e-6)


def test_rollouts_are_of_order_four():
    parts, X, pieces = segments(2), np.full((3, 2), 0.7), segments(2).pieces([0.25])
    exact = RolloutModel(swing(), (0,), steps=64).states(X, np.array([1.5]), pieces)
    coarser = [RolloutModel(swing(), (0,), steps=k).states(X, np.array([1.5]), pieces) for k in (1, 2)]
    errors = [np.abs(x - exact).max() for x in coarser]
    assert 3.5 < np.log2(errors[0] / errors[1]) < 4.6
    assert parts.mask.any()


def _held(log: Log, t: float) -> float:
    return float(log.U[max(np.searchsorted(log.t_U, t, side="right") - 1, 0), 0])


def _solved(parts: Segments, s: int, X: np.ndarray, u) -> np.ndarray:
    t = parts.t[s][parts.mask[s]]
    f = lambda t, x: [x[1], 1.2 * np.sin(x[0]) - x[1] + u(t)]
    return solve_ivp(f, (t[0], t[-1] + 1e-9), X, t_eval=t, max_step=0.002, rtol=1e-8, atol=1e-10).y.T
