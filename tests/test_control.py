"""The controller alone: the loop's own steps, nothing kept but the estimate, and the example that shows it."""

import importlib.util
import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from operator_samples import PLANT, SMALL, operator

import npred
from npred.control import Controller
from npred.errors import ConfigError, DivergedError
from npred.plants import Plant
from npred.predictors import RK4
from npred.runtimes import RUNTIMES, predictor

LAW = npred.DelayAdaptation(1000.0, 1.0, (0.1, 4.0))
X0 = [0.03, 30.0]


class Cube:
    """x' = x³ + u, whose open loop escapes in finite time."""

    states, inputs = ("x",), ("u",)

    def f(x, u, t, p, M):
        return [x.x**3 + u.u]

    def kappa(x, t, p, M):
        return [-(x.x**3) - x.x]

    def V(x, t, p, M):
        return x.x**2


CUBE = Plant("cube", Cube)


def at_nodes(U, k, nx, steps):
    """u at the nodes as step k reads it: U linear between starts of steps, 0 before t = 0, and U[k - 1] at x = 1."""
    times = np.arange(-steps, k)
    commanded = np.concatenate([np.zeros((steps, 1)), U[:k]])
    return np.interp(k - steps * (1 - np.linspace(0, 1, nx)), times, commanded[:, 0])[:, None]


def loop(run, adaptation=LAW, bounds=None):
    """A simulated loop with all that each of its 200 steps saw."""
    return npred.simulate(PLANT, run, D=1.0, D_hat=2.0, X0=X0, t_end=2.0, dt=0.01, adaptation=adaptation,
                          input_bounds=bounds, samples=np.arange(200))  # fmt: skip


@pytest.mark.parametrize("runtime", ["numerical", *RUNTIMES])
def test_steps_equal_those_of_the_simulated_loop(runtime):
    run = RK4(PLANT, 21) if runtime == "numerical" else predictor(runtime, PLANT, operator(SMALL[0]), 21)
    wanted = loop(run)
    controller = npred.controller(PLANT, run, LAW, 0.01, D_hat=2.0)
    for k in range(200):
        np.testing.assert_allclose(controller.D_hat, wanted.D_hat[k], rtol=1e-12)
        u_nodes = at_nodes(wanted.U, k, 21, 100)
        U = controller.step(wanted.samples.X[k], wanted.samples.u[k], u_nodes)
        np.testing.assert_allclose(U, wanted.U[k], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(controller.D_hat, wanted.D_hat[200], rtol=1e-12)
    assert controller.D_hat != 2.0


def test_without_adaptation_and_with_bounds():
    run, bounds = RK4(PLANT, 21), [(-0.001, 0.002)]
    wanted = loop(run, None, bounds)
    controller = Controller(PLANT, run, None, 0.01, D_hat=2.0, input_bounds=bounds)
    for k in range(200):
        np.testing.assert_array_equal(controller.step(wanted.samples.X[k], wanted.samples.u[k]), wanted.U[k])
    assert controller.D_hat == 2.0


def test_goes_on_from_a_saved_state():
    run, first, second = RK4(PLANT, 21), None, None
    first, second = (npred.controller(PLANT, run, LAW, 0.01, D_hat=2.0) for _ in range(2))
    u = 0.01 * np.ones((21, 1))
    for _ in range(5):
        first.step(X0, u)
    saved = json.loads(json.dumps(first.state()))
    assert saved["step"] == 5
    second.restore(saved)
    np.testing.assert_array_equal(first.step(X0, u), second.step(X0, u))
    assert first.state() == second.state()


def test_keeps_no_memory_in_the_steady_state():
    controller = npred.controller(PLANT, predictor("fused", PLANT, operator(SMALL[0]), 21), LAW, 0.01, D_hat=2.0)
    X, u = np.array(X0), np.zeros((21, 1))
    for _ in range(10):
        controller.step(X, u)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(1000):
        controller.step(X, u)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 1000  # bytes in all, less than one a step


def test_starts_in_the_middle_of_the_bounds():
    assert npred.controller(PLANT, RK4(PLANT, 21), LAW, 0.01).D_hat == 2.05


def test_a_bad_measurement_leaves_it_as_it_was():
    controller = npred.controller(PLANT, RK4(PLANT, 21), LAW, 0.01, D_hat=2.0)
    u = np.zeros((21, 1))
    controller.step(X0, u)
    before = controller.state()
    with pytest.raises(DivergedError, match="expected finite X and u"):
        controller.step([np.nan, 1.0], u)
    with pytest.raises(ConfigError, match=r"step: expected X \(2,\) and u \(21, 1\), got \(3,\) and \(21, 1\)"):
        controller.step([1.0, 2.0, 3.0], u)
    assert controller.state() == before


def test_a_prediction_that_diverges_leaves_it_as_it_was():
    """x' = x³ + u from 3 escapes within the horizon: no NaN goes to the actuator, nor stays inside."""
    run, law = RK4(CUBE, 51), npred.DelayAdaptation(1.0, 1.0, (0.1, 2.0))
    controller, u = npred.controller(CUBE, run, law, 0.01, D_hat=1.0), np.zeros((51, 1))
    U = controller.step([0.3], u)
    before, given = controller.state(), U.copy()
    with pytest.raises(DivergedError, match="the prediction from X and u is not finite; hold the last U"):
        controller.step([3.0], u)
    assert controller.state() == before and given == U
    assert np.isfinite(controller.step([0.3], u)).all() and np.isfinite(controller.D_hat)


@pytest.mark.parametrize(
    ("X", "u", "message"),
    [
        (0.5, np.zeros((21, 1)), r"step: expected X \(2,\) and u \(21, 1\), got \(\) and \(21, 1\)"),
        ([0.03], np.zeros((21, 1)), r"got \(1,\) and \(21, 1\)"),
        (X0, 0.0, r"got \(2,\) and \(\)"),
        (X0, np.zeros((1, 1)), r"got \(2,\) and \(1, 1\)"),
        (["a", "b"], np.zeros((21, 1)), "X: expected an array of numbers"),
        (X0, [[1.0], [1.0, 2.0]], "u: expected an array of numbers"),
    ],
)
def test_a_measurement_of_another_shape_is_told(X, u, message):
    controller = npred.controller(PLANT, RK4(PLANT, 21), LAW, 0.01, D_hat=2.0)
    with pytest.raises(ConfigError, match=message):
        controller.step(X, u)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dt": 0.0}, "dt: expected a control step above 0 s"),
        ({"D_hat": 9.0}, r"D_hat: expected within \[0.1, 4\] s, got 9"),
        ({"adaptation": None}, "give D_hat"),
        ({"adaptation": 3.0}, "adaptation: expected a DelayLaw"),
        ({"predictor": None}, "predictor: expected one, got None"),
        ({"dt": "0.1"}, "dt: expected a control step above 0 s, got '0.1'"),
        ({"D_hat": [1.0, 2.0]}, "D_hat: expected one delay"),
        ({"D_hat": np.inf, "adaptation": None}, "D_hat: expected within"),
    ],
)
def test_mistakes_are_told(changes, message):
    with pytest.raises(ConfigError, match=message):
        npred.controller(**{"plant": PLANT, "predictor": RK4(PLANT, 21), "adaptation": LAW, "dt": 0.01} | changes)


def test_a_state_that_is_none_is_told():
    controller = npred.controller(PLANT, RK4(PLANT, 21), LAW, 0.01)
    for state in ({"D_hat": 1.0}, {"D_hat": 1.0, "step": 2.5}, {"D_hat": 1.0, "step": np.inf}):
        with pytest.raises(ConfigError, match="expected D_hat and step"):
            controller.restore(state)


def test_the_example_converges():
    path = Path(__file__).parent.parent / "docs" / "hardware_in_the_loop.py"
    assert len(path.read_text().splitlines()) <= 50
    spec = importlib.util.spec_from_file_location("hardware_in_the_loop", path)
    assert spec and spec.loader
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    X, D_hat = example.main(t_end=40.0)
    np.testing.assert_allclose(X, PLANT.equilibrium, rtol=1e-3)
    assert D_hat == pytest.approx(1.19, abs=0.03)
