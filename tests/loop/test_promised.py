"""What the safety filter promises: plans that rest within the limits, kept whatever moves, and withdrawn in time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_lyapunov

import npred
from npred.loop.safety import filter as grid
from npred.plants import Plant


def mass(aim, wall, law=(25.0, 10.0)):
    """A mass with |u| <= 1 that is sent to `aim`, in front of a wall, which may depend on time."""

    class Mass:
        states, inputs, parameters = ("x", "v"), ("u",), {"aim": aim}
        box, input_bounds, guess = {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}, ((-1.0, 1.0),), (aim, 0.0)
        f = lambda x, u, t, p, M: [x.v, u.u]
        kappa = lambda x, t, p, M: [-law[0] * (x.x - p.aim) - law[1] * x.v]
        setpoint = lambda x, t, p, M: [x.x - p.aim]
        safe = lambda x, t, p, M: [(wall(t, M) if callable(wall) else wall) - x.x]

    return Plant("mass", Mass)


def loop(plant, X0=(0.0, 0.0), t_end=20.0, **more):
    parts = {"D": 0.3, "D_hat": 0.3, "dt": 0.02, "actuator": "history", "u0": [0.0], "progress": False}
    return npred.simulate(
        plant, npred.predictor(plant, "rk4", 31), X0=list(X0), t_end=t_end, safety=npred.SafetyFilter(), **parts | more
    )


def filtered(plant, x):
    """U, and whether it is promised, of one state that a command meets."""
    safety, bounds = npred.SafetyFilter(), np.array(plant.input_bounds, dtype=float)
    U, plan = np.array(plant.kappa(np.array(x)))[:, None].copy(), np.zeros((grid.remembered(plant), 1))
    told, (low, high) = [np.zeros(1) for _ in range(5)], (side[:, None].copy() for side in bounds.T)
    numbers = safety.numbers(plant, 0.02, bounds)["safety"]
    at = np.array(x)[None, :, None].copy(), np.zeros((1, 1))
    safety.kernels(plant)["protect"](*at, plant.p, numbers, low, high, U, plan, *told)
    return U[0, 0], told[3][0] > 0


def test_a_brake_that_takes_longer_than_the_laws_time_constants_is_begun_in_time():
    far = loop(mass(20.0, 20.5), t_end=25.0)
    assert far.promised.all() and far.safety.min() > 0 and not far.unkept
    assert far.X[:, 1].max() > 3 and far.X[-1] == pytest.approx([20.0, 0.0], abs=0.05)


def test_a_set_point_that_moves_is_reached_and_one_beyond_the_wall_is_approached():
    there = loop(mass(0.0, 10.2), setpoints={"aim": ([1.0], [10.0])}, t_end=25.0)
    beyond = loop(mass(0.0, 10.2), setpoints={"aim": ([1.0], [12.0])}, t_end=25.0)
    assert there.promised.all() and there.safety.min() > 0 and there.X[-1, 0] == pytest.approx(10.0, abs=0.05)
    assert beyond.promised.all() and beyond.safety.min() > 0 and 9.9 < beyond.X[-1, 0] < 10.2


def test_a_door_that_closes_in_time_is_passed_or_not_as_promised():
    plant = mass(5.0, lambda t, M: M.maximum(10.0 - 1.2 * t, 5.2))
    X0 = np.random.default_rng(0).uniform([0.0, -2.0], [9.0, 2.0], (20, 2))
    doors = npred.simulate(
        plant, npred.predictor(plant, "rk4", 31), D=0.3, D_hat=0.3, X0=X0, t_end=12.0, dt=0.02, actuator="history",
        u0=[0.0], progress=False, safety=npred.SafetyFilter(),
    )  # fmt: skip
    least = doors.safety.min(axis=(1, 2))
    assert 5 < doors.promised[:, 0].sum() < 20 and (least[doors.promised[:, 0]] > 0).all()


@settings(max_examples=20, deadline=None)
@given(st.floats(-1.0, 5.4), st.floats(-6.0, 3.0))
def test_a_mass_is_promised_if_a_brake_stops_it_and_not_if_none_does(x, v):
    """A brake of |u| <= 1 stops v > 0 after v²/2, and the first step is over before it begins. One of kappa and a
    constant swings for long after v < -4.
    """
    left = 5.5 - x - max(v, 0.0) ** 2 / 2
    _, promised = filtered(mass(5.0, 5.5), (x, v))
    if left < 0:
        assert not promised
    if left > 0.06 + 0.05 * abs(v):
        assert promised


def test_a_promise_ends_where_the_plant_is_pushed_and_that_is_counted():
    plant = mass(5.0, 5.5)
    controller = npred.controller(
        plant, npred.predictor(plant, "rk4", 31), None, dt=0.02, D_hat=0.1, actuator="history",
        safety=npred.SafetyFilter(), outlier_limit=None,
    )  # fmt: skip
    controller.step([4.0, 0.0])
    assert controller.status.promised and controller.status.withdrawn == 0
    saved = controller.state()
    controller.step([5.4, 3.0])
    assert not controller.status.promised and controller.status.withdrawn == 1 and controller.status.unkept
    twin = controller.fresh()
    twin.restore(saved)
    twin.step([4.0, 0.0])
    assert twin.status.promised and twin.status.withdrawn == 0


def following(along, pushed=lambda t, M: 0.0):
    class Led:
        states, inputs = ("x",), ("u",)
        box, input_bounds = {"x": (-1.0, 1.0)}, ((-3.0, 3.0),)
        f = lambda x, u, t, p, M: [u.u - x.x + pushed(t, M)]
        kappa = lambda x, t, p, M: [along(t, M) - 2.0 * (x.x - along(t, M))]
        reference = lambda t, p, M: [along(t, M)]
        safe = lambda x, t, p, M: [2.0 - x.x]

    return Plant("led", Led)


def test_a_loop_whose_reference_never_ends_is_promised_unless_the_plant_moves_with_time():
    assert filtered(following(lambda t, M: M.minimum(M.maximum(t, 0.0), 0.5)), [0.0])[1]
    assert filtered(following(lambda t, M: M.sin(t)), [0.0])[1]
    assert not filtered(following(lambda t, M: M.sin(t), lambda t, M: 0.1 * M.sin(t)), [0.0])[1]


def test_a_reference_that_comes_and_goes_beyond_a_limit_is_followed_up_to_it():
    run = loop(following(lambda t, M: 2.5 * M.sin(t)), [0.0], t_end=13.0)
    assert run.promised.all() and 0 < run.safety.min() < 0.05
    assert run.X[run.t > 9.0].min() < -1.9  # it goes on with the reference once that is back


def test_where_nothing_is_promised_or_a_step_is_long_that_is_said_before_the_first_command():
    plant = mass(5.0, 5.5)
    hidden = npred.SafetyFilter(margin=3.0)  # no rest of the law is so far from the wall, and no brake is strong enough
    bounds = np.array([[0.0, 1.0]])  # it can only push
    doubts = hidden.doubts(plant, 0.02, hidden.numbers(plant, 0.02, bounds)["safety"], bounds)
    assert "none is promised" in doubts[0]
    values = npred.SafetyFilter().numbers(plant, 0.02, np.array(plant.input_bounds))["safety"]
    assert not npred.SafetyFilter().doubts(plant, 0.02, values, np.array(plant.input_bounds))
    unsure = npred.SafetyFilter(delay=0.02)
    values = unsure.numbers(plant, 0.02, np.array(plant.input_bounds))["safety"]
    assert "nothing is promised" in unsure.doubts(plant, 0.02, values, np.array(plant.input_bounds))[0]
    survey = grid.Survey(12, 12, 0.05)
    assert "longest step took 0.05 s here, dt is 0.02 s" in survey.doubts(0.02, 1.0)[0]
    assert not survey.doubts(0.02, 60.0)


def test_the_metric_of_the_ball_is_that_of_lyapunovs_equation():
    """The doubling of resting.h, written here anew, against SciPy."""
    A = np.array([[1.0, 0.02], [-0.5, 0.8]])
    S, power = np.eye(2), A.copy()
    for _ in range(24):
        S, power = S + power.T @ S @ power, power @ power
    np.testing.assert_allclose(S, solve_discrete_lyapunov(A.T, np.eye(2)), rtol=1e-9)


def test_a_promise_made_by_a_noisy_estimate_uses_its_margin_and_is_not_given_up():
    """The estimate errs by less than the margin, but by more than the reserve of a plan."""
    plant, X0 = mass(5.0, 5.5), np.column_stack([np.linspace(-6.0, 0.0, 8), np.full(8, 3.0)])
    noise = [4e-3, 4e-3]
    runs = npred.simulate(
        plant, npred.predictor(plant, "rk4", 31), D=0.3, D_hat=0.3, X0=X0, t_end=9.0, dt=0.02, actuator="history",
        u0=[0.0], progress=False, safety=npred.SafetyFilter(margin=0.05), measurement=npred.Measurement(noise=noise),
        observer=npred.observers.EKF(plant, R=np.square(noise), outputs=plant.states),
    )  # fmt: skip
    assert runs.promised[:, 0].all() and runs.safety.min() > 0
    assert (~runs.promised).sum(axis=1).max() < 20  # of 451 control steps
