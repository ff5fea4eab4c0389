"""A delay that the plant declares: predictions against SciPy and closed forms, and what loops make of them."""

import numpy as np
import pytest
from input_histories import means
from scipy.integrate import solve_ivp
from varying_delays import InSpace, InTime, with_delay

import npred
from npred import plants
from npred.base.errors import ConfigError
from npred.lab.scheduler.configuration import identity
from npred.plants import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods import RK4, Euler, Heun


class Decay:
    """X' = -X with D = 0.6 + 0.3 tanh X: P = X exp(-D(P))."""

    states, inputs = ("x",), ("u",)
    f = lambda x, u, t, p, M: [-x.x + u.u]
    kappa = lambda x, t, p, M: [0.0 * x.x]
    V = lambda x, t, p, M: x.x**2
    delay = lambda x, t, p, M: 0.6 + 0.3 * M.tanh(x.x)


class Clock:
    """s' = 1 with D(t) = (1 + t) / (1 + 2 t): its prediction is the time at which the command acts."""

    states, inputs = ("s",), ("u",)
    f = lambda x, u, t, p, M: [1 + 0 * u.u]
    kappa = lambda x, t, p, M: [0.0 * x.s]
    V = lambda x, t, p, M: x.s**2
    delay = lambda x, t, p, M: (1 + t) / (1 + 2 * t)


UNICYCLE, IN_TIME = with_delay(lambda x, t, p, M: x.x**2 + x.y**2), plants.resolve("unicycle_time_delay")
DECAY, CLOCK = Plant("decay", Decay), Plant("clock", Clock)
CELLS = {Euler: (10, 10_000), Heun: (10, 10_000), RK4: (20, 1000)}  # beyond that RK4's error is one of rounding


def commands(x):
    return np.stack([np.sin(2 * x + 0.3), 0.3 * np.cos(3 * x)], axis=-1)


def predicted(robot, X, t):
    """P(1) and s(1) by SciPy: dP/dx = H g f, ds/dx = H g."""

    def slope(x, z):
        velocity = robot.f(z[:3], commands(x))
        return H / (1 - robot.rate(z[:3], z[3], velocity)) * np.array([*velocity, 1.0])

    H = robot.D(X, t)
    return solve_ivp(slope, (0, 1), [*X, t], "DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


def order(method, errors_of):
    """The fitted order of a method, `errors_of` it and a number of cells."""
    cells = np.geomspace(*CELLS[method], 7).round().astype(int)
    errors = [errors_of(method, n) for n in cells]
    return -np.polyfit(np.log(cells), np.log(errors), 1)[0]


@pytest.mark.parametrize(("plant", "robot"), [(UNICYCLE, InSpace), (IN_TIME, InTime)], ids=["state", "time"])
@pytest.mark.parametrize("method", CELLS)
def test_each_method_keeps_its_order(plant, robot, method):
    X, t = np.array([0.5, 0.4, 0.3]), 0.7
    *P, s = predicted(robot, X, t)
    assert s == pytest.approx(t + robot.D(P, s), abs=1e-10)  # s(1) is when the command acts

    def error(method, n):
        return np.abs(method(plant, n + 1)(X, means(commands, n + 1), robot.D(X, t), t)[-1] - P).max()

    if method is RK4:  # at both ends u is read to order 3
        assert order(method, error) > 2.8
    else:
        assert order(method, error) == pytest.approx(method.order, abs=0.1)


@pytest.mark.parametrize("method", CELLS)
def test_the_horizon_of_a_delay_in_time_is_that_in_closed_form(method):
    """sigma(t) - t: 0.707107 s at 0, where D is 1 s, and 0.522681 s at 10 s."""

    def error(method, n, t=0.0):
        return abs(method(CLOCK, n + 1)([t], np.zeros((n + 1, 1)), InTime.D(None, t), t)[-1, 0] - InTime.sigma(t))

    assert order(method, error) == pytest.approx(method.order, abs=0.05)
    for t, horizon in ((0.0, 0.7071067811865476), (10.0, 0.5226805085936306)):
        assert InTime.sigma(t) - t == pytest.approx(horizon, rel=1e-14)
        assert error(RK4, 1000, t) < 1e-13


def test_the_command_is_the_laws_at_the_time_when_it_acts():
    loop = npred.simulate(IN_TIME, RK4(IN_TIME, 21), X0=[0.5, 0.5, 0.5], t_end=3.0, dt=0.01)
    np.testing.assert_allclose(loop.U, IN_TIME.kappa(loop.P, InTime.sigma(loop.t)), rtol=1e-12, atol=1e-14)


def test_the_closed_form_of_the_scalar_diagnostic():
    """P = X exp(-D(P)) without an input [Zhao, Gao, Xu, Kao, Automatica 144 (2022) 110479, corrected]."""
    for X, P in ((0.2, 0.10632902870502527), (0.1, 0.05400009924092605), (0.05, 0.027217489803397023)):
        H = 0.6 + 0.3 * np.tanh(X)
        assert RK4(DECAY, 401)([X], np.zeros((401, 1)), H)[-1, 0] == pytest.approx(P, abs=1e-12)


def test_a_constant_through_the_general_formula_is_a_constant_to_the_bit():
    built_in = plants.resolve("activator_repressor")
    general = Plant(
        "general", type("General", (built_in.declaration,), {"delay": staticmethod(lambda x, t, p, M: 1.0)})
    )
    start = {"X0": [[0.03, 30.0], [0.1, 6.0]], "t_end": 5.0}
    loops = npred.simulate(general, npred.predictor(general, "rk4"), **start)
    constant = npred.simulate(built_in, npred.predictor(built_in, "rk4"), D=1.0, D_hat=1.0, **start)
    assert np.array_equal(loops.X, constant.X) and np.array_equal(loops.P, constant.P)


@pytest.mark.parametrize(("plant", "first"), [(UNICYCLE, 0.5), (IN_TIME, np.sqrt(0.5))])
def test_it_rests_until_its_first_command_arrives(plant, first):
    loop = npred.simulate(plant, RK4(plant, 21), X0=[0.5, 0.5, 0.5], t_end=1.0, dt=0.01)
    moved = np.abs(loop.X - 0.5).max(axis=1) > 0
    assert loop.t[np.argmax(moved)] == pytest.approx(first, abs=0.02) and moved[np.argmax(moved) :].all()


def test_the_first_command_from_the_published_start():
    loop = npred.simulate(UNICYCLE, RK4(UNICYCLE, 201), X0=[1.0, 1.0, 1.0], t_end=0.01)
    np.testing.assert_allclose(loop.U[0, ::-1], [-9.32412, -20.173825], rtol=1e-6)
    assert loop.D_hat[0] == 2.0


def test_commands_that_would_overtake_each_other_mark_the_loop_and_end_it():
    loops = npred.simulate(UNICYCLE, RK4(UNICYCLE, 101), X0=[[1.0, 1.0, 1.0], [0.3, 0.3, 0.3]], t_end=6.0, dt=0.005)
    k = loops.infeasible[0]
    assert 300 < k < 700 and loops.infeasible[1] == -1
    assert loops.margin[0] <= 0 and np.isnan(loops.margin[1])
    assert np.isfinite(loops.X[0, k]).all() and np.isnan(loops.X[0, k + 1 :]).all()
    assert np.isfinite(loops.X[1]).all()
    assert f"first at control step {k}, x = " in str(loops) and "expected above 0" in str(loops)


class Jump:
    """x' = -x whose delay jumps from 0.1 s to 50 s, beyond the history of commands: no rate says so beforehand."""

    states, inputs = ("x",), ("u",)
    f = lambda x, u, t, p, M: [-x.x + u.u]
    kappa = lambda x, t, p, M: [0 * x.x]
    V = lambda x, t, p, M: x.x**2
    delay = lambda x, t, p, M: M.where(x.x < 1, 50.0, 0.1)


def test_a_delay_that_jumps_beyond_the_history_ends_the_loop():
    plant = Plant("jump", Jump)
    loops = npred.simulate(plant, RK4(plant, 11), X0=[[np.exp(0.505)], [1e9]], t_end=5.0, dt=0.01)
    assert loops.infeasible.tolist() == [51, -1]
    assert np.isnan(loops.X[0, 52:]).all() and np.isfinite(loops.X[1]).all() and np.isfinite(loops.U[1]).all()


def test_the_history_reaches_back_as_far_as_the_model_believes():
    """Before t = 0 the input was 0.5, for the model's delay of 1.2 s, though the true one is 0.3 s."""
    truth = Plant("decay", type("Short", (Decay,), {"delay": lambda x, t, p, M: 0.3 + 0.1 * M.tanh(x.x)}))
    model = Plant("decay", type("Long", (Decay,), {"delay": lambda x, t, p, M: 1.2 + 0.1 * M.tanh(x.x)}))
    rk4 = RK4(model, 21)
    loop = npred.simulate(model, rk4, X0=[0.4], t_end=0.5, dt=0.01, truth=truth, u0=[0.5])
    P = rk4([0.4], np.full((21, 1), 0.5), 1.2 + 0.1 * np.tanh(0.4))
    np.testing.assert_allclose(loop.P[0], P[-1], rtol=1e-12)


@pytest.mark.parametrize("given", [{"D": 1.0}, {"D_hat": 1.0}, {"adaptation": npred.DelayObserver()}])
def test_a_declared_delay_takes_no_other(given):
    with pytest.raises(ConfigError, match="expected a plant that does not declare its delay, got late"):
        npred.simulate(UNICYCLE, RK4(UNICYCLE), X0=[0.5, 0.5, 0.5], t_end=1.0, **given)


def test_what_the_family_lacks_is_refused_with_the_cure():
    with pytest.raises(ConfigError, match=r"picard: expected a delay that is a number, .*; use rk4"):
        npred.predictor(DECAY, "picard")


@pytest.mark.parametrize("part", ["onnx", "export c"])
def test_files_whose_command_is_the_laws_at_t_plus_D_are_refused(part):
    """Where the law is free of time, or D a number, they hold; a fused network gives P alone."""
    for plant in (UNICYCLE, IN_TIME):
        with pytest.raises(ConfigError, match=rf"{part}: expected a law free of time, .* is read at s\(1\)"):
            problem_of(plant).needs(part)
        problem_of(plant).needs("fused")
    problem_of(plants.resolve("transport_tank")).needs(part)


def test_the_delay_is_part_of_the_identity():
    program = identity(UNICYCLE)["program"]
    assert set(program) - set(identity(plants.resolve("scalar"))["program"]) == {"delay", "reference"}
    assert isinstance(program, dict) and program["delay"] != identity(IN_TIME)["program"]["delay"]
    assert IN_TIME.clocked and not UNICYCLE.clocked


class Pulsing:
    """x' = u - x, and a delay of time whose rate goes past 1: 1 - D_t = 1 + 1.125 sin 1.5 t."""

    states, inputs = ("x",), ("u",)
    f = lambda x, u, t, p, M: [u.u - x.x]
    kappa = lambda x, t, p, M: [-x.x]
    V = lambda x, t, p, M: x.x**2
    delay = lambda x, t, p, M: 0.8 + 0.75 * M.cos(1.5 * t)


@pytest.mark.parametrize("guarded", [False, True])
def test_the_margin_of_a_prediction_is_that_of_the_time_when_its_node_comes(guarded):
    """A delay of time alone: ds/dx = H / (1 - D_t(s)) needs no plant, and is stepped here by hand."""
    plant, dt, nx = Plant("pulsing", Pulsing), 0.01, 41
    run = npred.predictor(plant, "rk4", nx)
    loop = npred.simulate(plant, npred.guarded(run) if guarded else run, X0=[1.0], t_end=4.0, dt=dt)

    def margins(t):
        """1 - D_t at the nodes of the prediction from t, up to the first that is not above 0."""
        h, s, found = (0.8 + 0.75 * np.cos(1.5 * t)) / (nx - 1), t, []
        for _ in range(nx - 1):
            found.append(1 + 1.125 * np.sin(1.5 * s))
            if found[-1] <= 0:
                break
            k1 = 1 / (1 + 1.125 * np.sin(1.5 * s))
            k2 = 1 / (1 + 1.125 * np.sin(1.5 * (s + h / 2 * k1)))
            k3 = 1 / (1 + 1.125 * np.sin(1.5 * (s + h / 2 * k2)))
            k4 = 1 / (1 + 1.125 * np.sin(1.5 * (s + h * k3)))
            s += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return found

    k = int(loop.infeasible)
    assert k == next(k for k in range(400) if margins(k * dt)[-1] <= 0)
    assert loop.margin == pytest.approx(margins(k * dt)[-1], rel=1e-9)
    assert 1 + 1.125 * np.sin(1.5 * k * dt) > 0.5  # the margin at the time of the prediction, which broke nothing


class Chased:
    """x' = u and D = 1 + x: with u = 1 commands never arrive, 1 - D_X f = 0."""

    states, inputs, delay = Clock.states, Clock.inputs, lambda x, t, p, M: 1 + x.s
    f = lambda x, u, t, p, M: [u.u]
    kappa = lambda x, t, p, M: [0 * x.s]


def test_commands_that_never_arrive_end_a_prediction_too():
    u = np.array([0.5, 0.5, 1.0, 0.5, 0.5])[None, :, None]
    P = Euler(Plant("chased", Chased), 5).predict(np.array([[0.2]]), u, np.array([1.2]), 0.0)
    assert np.isfinite(P[0, :3]).all() and np.isnan(P[0, 3:]).all()
