"""Loops past the paper's world: a delay that is a function of time, a plant that is not its model, a disturbance."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import npred
from npred.base.errors import ConfigError
from npred.plants import Plant

PLANT = npred.plant("activator_repressor")
RK4 = npred.predictor(PLANT, "rk4", nx=51)
START = {"D_hat": 1.0, "X0": [0.03, 30.0], "t_end": 10.0, "dt": 0.01}


class Driven:
    """x' = -a x + u with kappa = sin(t): the input is known, whatever the state is."""

    states, inputs, parameters, period = ("x",), ("u",), {"a": 1.0}, 2 * np.pi
    f = lambda x, u, t, p, M: [-p.a * x.x + u.u]
    kappa = lambda x, t, p, M: [M.sin(t) + 0 * x.x]
    V = lambda x, t, p, M: x.x**2


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
            DRIVEN, npred.predictor(DRIVEN, "rk4", nx=11), D_hat=0.4, X0=[0.3], t_end=6.0, dt=dt, **settings
        )  # fmt: skip
        errors.append(abs(run.X[-1, 0] - exact))
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] > 0.9
    assert errors[-1] < 1e-3


class Carried:
    """Two integrals of what arrives, and nothing is sent."""

    states, inputs = ("a", "b"), ("u", "v")
    f = lambda x, u, t, p, M: [u.u, u.v]
    kappa = lambda x, t, p, M: [0 * x.a, 0 * x.b]


def test_a_disturbance_is_that_of_the_middle_of_each_step_for_the_whole_step():
    plant, dt = Plant("carried", Carried), 0.05
    run = npred.simulate(
        plant, npred.predictor(plant, "heun", nx=5), D=0.537, D_hat=0.5, X0=[0.0, 0.0], t_end=2.0, dt=dt,
        disturbance=lambda t: [np.cos(9 * t), t * t],
    )  # fmt: skip
    middle = run.t[:-1] + dt / 2
    wanted = dt * np.cumsum([np.cos(9 * middle), middle**2], axis=1).T
    np.testing.assert_allclose(run.X[1:], wanted, rtol=0, atol=1e-12)


@pytest.mark.parametrize("loops", [3, 70])  # one chunk of lanes, and two
def test_a_disturbance_may_differ_from_loop_to_loop(loops):
    plant, sizes = Plant("carried", Carried), np.linspace(-1.0, 1.0, loops)
    predictor = npred.predictor(plant, "heun", nx=5)
    asked = {"D": 0.537, "D_hat": 0.5, "t_end": 1.0, "dt": 0.05, "every": 20}
    run = npred.simulate(
        plant, predictor, X0=np.zeros((loops, 2)), disturbance=lambda t: sizes[:, None] * [np.cos(9 * t), t], **asked
    )  # fmt: skip
    for k, size in enumerate(sizes):
        own = {"disturbance": lambda t, size=size: [size * np.cos(9 * t), size * t]}
        alone = npred.simulate(plant, predictor, X0=[0.0, 0.0], **asked, **own)
        np.testing.assert_array_equal(run.X[k], alone.X)
    with pytest.raises(ConfigError, match=rf"2 finite numbers, one per input, or an array \({loops}, 2\)"):
        npred.simulate(plant, predictor, X0=np.zeros((loops, 2)), disturbance=lambda t: np.ones((5, 2)), **asked)


class Sent(Carried):
    """The same, with commands of time alone."""

    kappa = lambda x, t, p, M: [M.sin(3 * t), M.cos(2 * t)]


@pytest.mark.parametrize("delays", [(1.0, 1.0), (0.37, 1.0)])
def test_a_delay_of_time_is_linear_between_control_steps(delays):
    """Held commands pass at the speed of t - D, several in a step or none: integrals of a staircase, one per step."""
    plant, dt = Plant("sent", type("Sent", (Sent,), {"delays": delays})), 0.05
    run = npred.simulate(
        plant, npred.predictor(plant, "heun", nx=5), D=lambda t: 0.6 + 0.5 * np.sin(3 * t), D_hat=0.6, X0=[0.0, 0.0],
        t_end=4.0, dt=dt, u0=[0.3, -0.4],
    )  # fmt: skip
    steps = np.arange(len(run.t))
    for c, ratio in enumerate(delays):
        sent = np.concatenate([np.full(40, (0.3, -0.4)[c]), run.U[:, c]])  # from step -40 on
        total, phi = np.concatenate([[0.0], np.cumsum(sent)]), steps - ratio * (0.6 + 0.5 * np.sin(3 * run.t)) / dt
        area, speed = np.diff(np.interp(phi, np.arange(-40, len(steps) + 1), total)), np.diff(phi)
        at_first = sent[np.floor(phi[:-1]).astype(int) + 40]
        mean = np.where(speed > 0, area / speed, at_first)  # where D grows faster than the time, what acts stays
        np.testing.assert_allclose(run.X[1:, c], dt * np.cumsum(mean), rtol=0, atol=1e-7)
        assert speed.max() > 1.5


class Late:
    """x' = u, which takes 1 + k x seconds to arrive."""

    states, inputs, parameters = ("x",), ("u",), {"k": 0.5}
    f = lambda x, u, t, p, M: [u.u]
    kappa = lambda x, t, p, M: [-x.x]
    delay = lambda x, t, p, M: 1 + p.k * x.x


def test_commands_arrive_by_the_delay_of_the_plant_and_not_of_its_model():
    """x = 0.2 + 0.8 t until t = 1 + k x, at 6 s for k = 1. For k = 1.5 they would overtake each other at once."""
    model = Plant("late", Late)
    run, start = npred.predictor(model, "rk4", nx=21), {"X0": [0.2], "u0": [0.8], "t_end": 6.5, "dt": 0.01}
    loop = npred.simulate(model, run, truth=Plant("late", Late, {"k": 1.0}), **start)
    before = loop.t < 5.99
    np.testing.assert_allclose(loop.X[before, 0], 0.2 + 0.8 * loop.t[before], rtol=1e-12)
    assert loop.infeasible == -1 and loop.X[-1, 0] < 0.2 + 0.8 * 6.0
    ended = npred.simulate(model, run, truth=Plant("late", Late, {"k": 1.5}), **start)
    assert ended.infeasible == 0 and ended.margin == pytest.approx(1 - 1.5 * 0.8)


def test_a_constant_function_is_the_constant_to_the_bit():
    constant = npred.simulate(PLANT, RK4, D=1.0, **START)
    assert np.array_equal(npred.simulate(PLANT, RK4, D=lambda t: 1.0, **START).X, constant.X)


def test_each_loop_may_have_its_own_function_of_time():
    both = npred.simulate(PLANT, RK4, D=lambda t: np.array([1.0, 1.0 + 0.2 * np.sin(t)]), **START)
    alone = npred.simulate(PLANT, RK4, D=lambda t: 1.0 + 0.2 * np.sin(t), **START)
    assert both.X.shape[0] == 2 and np.array_equal(both.X[1], alone.X)


class Falling(Late):
    """The same, pushed to where the delay is 0 and below."""

    def kappa(x, t, p, M):
        return [-100 * (x.x + 5)]  # clipped to -0.9


def test_a_delay_that_falls_below_0_ends_the_loop_and_reads_no_later_command_than_the_newest():
    """x' = -0.8 until t = 1 + x, at 0.667 s, then -0.9 until 1 + x = 0 at 1.407 s; at 1.40 s two commands arrive."""
    plant, t1 = Plant("falling", Falling, {"k": 1.0}), 1.2 / 1.8
    start = {"X0": [0.2], "u0": [-0.8], "input_bounds": [(-0.9, 1.0)]}
    loop = npred.simulate(plant, npred.predictor(plant, "rk4", nx=5), t_end=2.0, dt=0.01, **start)
    wanted = 0.2 - 0.8 * np.minimum(loop.t, t1) - 0.9 * np.maximum(loop.t - t1, 0.0)
    np.testing.assert_allclose(loop.X[:142, 0], wanted[:142], rtol=0, atol=1e-9)
    assert loop.infeasible == 141 and np.isnan(loop.X[142:]).all()


def test_own_commands_at_the_true_delay_are_the_measured_actuator_state():
    for adaptation in (None, npred.DelayAdaptation(1e-9, 1.0, (0.1, 4.0))):
        runs = [npred.simulate(PLANT, RK4, D=1.0, adaptation=adaptation, actuator=actuator, **START)
                for actuator in ("measured", "history")]  # fmt: skip
        np.testing.assert_allclose(runs[0].X, runs[1].X, rtol=1e-9)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"D": 1.0, "actuator": "guessed"}, "actuator: expected one of measured, history, got 'guessed'"),
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
