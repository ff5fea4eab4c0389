"""The controller alone: the loop's own steps, nothing kept but the estimate, and the example that shows it."""

import json
import pickle
import tracemalloc

import numpy as np
import pytest
from input_histories import at_nodes
from operator_samples import PLANT, SMALL, operator

import npred
from npred.base.errors import ConfigError, DivergedError
from npred.base.registry import RUNTIMES
from npred.networks import predictor
from npred.plants import BlackBox, Plant
from npred.prediction.methods import RK4

LAW = npred.DelayAdaptation(1000.0, 1.0, (0.1, 4.0))
X0 = [0.03, 30.0]


class Cube:
    """x' = x³ + u, whose open loop escapes in finite time."""

    states, inputs = ("x",), ("u",)
    f = lambda x, u, t, p, M: [x.x**3 + u.u]
    kappa = lambda x, t, p, M: [-(x.x**3) - x.x]
    V = lambda x, t, p, M: x.x**2


CUBE, ARM = Plant("cube", Cube), npred.plant("planar_arm2")


def loop(run, adaptation=LAW, bounds=None):
    """A simulated loop with all that each of its 200 steps saw."""
    return npred.simulate(PLANT, run, D=1.0, D_hat=2.0, X0=X0, t_end=2.0, dt=0.01, adaptation=adaptation,
                          input_bounds=bounds, samples=np.arange(200), u0=[0.0])  # fmt: skip


@pytest.mark.parametrize("runtime", ["numerical", *RUNTIMES.builtin])
def test_steps_equal_those_of_the_simulated_loop(runtime):
    run = RK4(PLANT, 21) if runtime == "numerical" else predictor(runtime, PLANT, operator(SMALL[0]), 21)
    wanted = loop(run)
    controller = npred.controller(PLANT, run, LAW, 0.01, D_hat=2.0, actuator="measured")
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
    controller = npred.controller(PLANT, run, None, 0.01, D_hat=2.0, input_bounds=bounds, actuator="measured")
    for k in range(200):
        np.testing.assert_array_equal(controller.step(wanted.samples.X[k], wanted.samples.u[k]), wanted.U[k])
    assert controller.D_hat == 2.0


def test_goes_on_from_a_saved_state():
    run, first, second = RK4(PLANT, 21), None, None
    first, second = (npred.controller(PLANT, run, LAW, 0.01, D_hat=2.0, actuator="measured") for _ in range(2))
    u = 0.01 * np.ones((21, 1))
    for _ in range(5):
        first.step(X0, u)
    saved = json.loads(json.dumps(first.state()))
    assert saved["step"] == 5 and saved["t0"] == 0.0
    second.restore(saved)
    np.testing.assert_array_equal(first.step(X0, u), second.step(X0, u))
    assert first.state() == second.state()


def test_what_hardware_does_not_measure_is_not_asked_for_by_default():
    default, told = (npred.controller(PLANT, RK4(PLANT, 21), None, 0.01, D_hat=1.0, **more) for more in
                     ({}, {"actuator": "history"}))  # fmt: skip
    assert default.actuator == "history" and np.array_equal(default.step([0.5, 20.0]), told.step([0.5, 20.0]))
    assert npred.Loop(plant=PLANT, predictor=None).actuator == "measured"  # of a simulation: the article's


def test_keeps_no_memory_in_the_steady_state():
    controller = npred.controller(
        PLANT, predictor("fused", PLANT, operator(SMALL[0]), 21), LAW, 0.01, D_hat=2.0, actuator="measured"
    )
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
    assert npred.controller(PLANT, RK4(PLANT, 21), LAW, 0.01, actuator="measured").D_hat == 2.05


def test_a_bad_measurement_leaves_it_as_it_was():
    controller = npred.controller(PLANT, RK4(PLANT, 21), LAW, 0.01, D_hat=2.0, actuator="measured")
    u = np.zeros((21, 1))
    controller.step(X0, u)
    before, P = controller.state(), controller.P
    for X in ([np.nan, 1.0], [np.inf, -np.inf]):
        with pytest.raises(
            DivergedError, match="expected finite X and u, got one that is not; keep the actuator at the last U"
        ):
            controller.step(X, u)
    before["step"] += 2  # the clock goes on
    with pytest.raises(ConfigError, match=r"step: expected X \(2,\) and u \(21, 1\), got \(3,\) and \(21, 1\)"):
        controller.step([1.0, 2.0, 3.0], u)
    assert controller.state() == before
    np.testing.assert_array_equal(controller.P, P)


def test_a_prediction_that_diverges_leaves_it_as_it_was():
    """x' = x³ + u from 3 escapes within the horizon: no NaN goes to the actuator, nor stays inside."""
    run, law = RK4(CUBE, 51), npred.DelayAdaptation(1.0, 1.0, (0.1, 2.0))
    controller, u = npred.controller(CUBE, run, law, 0.01, D_hat=1.0, actuator="measured"), np.zeros((51, 1))
    U = controller.step([0.3], u)
    before, kept, P = controller.state(), U.copy(), controller.P
    for X in ([3.0], [1e308]):
        with pytest.raises(
            DivergedError, match="the prediction from X and u is not finite; keep the actuator at the last U"
        ):
            controller.step(X, u)
    assert controller.state() == before | {"step": 3} and kept == U
    np.testing.assert_array_equal(controller.P, P)
    assert np.isfinite(controller.step([0.3], u)).all() and np.isfinite(controller.D_hat)


@pytest.mark.parametrize(
    ("X", "u", "message"),
    [
        (0.5, np.zeros((21, 1)), r"step: expected X \(2,\) and u \(21, 1\), got \(\) and \(21, 1\)"),
        ([0.03], np.zeros((21, 1)), r"got \(1,\) and \(21, 1\)"),
        (X0, 0.0, r"got \(2,\) and \(\)"),
        (X0, np.zeros((1, 1)), r"got \(2,\) and \(1, 1\)"),
        (["a", "b"], np.zeros((21, 1)), "X: expected an array of real numbers"),
        (np.ma.array(X0, mask=[0, 1]), np.zeros((21, 1)), "X: expected an array of real numbers, got a masked array"),
        (X0, np.ma.zeros((21, 1)), "u: expected an array of real numbers, got a masked array"),
        (np.array(X0) + 0j, np.zeros((21, 1)), "X: expected an array of real numbers, got an array of complex128"),
        (np.array([1, 2], "m8[s]"), np.zeros((21, 1)), r"X: .*got an array of timedelta64\[s\]"),
        (np.array(["2020", "2021"], "M8[s]"), np.zeros((21, 1)), r"X: .*got an array of datetime64\[s\]"),
        (X0, [[1.0], [1.0, 2.0]], "u: expected an array of real numbers"),
    ],
)
def test_a_measurement_of_another_shape_is_told(X, u, message):
    controller = npred.controller(PLANT, RK4(PLANT, 21), LAW, 0.01, D_hat=2.0, actuator="measured")
    with pytest.raises(ConfigError, match=message):
        controller.step(X, u)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dt": 0.0}, "dt: expected a control step above 0"),
        ({"D_hat": 9.0}, r"D_hat: expected within the bounds \[0.1, 4\] s, got 9"),
        ({"adaptation": None}, "give D_hat"),
        ({"adaptation": 3.0}, "adaptation: expected a DelayLaw"),
        ({"predictor": None}, "adaptation: expected a predictor, got None"),
        ({"predictor": None, "adaptation": None, "actuator": "measured"}, "predictor: expected one, got None"),
        ({"dt": "0.1"}, "dt: expected a real number, got '0.1'"),
        ({"D_hat": [1.0, 2.0]}, r"D_hat: expected a real number, got an array of shape \(2,\)"),
        ({"D_hat": np.inf, "adaptation": None}, "D_hat: expected a delay of at least 0, got inf"),
    ],
)
def test_mistakes_are_told(changes, message):
    with pytest.raises(ConfigError, match=message):
        npred.controller(**{"plant": PLANT, "predictor": RK4(PLANT, 21), "adaptation": LAW, "dt": 0.01} | changes)


def test_a_state_that_is_none_is_told():
    controller = npred.controller(PLANT, RK4(PLANT, 21), LAW, 0.01, actuator="measured")
    before = controller.state()
    for state in ({"D_hat": 1.0}, {"D_hat": 1.0, "step": 2.5}, {"D_hat": 1.0, "step": np.inf}, None):
        with pytest.raises(ConfigError, match="expected D_hat and step"):
            controller.restore(state)
    for change, message in [
        ({"step": 2**53 + 1}, r"step: expected a whole number of 0 to 2\^53, got a larger one"),
        ({"step": 10**5000}, "got a larger one"),
        ({"step": -1}, "got a negative one"),
        ({"t0": np.nan}, "t: expected a finite time"),
        ({"phi": np.inf}, "phi: expected a finite number or none"),
        ({"phi": "0.1"}, "phi: expected a real number"),
        ({"D_hat": np.nan}, "D_hat: expected within the bounds"),
        ({"D_hat": np.ma.masked}, "D_hat: expected a real number, got a masked array"),
    ]:
        with pytest.raises(ConfigError, match=message):
            controller.restore({"D_hat": 1.0, "step": 0} | change)
    assert controller.state() == before
    controller.restore({"D_hat": 1.0, "step": 2**53})
    assert controller.t == 2**53 * 0.01


class Hot:
    """x' = exp(x), which leaves the floats, in NumPy, which warns of it."""

    traced, states, inputs = False, ("x",), ("u",)
    f = lambda X, u, t, p: np.exp(X) + u
    kappa = lambda X, t, p: -np.exp(X) - X
    V = lambda X, t, p: X[:, 0] ** 2


@pytest.mark.filterwarnings("error")
def test_a_prediction_in_python_that_diverges_is_an_error_and_no_warning():
    plant = BlackBox("hot", Hot)
    controller = npred.controller(
        plant, RK4(plant, 11), npred.DelayAdaptation(1.0, 1.0, (0.1, 2.0)), 0.01, actuator="measured"
    )
    with pytest.raises(DivergedError, match="is not finite"):
        controller.step([900.0], np.zeros((11, 1)))


def test_the_prediction_of_the_last_step_can_be_read():
    run, u = RK4(PLANT, 21), 0.01 * np.ones((21, 1))
    controller = npred.controller(PLANT, run, LAW, 0.01, D_hat=2.0, actuator="measured")
    assert controller.P.shape == (21, 2) and np.isnan(controller.P).all()
    U, expected = controller.step(X0, u), np.zeros((21, 2, 1))
    run.lanes().exactly(np.array(X0, dtype=float)[:, None], u[:, :, None], np.full(1, 2.0), 0.0, PLANT.p, expected)
    np.testing.assert_array_equal(controller.P, expected[:, :, 0])
    np.testing.assert_allclose(controller.P, run(X0, u, 2.0), rtol=1e-14)
    np.testing.assert_allclose(U, PLANT.kappa(controller.P[-1]), rtol=1e-12)
    controller.P[:] = 0.0  # a copy
    np.testing.assert_array_equal(controller.P, expected[:, :, 0])


def test_estimate_and_time_can_be_set():
    controller = npred.controller(PLANT, RK4(PLANT, 21), LAW, 0.01, D_hat=2.0, actuator="measured")
    controller.D_hat = 1.25
    assert controller.D_hat == 1.25 and controller.t == 0.0
    with pytest.raises(ConfigError, match=r"D_hat: expected within the bounds \[0.1, 4\] s, got 5"):
        controller.D_hat = 5.0
    controller.step(X0, np.zeros((21, 1)))
    assert controller.t == 0.01 and controller.state()["phi"] is not None
    controller.D_hat = 1.5
    expected = {"D_hat": 1.5, "phi": None, "step": 1, "t0": 0.0, "parameters": dict(PLANT.parameters)}
    assert controller.state() == expected | {"plant": controller.state()["plant"]}  # no step back across the jump
    controller.t = 7.3
    assert controller.t == 7.3 and controller.state()["step"] == 0
    with pytest.raises(ConfigError, match="t: expected a finite time, got inf"):
        controller.t = np.inf
    assert controller.t == 7.3


def test_a_time_that_is_set_is_the_laws():
    """A law of time at t = 0.5, set and reached by steps, gives one U; so does a controller restored there."""
    run, u, X = RK4(ARM, 11), np.zeros((11, ARM.m)), np.full(ARM.n, 0.1)
    walked, placed, restored = (
        npred.controller(ARM, run, None, 0.125, D_hat=0.2, actuator="measured") for _ in range(3)
    )
    for _ in range(4):
        walked.step(X, u)
    placed.t = 0.5
    restored.restore({"D_hat": 0.2, "step": 4})
    reached = walked.step(X, u).copy()
    assert reached != pytest.approx(npred.controller(ARM, run, None, 0.125, D_hat=0.2, actuator="measured").step(X, u))
    np.testing.assert_array_equal(placed.step(X, u), reached)
    np.testing.assert_array_equal(restored.step(X, u), reached)


@pytest.mark.parametrize("runtime", ["numerical", *RUNTIMES.builtin])
def test_a_pickled_controller_goes_on_where_it_stood(runtime):
    run, u = RK4(PLANT, 21), 0.01 * np.ones((21, 1))
    run = run if runtime == "numerical" else predictor(runtime, PLANT, operator(SMALL[0]), 21)
    controller = npred.controller(PLANT, run, LAW, 0.01, D_hat=2.0, input_bounds=(-0.01, 0.01), actuator="measured")
    controller.t = 3.0
    controller.step(X0, u)
    copy = pickle.loads(pickle.dumps(controller))
    assert copy.state() == controller.state()
    np.testing.assert_array_equal(copy.P, controller.P)
    np.testing.assert_array_equal(copy.step(X0, u), controller.step(X0, u))
    assert copy.state() == controller.state()


def test_says_what_it_is():
    controller = npred.controller(PLANT, RK4(PLANT, 21), LAW, 0.01, D_hat=2.0, actuator="measured")
    assert repr(controller) == (
        "<Controller of plant activator_repressor with <RK4 'rk4' of plant activator_repressor, nx = 21>, "
        "dt = 0.01 s, t = 0 s, D_hat = 2 s by DelayAdaptation>"
    )


LAWS = (None, LAW, npred.DelayObserver(bounds=(0.1, 4.0)), npred.L1Adaptation(0.1, bounds=(0.1, 4.0)))


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_with_its_own_commands_it_needs_x_alone_and_goes_on_from_a_saved_state(law):
    """The steps of npred.simulate, pickled once and restored from JSON once on the way."""
    run = npred.predictor(PLANT, "rk4", nx=21)
    loop = npred.simulate(PLANT, run, D=1.2, D_hat=1.4, X0=X0, t_end=8.0, dt=0.01, adaptation=law, actuator="history")
    alone = npred.controller(PLANT, run, law, 0.01, D_hat=1.4, actuator="history")
    for k in range(800):
        if k == 300:
            alone = pickle.loads(pickle.dumps(alone))
        if k == 500:
            saved, alone = json.loads(json.dumps(alone.state())), npred.controller(
                PLANT, run, law, 0.01, D_hat=1.0, actuator="history"
            )  # fmt: skip
            alone.restore(saved)
        np.testing.assert_allclose(alone.step(loop.X[k]), loop.U[k], rtol=1e-9, atol=1e-12)
    assert alone.D_hat == pytest.approx(loop.D_hat[-1], rel=1e-6)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_in_a_loop_of_another_plant_it_is_what_knows_the_model_alone(law):
    run = npred.predictor(PLANT, "rk4", nx=21)
    start = {"D": 1.2, "D_hat": 1.4, "X0": X0, "t_end": 3.0, "dt": 0.01, "adaptation": law, "actuator": "history"}
    loop = npred.simulate(PLANT, run, truth=npred.plant(PLANT.name, K1=1.05 * PLANT.parameters["K1"]), **start)
    alone = npred.controller(PLANT, run, law, 0.01, D_hat=1.4, actuator="history")
    for k in range(300):
        np.testing.assert_allclose(alone.step(loop.X[k]), loop.U[k], rtol=1e-9, atol=1e-12)


def test_a_resumed_controller_takes_the_same_steps_to_the_bit():
    run, law = npred.predictor(PLANT, "rk4", nx=21), LAWS[2]
    straight = npred.controller(PLANT, run, law, 0.01, actuator="history")
    states = np.random.default_rng(0).uniform([0.05, 4.0], [0.1, 6.0], (900, 2))
    for X in states[:500]:
        straight.step(X)
    resumed = npred.controller(PLANT, run, law, 0.01, actuator="history")
    resumed.restore(json.loads(json.dumps(straight.state())))
    for X in states[500:]:
        assert np.array_equal(straight.step(X), resumed.step(X)) and straight.D_hat == resumed.D_hat


def test_a_step_that_fails_books_the_command_that_is_held_and_leaves_the_observers():
    run = npred.predictor(CUBE, "rk4", nx=21)
    alone = npred.controller(CUBE, run, npred.DelayObserver(bounds=(0.1, 1.0)), 0.01, actuator="history")
    for _ in range(5):
        U = alone.step([0.1])
    for step, wrong in ((6, [np.nan]), (7, [1e200])):
        before, k = alone.state(), alone.state()["commands"]["k"]
        with pytest.raises(DivergedError, match=rf"pass the next sample: u = {U[0]:.4g} is assumed sent"):
            alone.step(wrong)
        after = alone.state()
        assert after["step"] == step and after["commands"]["k"] == k + 1
        assert after["commands"]["held"][k % len(before["commands"]["held"])] == U
        assert all(after[part] == before[part] for part in ("D_hat", "phi", "observer", "t0"))


def test_what_the_actuator_got_instead_is_booked():
    told, sent = (npred.controller(CUBE, RK4(CUBE, 21), None, 0.01, D_hat=0.2, actuator="history") for _ in "ab")
    for X in (0.1, 0.2, 0.3):
        told.step([X])
        U = sent.step([X]).copy()
    with pytest.raises(DivergedError):
        told.step([np.nan])
    with pytest.raises(DivergedError):
        sent.step([np.nan])
    np.testing.assert_array_equal(told.step([0.3], applied=U), sent.step([0.3]))
    assert told.step([0.3], applied=[5.0]) != sent.step([0.3])
    commands = told.state()["commands"]
    assert commands["held"][(commands["k"] - 2) % len(commands["held"])] == [5.0]
    for wrong in ([1.0, 2.0], [np.nan]):
        with pytest.raises(ConfigError, match="applied: expected 1 finite numbers, one per input"):
            told.step([0.3], applied=wrong)
    with pytest.raises(ConfigError, match="applied: expected a controller that reads u from its commands"):
        npred.controller(PLANT, RK4(PLANT, 21), LAW, 0.01, actuator="measured").step(
            X0, np.zeros((21, 1)), applied=[0.0]
        )


def test_it_is_given_what_is_measured_and_nothing_else():
    run = npred.predictor(PLANT, "rk4", nx=21)
    with pytest.raises(ConfigError, match="expected X alone, for the actuator is 'history', got u too; give"):
        npred.controller(PLANT, run, LAW, 0.01, actuator="history").step(X0, np.zeros((21, 1)))
    with pytest.raises(ConfigError, match="expected X and u, for the actuator is 'measured', got X alone"):
        npred.controller(PLANT, run, LAW, 0.01, actuator="measured").step(X0)
    with pytest.raises(ConfigError, match="actuator: expected one of measured, history"):
        npred.controller(PLANT, run, LAW, 0.01, actuator="other")
    with pytest.raises(ConfigError, match="expected the commands of such a controller, got others"):
        npred.controller(PLANT, run, LAW, 0.01, actuator="history").restore({"D_hat": 1.0, "step": 0, "commands": {}})


def test_commands_reach_back_to_a_delay_that_the_plant_declares():
    plant = npred.plant("unicycle_time_delay")
    run, X = RK4(plant, 41), np.array([0.3, -0.2, 0.2])
    wanted = npred.simulate(plant, run, X0=X, t_end=3.0, dt=0.01, actuator="history", samples=np.arange(300))
    controller = npred.controller(plant, run, None, 0.01, actuator="history")
    assert controller.memory.reach == pytest.approx(5.0)
    for k in range(300):
        np.testing.assert_allclose(controller.step(wanted.samples.X[k]), wanted.U[k], rtol=1e-9, atol=1e-12)
    short = npred.controller(plant, run, None, 0.01, actuator="history", history_length=0.5)
    with pytest.raises(DivergedError, match=r"at most 0\.51 s, as far as the history reaches, got 1 s; raise"):
        short.step(X)
    assert short.t == 0.01
    with pytest.raises(ConfigError, match=r"history_length: expected at least the largest delay, 4 s, got 1\.0"):
        npred.controller(PLANT, RK4(PLANT, 21), LAW, 0.01, actuator="history", history_length=1.0)


@pytest.mark.parametrize("u0", ["law", [[0.3], [-0.2], [0.1]], lambda t: [np.sin(t)]], ids=["law", "table", "function"])
def test_commands_before_the_first_step_are_those_of_the_simulated_loop(u0):
    plant = npred.plant("scalar")
    predictor = RK4(plant, 21)
    run = npred.simulate(plant, predictor, D=0.5, D_hat=0.5, X0=[0.8], t_end=1.5, dt=0.05, u0=u0, actuator="history")
    controller = npred.controller(plant, predictor, None, 0.05, D_hat=0.5, actuator="history", u0=u0)
    for k in range(30):
        np.testing.assert_allclose(controller.step(run.X[k]), run.U[k], rtol=0, atol=1e-14)
        if u0 == "law":
            controller = pickle.loads(pickle.dumps(controller))


def test_a_first_step_that_fails_leaves_the_law_to_the_next():
    plant = npred.plant("scalar")
    one, other = (
        npred.controller(plant, RK4(plant, 5), None, 0.05, D_hat=0.5, actuator="history", u0="law") for _ in "ab"
    )
    with pytest.raises(DivergedError):
        one.step([np.inf])
    assert one.step([0.4]) == other.step([0.4])
    with pytest.raises(ConfigError, match="u0: expected a constant command, got that of the first X"):
        _ = one.u0


UNICYCLE = npred.plant("unicycle")


def around(controller, samples, faults=None):
    """Commands (steps, m) for samples (steps, n), of which `faults`, {step: sample}, are wrong."""
    return np.array([controller.step((faults or {}).get(k, X)).copy() for k, X in enumerate(samples)])


def pose_loop(steps):
    start = [0.5, 0.5, 0.5]
    run = npred.simulate(UNICYCLE, RK4(UNICYCLE, 21), D=0.6, D_hat=0.6, X0=start, t_end=steps * 0.01, dt=0.01)
    return run.X[:steps], run.U[:steps]


def turning(**options):
    return npred.controller(UNICYCLE, RK4(UNICYCLE, 21), None, 0.01, D_hat=0.6, actuator="history", **options)


@pytest.mark.parametrize("size", [2.0, 5.0, 12.0, -12.0])
def test_a_sample_that_the_plant_cannot_have_made_is_predicted_over(size):
    X, U = pose_loop(60)
    controller = turning()
    sent = around(controller, X, {20: X[20] + size})
    np.testing.assert_allclose(sent, U, atol=1e-6)
    assert controller.status.missed == 0
    trusting = turning(outlier_limit=None)
    assert np.abs(around(trusting, X[:21], {20: X[20] + size})[20] - U[20]).max() > 1


class Still:
    """Nothing moves it, so that what it was is what is expected."""

    states, inputs, box = ("x", "y"), ("u",), {"x": (-1.0, 1.0), "y": (-2.0, 4.0)}
    f = lambda x, u, t, p, M: [u.u, 0 * x.y]
    kappa = lambda x, t, p, M: [0 * x.x]


@pytest.mark.parametrize("gate", [1.0, 0.5])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("was", [(0.1, 0.2), (4.0, 0.2), (0.1, 9.0)])
def test_the_gate_is_a_share_of_half_the_box_or_of_the_smaller_state_where_that_is_larger(was, sign, gate):
    """From w outwards a sample may be w + gate w, and inwards w - d, where d = gate (w - d)."""
    plant, missed = Plant("still", Still), []
    outwards, inwards = ([max(h, w / by) for h, w in zip((1.0, 3.0), was, strict=True)] for by in (1.0, 1.0 + gate))
    for way, state, part in ((way, state, part) for way in (1, -1) for state in (0, 1) for part in (0.99, 1.01)):
        reach = outwards if way == sign else inwards
        controller = npred.controller(
            plant, RK4(plant, 5), None, 0.1, D_hat=0.5, actuator="history", outlier_limit=gate
        )
        controller.step(sign * np.array(was))
        controller.step(sign * np.array(was) + way * part * gate * reach[state] * np.eye(2)[state])
        missed.append(controller.status.missed)
    assert missed == [0, 1] * 4


class Waves(Still):
    """The first state follows a wave and an input of half the other one's delay."""

    inputs, delays = ("u", "v"), (0.5, 1.0)
    f = lambda x, u, t, p, M: [u.u + 3 * M.cos(9 * t), u.v]
    kappa = lambda x, t, p, M: [M.sin(2 * t), M.cos(3 * t)]


def test_what_is_expected_is_the_state_a_step_later():
    """By the wave from now on, and by the commands of 2.15 and 4.3 steps ago; after a refused sample, from what was."""
    plant, dt, refused = Plant("waves", Waves), 0.1, (7, 8)
    controller = npred.controller(plant, RK4(plant, 5), None, dt, D_hat=0.43, actuator="history", outlier_limit=9.0)
    sent, X = [np.zeros(2)] * 5, np.full(2, np.nan)  # from five steps before the first on
    for k in range(20):
        expected = X
        if k in refused:
            with pytest.raises(DivergedError):
                controller.step([np.nan, 0.0])
            sent.append(sent[-1])
        else:
            X = np.array([np.cos(k), 0.3])
            sent.append(controller.step(X).copy())
        np.testing.assert_allclose(controller.memory.signals.expected[:, 0], expected, rtol=0, atol=1e-4)
        u = 0.15 * sent[k + 2][0] + 0.85 * sent[k + 3][0]
        v = 0.3 * sent[k][1] + 0.7 * sent[k + 1][1]
        X = X + np.array([dt * u + (np.sin(9 * (k + 1) * dt) - np.sin(9 * k * dt)) / 3, dt * v])


class Stretched(Still):
    """x' = u, whose delay is the state in units of 0.3 s."""

    states, box = ("x",), {"x": (-1.0, 3.0)}
    f = lambda x, u, t, p, M: [u.u]
    kappa = lambda x, t, p, M: [M.sin(2 * t)]
    delay = lambda x, t, p, M: 0.3 * x.x


@pytest.mark.parametrize(("jump", "refused"), [(1.1, 8), (9.7, 9), (-1.6, 8)])
def test_over_refused_steps_what_is_expected_follows_the_delay_that_is_expected(jump, refused):
    """By the integral of the commands. A delay that cannot be, below 0 or beyond what is kept, counts as none."""
    plant, dt, kept, past = Plant("stretched", Stretched), 0.1, 1.5, 40
    controller = npred.controller(
        plant, RK4(plant, 5), None, dt, actuator="history", outlier_limit=9.0, history_length=kept
    )
    samples = [*(1.0 + 0.1 * np.cos(range(12))), jump, *[np.nan] * 8]
    sent, X, held = [0.0] * past, np.nan, 0
    for k, sample in enumerate(samples):
        expected = X
        try:
            sent.append(controller.step([sample])[0])
        except DivergedError:
            sent.append(sent[-1])
            held += 1
        assert controller.memory.signals.expected[0, 0] == pytest.approx(expected, rel=1e-9, nan_ok=True)
        X = X if np.isnan(sample) else sample
        late = 0.3 * X / dt if 0 <= 0.3 * X <= kept else 0.0
        begin, end = np.interp(past + k + np.array([0, 1]) - late, range(past + k + 2), np.cumsum([0.0, *sent]))
        X += dt * (end - begin)
    assert held == refused


def test_a_delay_is_refused_from_where_its_commands_are_overwritten_on():
    """A tenth of a control step to either side of the longest that is kept."""
    plant, dt = Plant("stretched", Stretched), 0.1
    for beyond, refused in ((-0.1, False), (0.1, True)):
        controller = npred.controller(
            plant, RK4(plant, 5), None, dt, actuator="history", outlier_limit=None, history_length=1.5
        )
        for k in range(60):
            controller.step([1.0], t=k * dt)
        longest = (controller.memory.longest_D_hat + beyond * dt) / 0.3
        assert controller.memory.longest_D_hat >= 1.5
        try:
            controller.step([longest], t=60 * dt)
            assert not refused
        except DivergedError:
            assert refused


class Bounded(Cube):
    """Its V is not finite where X is huge, and U is."""

    input_bounds = ((-1.0, 1.0),)
    f = lambda x, u, t, p, M: [u.u - x.x]


def test_an_estimate_that_would_not_be_finite_refuses_the_step():
    plant = Plant("bounded", Bounded)
    controller = npred.controller(plant, RK4(plant, 21), LAW, 0.01, D_hat=1.0, actuator="history", outlier_limit=None)
    controller.step([0.5])
    before = controller.D_hat
    with pytest.raises(DivergedError):
        controller.step([1e100])
    assert controller.D_hat == before


def estimates(wrong):
    """D_hat of the observers in a loop of x' = x / 2 + u, D = 1 s, whose sample k is 6 off where `wrong` says so."""
    plant, law = npred.plant("scalar"), npred.DelayObserver(bounds=(0.1, 4.0))
    controller = npred.controller(plant, RK4(plant, 21), law, 0.01, D_hat=0.4, actuator="history")
    x, late, found = 0.5, [0.0] * 100, []
    for far in wrong:
        late.append(controller.step([x + 6.0 * far])[0])
        x, found = (x + 2 * late[-101]) * np.exp(0.005) - 2 * late[-101], [*found, controller.D_hat]
    return np.array(found)


@pytest.mark.parametrize("row", [1, 10])
def test_observers_of_the_delay_go_on_where_samples_are_not_believed(row):
    """One in ten, in rows of 1 or 10. While the observers stood still there, the estimate was 0.01 s off."""
    starts = np.random.default_rng(0).random(1000) < 0.1 / row
    starts[:5] = False
    wrong = np.convolve(starts, np.ones(row))[:1000] > 0
    np.testing.assert_allclose(estimates(wrong)[500:], estimates(np.zeros(1000))[500:], atol=0.003)


def test_observers_that_have_seen_no_sample_start_at_the_first():
    plant, law = npred.plant("scalar"), npred.DelayObserver(bounds=(0.1, 4.0))
    known, found = (
        npred.controller(plant, RK4(plant, 21), one, 0.01, D_hat=0.4, actuator="history") for one in (None, law)
    )
    known.step([0.5])
    found.restore(known.state())
    found.step([9.0])
    assert found.status.missed == 0 and np.isfinite(found.memory.signals.observer).all()


def test_a_state_that_jumps_is_believed_after_a_delay():
    for steps, wait in ((20, 20), (80, 60)):  # what was believed for less than D_hat / dt gives way as soon
        controller, missed = turning(), []
        around(controller, pose_loop(steps)[0])
        for _ in range(100):
            controller.step([3.0, 0.0, 0.0])
            missed.append(controller.status.missed)
        assert missed[: wait + 1] == [*range(1, wait + 1), 0] and missed[-1] == 0


def test_without_a_gate_wrong_samples_do_not_lock_it():
    """One sample 2 to 12 off, then good ones: once its command was huge, and each later step was refused."""
    X, _ = pose_loop(140)
    low, high = turning(outlier_limit=None).settings.input_bounds.T
    for size in (2.0, 5.0, 9.0, 12.0, -9.0):
        controller, refused = turning(outlier_limit=None), []
        for k in range(140):
            try:
                sent = controller.step(X[k] + size * (k == 20))
                assert (low <= sent).all() and (sent <= high).all()
            except DivergedError:
                refused.append(k)
        assert not refused or refused[-1] <= 20 + 62  # the wrong command has left its history


def test_a_gated_controller_goes_on_where_it_stood():
    X, _ = pose_loop(40)
    straight, saved = turning(), turning()
    wrong = {19: X[19] + 9, 20: X[20] + 9}
    around(straight, X[:20], wrong)
    around(saved, X[:20], wrong)
    assert straight.status.missed == 1
    resumed = turning()
    resumed.restore(json.loads(json.dumps(saved.state())))
    copy = pickle.loads(pickle.dumps(saved))
    for k in range(20, 40):
        U = straight.step(wrong.get(k, X[k]))
        np.testing.assert_array_equal(resumed.step(wrong.get(k, X[k])), U)
        np.testing.assert_array_equal(copy.step(wrong.get(k, X[k])), U)
    for wrong in ({"clock": [0.0]}, {"clock": ["a"] * 3}, {"missed": -1}, {"missed": 0.5}):
        with pytest.raises(ConfigError, match="expected the commands of such a controller"):
            resumed.restore(saved.state() | wrong)
    straight.t = 3.0
    assert np.isnan(straight.memory.clock.now).all()  # it expects nothing, as at a first step


@pytest.mark.parametrize("gate", [0.0, -1.0, np.inf, np.nan])
def test_a_gate_that_is_none_is_told(gate):
    with pytest.raises(ConfigError, match="outlier_limit: expected a number above 0, or None for no limit"):
        turning(outlier_limit=gate)


def test_without_a_box_every_sample_is_believed():
    controller = npred.controller(CUBE, RK4(CUBE, 21), None, 0.01, D_hat=0.2, actuator="history")
    controller.step([0.1])
    with pytest.raises(DivergedError):
        controller.step([1e200])
    assert controller.status.missed == 0 and np.isinf(controller.settings.input_bounds).all()
