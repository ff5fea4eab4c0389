"""Loops past the paper's world: a delay that is a function of time, a plant that is not its model, a disturbance."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import npred
from npred.errors import ConfigError
from npred.plants import Plant

PLANT = npred.plant("activator_repressor")
RK4 = npred.predictor("rk4", PLANT, nx=51)
START = {"D_hat": 1.0, "X0": [0.03, 30.0], "t_end": 10.0, "dt": 0.01}


class Driven:
    """x' = -a x + u with kappa = sin(t): the input is known, whatever the state is."""

    states, inputs, parameters, period = ("x",), ("u",), {"a": 1.0}, 2 * np.pi

    def f(x, u, t, p, M):
        return [-p.a * x.x + u.u]

    def kappa(x, t, p, M):
        return [M.sin(t) + 0 * x.x]

    def V(x, t, p, M):
        return x.x**2


DRIVEN = Plant("driven", Driven)
REALITIES = {
    "drift": ({"D": lambda t: 1 + 0.3 * np.sin(t)}, 1.0, lambda t: 0.0),
    "jump": ({"D": lambda t: 0.5 if t < 3 else 1.2}, 1.0, lambda t: 0.0),
    "model": ({"D": 0.7, "truth": Plant("driven", Driven, {"a": 1.4})}, 1.4, lambda t: 0.0),
    "disturbance": ({"D": 0.7, "disturbance": lambda t: [0.2 * np.cos(3 * t)]}, 1.0, lambda t: 0.2 * np.cos(3 * t)),
}


@pytest.mark.parametrize("name", REALITIES)
def test_the_plant_gets_what_left_the_actuator_a_delay_ago(name):
    """Against SciPy on x' = -a x + U(t - D(t)) + d(t) with U(t) = sin(t + D_hat): first order in the control step."""
    settings, a, d = REALITIES[name]
    delay = settings["D"] if callable(settings["D"]) else lambda t: settings["D"]

    def slope(t, x):
        sent = t - delay(t)
        return -a * x + (np.sin(sent + 0.4) if sent >= 0 else 0.0) + d(t)

    exact = solve_ivp(slope, (0, 6), [0.3], rtol=1e-9, atol=1e-11, max_step=2e-3).y[0, -1]
    steps, errors = [0.1, 0.03, 0.01, 0.003, 0.001], []
    for dt in steps:
        run = npred.simulate(
            DRIVEN, npred.predictor("rk4", DRIVEN, nx=11), D_hat=0.4, X0=[0.3], t_end=6.0, dt=dt, **settings
        )  # fmt: skip
        errors.append(abs(run.X[-1, 0] - exact))
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] > 0.9
    assert errors[-1] < 1e-3


def test_a_constant_function_is_the_constant_to_the_bit():
    constant = npred.simulate(PLANT, RK4, D=1.0, **START)
    assert np.array_equal(npred.simulate(PLANT, RK4, D=lambda t: 1.0, **START).X, constant.X)


def test_each_loop_may_have_its_own_function_of_time():
    both = npred.simulate(PLANT, RK4, D=lambda t: np.array([1.0, 1.0 + 0.2 * np.sin(t)]), **START)
    alone = npred.simulate(PLANT, RK4, D=lambda t: 1.0 + 0.2 * np.sin(t), **START)
    assert both.X.shape[0] == 2 and np.array_equal(both.X[1], alone.X)


def test_own_commands_at_the_true_delay_are_the_measured_actuator_state():
    for adaptation in (None, npred.DelayAdaptation(1e-9, 1.0, (0.1, 4.0))):
        runs = [npred.simulate(PLANT, RK4, D=1.0, adaptation=adaptation, actuator=actuator, **START)
                for actuator in ("measured", "history")]  # fmt: skip
        np.testing.assert_allclose(runs[0].X, runs[1].X, rtol=1e-9)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"D": 1.0, "actuator": "guessed"}, 'actuator: expected "measured" or "history", got \'guessed\''),
        ({"D": 1.0, "disturbance": 0.1}, "disturbance: expected a function of t, got 0.1"),
        ({"D": 1.0, "disturbance": lambda t: [0.1, 0.2]}, r"disturbance\(t\): expected 1 finite numbers"),
        ({"D": 1.0, "truth": npred.plant("scalar")}, "truth: expected a plant with 2 states and 1 inputs"),
        ({"D": lambda t: "late"}, r"D\(t\): expected an array of real numbers"),
        ({"D": lambda t: 0.5 - t}, r"D\(t\): expected"),
        ({}, "D: expected a delay in s, got none; give D"),
    ],
)
def test_what_makes_no_loop_is_refused_in_one_line(settings, words):
    with pytest.raises(ConfigError, match=words):
        npred.simulate(PLANT, RK4, **(START | settings))
