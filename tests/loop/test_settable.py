"""Set-points that are stepped while a loop runs: their rest, the controller's memory of them, and what they disturb."""

import ctypes
import json
import pickle
import subprocess

import harness
import numpy as np
import pytest
import setpoints
from c_controllers import FLAGS, InC, library, needs_gcc
from fmus import InFmu, exported, needs_cc
from hypothesis import given
from hypothesis import strategies as st
from operator_samples import PLANT, SMALL, operator
from plants import Lifted
from scipy.optimize import root

import npred
from npred import plants
from npred.base.errors import ConfigError
from npred.exports import c_controller
from npred.lab.config import Evaluate
from npred.lab.config.conditions import Condition
from npred.lab.stages.evaluate.behaviour import behaviour
from npred.loop import metrics, settable
from npred.networks.fused import Fused

CASES = setpoints.cases()
PENDULUM = CASES["pendulum"]
PLANTS = pytest.mark.parametrize("name", CASES)


class Limited(Lifted):
    """The same with limits that its set-points come near to."""

    def safe(x, t, p, M):
        return [1.1 - x.angle, 1.1 + x.angle]


class Loaded:
    """A cart whose f reads the load, and whose kappa reads the set-point."""

    states, inputs = ("x", "v"), ("u",)
    parameters = {"load": 0.5, "aim": 0.0, "unused": 1.0}
    box = {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}

    def f(x, u, t, p, M):
        return [x.v, u.u - p.load]

    def kappa(x, t, p, M):
        return [p.load - 4 * (x.x - p.aim) - 3 * x.v]


@needs_gcc
@needs_cc
@PLANTS
def test_python_c_and_fmu_settle_at_each_set_point_with_one_u(tmp_path, name):
    case = CASES[name]
    one = setpoints.controller(case)
    run = setpoints.stepped(case, one, [harness.InC(one, tmp_path), harness.InFmu(one, tmp_path)], 4)
    assert (run.settled, run.of, run.samples_refused, run.refused) == (4, 4, 0, 4)
    assert run.share <= 1.0 and run.apart <= 1e-12


def parts(kind):
    plant = PENDULUM.plant
    coarse = npred.guarded(npred.predictor(plant, "euler", 7), 1e-3, exact=npred.predictor(plant, "rk4", 31))
    return {
        "plain": {}, "watchdog": {"watchdog": npred.Watchdog(after=0.5)}, "guard": {"predictor": coarse},
        "EKF": {"observer": npred.observers.EKF(plant, outputs=("angle",))},
    }[kind]  # fmt: skip


@pytest.mark.parametrize("kind", ["plain", "watchdog", "guard", "EKF"])
def test_no_sample_is_refused_over_fifty_steps_some_across_the_whole_range(kind):
    """Some come before the loop has settled."""
    one = setpoints.controller(PENDULUM, **parts(kind))
    output = (lambda X: X[:1]) if kind == "EKF" else (lambda X: X)
    run = setpoints.stepped(PENDULUM._replace(hold=2.0), one, [], 50, output=output)
    assert (run.samples_refused, one.status.missed, one.status.renewed) == (0, 0, 0)
    assert run.share <= 1.0 and one.D_hat == pytest.approx(PENDULUM.D, abs=0.01)


def test_nor_with_a_safety_filter_which_keeps_its_limits():
    case = PENDULUM._replace(plant=npred.plant(Limited, kappa="lqr"), hold=2.0)
    one = setpoints.controller(case, safety=npred.SafetyFilter(), D_hat=case.D)
    run = setpoints.stepped(case, one, [], 50)
    assert (run.samples_refused, one.status.missed) == (0, 0)


def test_an_observer_of_the_offset_gives_integral_action():
    """A constant torque that nobody knows: without the observer no set-point is reached."""
    observer = npred.observers.EKF(PENDULUM.plant, outputs=("angle",), offset=True)
    ends = []
    for seen, output in ((observer, lambda X: X[:1]), (None, lambda X: X)):
        one = setpoints.controller(PENDULUM, observer=seen)
        ends.append(setpoints.stepped(PENDULUM, one, [], 6, push=0.5, output=output).settled)
    assert ends == [6, 0]


@pytest.mark.parametrize("aim", [-1.1, 0.2, 1.0])
def test_the_rest_of_a_pendulum_is_that_of_scipy(aim):
    one = setpoints.controller(PENDULUM)
    one.set(aim=aim)
    equations = lambda z: [z[1], z[2] - 9.81 * np.sin(z[0]), z[0] - aim]  # written down once more
    rest = [one.state()["parameters"][f"rest_{name}"] for name in ("angle", "rate", "torque")]
    np.testing.assert_allclose(rest, root(equations, [0.0, 0.0, 0.0], tol=1e-13).x, atol=1e-10)


@pytest.mark.parametrize("aim", [1.6, 2.3])
def test_the_rest_of_a_reactor_is_that_of_scipy_and_of_its_plant(aim):
    one = setpoints.controller(CASES["reactor"])
    one.set(aim=aim)

    def equations(z):
        Z, S, u = z
        growth = 3.5 * S / (1 + S + S * S)
        return [growth - 0.1 - u, u * (16 / 3 - S) - growth * Z, S - aim]

    expected = root(equations, [3.0, 2.0, 0.9], tol=1e-13).x
    rest = [one.state()["parameters"][f"rest_{name}"] for name in ("Z", "S", "u")]
    np.testing.assert_allclose(rest, expected, rtol=1e-10)
    other = plants.varied(CASES["reactor"].plant, (("aim", aim),))
    np.testing.assert_allclose([*other.equilibrium, *other.u_equilibrium], expected, rtol=1e-9)
    np.testing.assert_allclose(other.kappa(other.target(0.0)), expected[2:], rtol=1e-9)


@needs_gcc
@needs_cc
def test_a_set_point_without_a_rest_is_refused_and_the_old_one_stays(tmp_path):
    """At 1.5 rad the torque is beyond its bounds; NaN is no angle."""
    one = setpoints.controller(PENDULUM)
    in_c = InC(library(one, tmp_path), one.plant)
    path, written = exported(one, tmp_path)
    in_fmu = InFmu(path, tmp_path / "fmu", written, one.dt)
    one.set(aim=0.6)
    in_c.library.npred_set_aim.argtypes = [ctypes.c_void_p, ctypes.c_double]
    assert in_c.library.npred_set_aim(in_c.memory, 0.6) == 0
    in_fmu.set("parameter.aim", 0.6)
    before = one.state()
    for aim, said in ((1.5, "got torque = 9.785"), (np.nan, "expected finite numbers, got nan")):
        with pytest.raises(ConfigError, match=said):
            one.set(aim=aim)
        assert in_c.library.npred_set_aim(in_c.memory, aim) == 5
        with pytest.raises(Exception, match="status 2"):
            in_fmu.set("parameter.aim", aim)
    assert one.state() == before and in_fmu.get("parameter.aim") == 0.6 and len(in_fmu.messages) == 2
    X = [0.5, 0.1]
    U = one.step(X).copy()
    assert U == in_c.step(X) == in_fmu.step(X)
    saved = in_c.state()
    in_c.library.npred_init(in_c.memory)
    assert in_c.restore(saved) == 0 and one.step(X) == in_c.step(X)
    in_fmu.close()


def test_a_rest_that_no_search_finds_is_refused():
    """Newton's steps end at the foot of a curve that does not reach 0."""

    class Parabola:
        states, inputs, parameters = ("x",), ("u",), {"aim": 1.0}

        def f(x, u, t, p, M):
            return [u.u - x.x]

        def setpoint(x, t, p, M):
            return [x.x**2 + 1 - p.aim - 1]

    plant = npred.plant(Parabola, kappa="lqr")
    one = npred.controller(plant, npred.predictor(plant, "rk4", 11), None, 0.01, D_hat=0.1, actuator="history")
    with pytest.raises(ConfigError, match=r"set: expected a rest .* for aim = -0\.5, found none; the old set-point"):
        one.set(aim=-0.5)
    assert one.parameters == {"aim": 1.0}
    with pytest.raises(ConfigError, match=r"setpoint \(.*\) expected a rest of the set-point, found none near"):
        npred.plant(Parabola, kappa="lqr", aim=-0.5)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"aims": 1.0}, "set: expected a parameter, aim, got 'aims'; did you mean aim"),
        ({"aim": np.inf}, "set: aim: expected finite numbers"),
        ({"aim": "high"}, "set: aim: expected a real number"),
        ({"pull": 1.6}, "got 'pull': the law was designed with it"),
    ],
)
def test_what_cannot_be_set_is_one_line_and_changes_nothing(values, said):
    one = setpoints.controller(PENDULUM)
    before = one.state()
    with pytest.raises(ConfigError) as caught:
        one.set(**{"aim": 0.5} | values)
    assert said in str(caught.value) and "\n" not in str(caught.value) and one.state() == before


def test_a_network_keeps_what_it_was_trained_with_and_a_model_does_not():
    fused = Fused(PLANT, operator(SMALL[0]).double(), 21, precision=np.float64)
    one = npred.controller(PLANT, fused, None, 0.01, D_hat=1.0)
    assert one.fixed == dict.fromkeys(sorted(one.fixed), "the network was trained with it")
    assert {"K1", "Ka"} <= one.fixed.keys() and not {"x1_set", "x2_set"} & one.fixed.keys()
    cart = npred.plant(Loaded)
    one = npred.controller(cart, npred.predictor(cart, "rk4", 11), None, 0.01, D_hat=0.3, u0=[0.0])
    assert one.fixed == {"unused": "nothing reads it"}
    one.set(load=2.0, aim=0.3)
    other = npred.plant(Loaded, load=2.0, aim=0.3)
    fresh = npred.controller(other, npred.predictor(other, "rk4", 11), None, 0.01, D_hat=0.3, u0=[0.0])
    assert one.step([0.1, 0.2]) == fresh.step([0.1, 0.2]) and one.step([0.1, 0.2]) == fresh.step([0.1, 0.2])


def test_parameters_of_a_plant_are_read_only():
    plant = PENDULUM.plant
    for change in (lambda p: p.update(aim=2.0), lambda p: p.__setitem__("aim", 2.0), lambda p: p.pop("aim")):
        with pytest.raises(ConfigError, match=r"write npred.plant\(…, aim=2\), or controller.set\(aim=2\)"):
            change(plant.parameters)
    assert pickle.loads(pickle.dumps(plant.parameters)) == {"pull": 9.81, "aim": 0.3}


def test_what_was_set_is_part_of_the_state():
    one = setpoints.controller(PENDULUM)
    one.set(aim=-0.7)
    one.step([0.1, 0.0])
    others = [pickle.loads(pickle.dumps(one)), setpoints.controller(PENDULUM)]
    others[1].restore(json.loads(json.dumps(one.state())))
    for other in (*others, one.fresh()):
        assert other.parameters["aim"] == -0.7
    assert [*one.step([0.2, 0.1])] == [*others[0].step([0.2, 0.1])] == [*others[1].step([0.2, 0.1])]
    for wrong in ({"aim": 0.1}, one.state()["parameters"] | {"pull": 1.0}, one.state()["parameters"] | {"aim": np.nan}):
        with pytest.raises(ConfigError, match="state: expected"):
            one.restore(one.state() | {"parameters": wrong})
    assert one.parameters == {"pull": 9.81, "aim": -0.7}


def test_two_set_points_at_once_need_no_rest_between():
    """Of the tanks the second level needs the first one's flow."""
    tanks = CASES["two tanks"]
    one = setpoints.controller(tanks)
    one.set(first=5.0, second=5.5)
    one.set(first=0.6, second=0.7)
    with pytest.raises(ConfigError, match=r"for first = 5, got q2 = -0.6997"):
        one.set(first=5.0)


@needs_gcc
@pytest.mark.parametrize(
    "change",
    [
        ("p[the_places[i]] = values[i];", "p[the_places[i]] = (npred_real)1.001 * values[i];"),
        ("the_settle(the_shape, self->saved.p, p, the_units, rest, arrived, kept, NULL);", "arrived[0] = kept[0] = 1;"),
        ("    npred_set(NPRED_NUMBERS, the_p, self->saved.p);\n}", "    npred_set(1, the_p, self->saved.p);\n}"),
        ("return npred_set_one(self, 0, value)", "return npred_set_one(self, 0, -value)"),
    ],
)
def test_the_self_test_of_the_export_sees_a_wrong_set_point(tmp_path, change):
    one = setpoints.controller(PENDULUM)
    for file, text in zip(("npred.h", "npred.c"), c_controller.sources(one), strict=True):
        wrong = text.replace(change[0].replace("npred_real", "double"), change[1].replace("npred_real", "double"))
        assert (wrong != text) == (file == "npred.c")
        (tmp_path / file).write_text(wrong)
    command = ["gcc", *FLAGS, "-Wno-unused-variable", "-DNPRED_TEST", "npred.c", "-o", "own_test", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=300)
    assert subprocess.run([tmp_path / "own_test"], stdout=subprocess.DEVNULL, timeout=60).returncode in (1, 2)


COURSE = {"aim": ([6.0, 12.0], [-0.8, 0.9])}
LOOP = {"X0": [0.3, 0.0], "t_end": 24.0, "dt": 0.01, "D": PENDULUM.D, "D_hat": PENDULUM.D, "actuator": "history"}
LOOP |= {"u0": "equilibrium"}


def simulated(**more):
    plant = PENDULUM.plant
    return npred.simulate(plant, npred.predictor(plant, "rk4", 31), **LOOP | more)


def test_a_simulated_loop_is_that_of_a_controller_which_is_set():
    plant, run = PENDULUM.plant, simulated(setpoints=COURSE)
    predictor = npred.predictor(plant, "rk4", 31)
    one = npred.controller(plant, predictor, None, 0.01, D_hat=PENDULUM.D, actuator="history", u0="equilibrium")
    U = []
    for k, X in enumerate(run.X):
        one.set(**{"aim": -0.8} if k == 600 else {"aim": 0.9} if k == 1200 else {})
        U.append(one.step(X).copy())
    np.testing.assert_allclose(run.U, U, atol=1e-8)
    assert np.ptp(run.U[598:600]) < 1e-9 and abs(run.U[600] - run.U[599]) > 1.0


@pytest.mark.parametrize(("after", "first"), [(-0.4, 3), (0.0, 3), (0.95e-6, 3), (1.5e-6, 4)])
def test_a_set_point_begins_with_the_control_step_that_its_time_is_on_or_with_the_next(after, first):
    """0.03 s are 3 steps, though 0.03 / 0.01 is less; a time is on a step that is a millionth of a step away."""
    course = {"aim": ([(3 + after) * LOOP["dt"]], [-0.8])}
    free, run = (simulated(t_end=0.1, setpoints=course) for course in (None, course))
    assert np.flatnonzero((run.U != free.U).any(axis=-1))[0] == first


def test_distances_of_a_simulated_loop_are_those_to_the_set_point_of_the_time():
    run = simulated(setpoints=COURSE)
    ends = run.X[[599, 1199, -1], 0]
    np.testing.assert_allclose(ends, [0.3, -0.8, 0.9], atol=1e-3)
    np.testing.assert_array_equal(run.target[[599, 600, 1199, 1200], 0], [0.3, -0.8, -0.8, 0.9])
    np.testing.assert_allclose(run.u_target[[0, -1], 0], 9.81 * np.sin([0.3, 0.9]), rtol=1e-12)
    assert run.energy[[599, 1199, -1]].max() < 1e-3 < run.energy[601] and run.energy[1201] > 1e-3
    goal = metrics.target(PENDULUM.plant, run)
    assert metrics.radius(run, goal) < 3e-3 and metrics.settle_time(run, goal) > 12.0
    assert metrics.radius(run, PENDULUM.plant.target(run.t)) > 0.5
    still = simulated()
    assert still.target is None and (still.X[:600] == run.X[:600]).all()


def test_on_a_clock_it_is_the_same():
    """Its pieces are cut at calls that jitter."""
    regular, clocked = (simulated(setpoints=COURSE, **more) for more in ({}, {"timing": npred.Timing()}))
    np.testing.assert_allclose(clocked.X, regular.X, atol=1e-8)
    np.testing.assert_allclose(clocked.energy[[599, 1199, -1]], regular.energy[[599, 1199, -1]], atol=1e-6)
    assert clocked.energy[601] == pytest.approx(regular.energy[601], rel=0.05) and clocked.energy[601] > 1.0
    late = simulated(setpoints=COURSE, timing=npred.Timing(jitter=0.4, lost=0.05))
    np.testing.assert_allclose(late.X[[599, 1199, -1], 0], [0.3, -0.8, 0.9], atol=1e-2)
    twice = simulated(setpoints={"aim": ([6.0, 7.0], [0.3, 0.3])}, timing=npred.Timing(jitter=0.4, lost=0.05))
    once = simulated(timing=npred.Timing(jitter=0.4, lost=0.05))
    np.testing.assert_allclose(twice.X, once.X, atol=1e-12)  # a cut changes nothing


@pytest.mark.parametrize("more", [{}, {"timing": npred.Timing()}], ids=["regular", "clock"])
def test_the_simulated_plant_reads_the_parameter_too(more):
    cart = npred.plant(Loaded)
    loop = LOOP | {"X0": [0.0, 0.0], "setpoints": {"load": ([5.0], [2.0])}} | more
    run = npred.simulate(cart, npred.predictor(cart, "rk4", 11), **loop)
    np.testing.assert_allclose(run.X[[-1]], [[0.0, 0.0]], atol=1e-6)
    assert run.U[-1] == pytest.approx(2.0, abs=1e-6) and np.abs(run.X[510:560]).max() > 0.01
    assert cart.p[0] == cart.parameters["load"] == 0.5  # which other loops share


ONE = st.lists(
    st.tuples(st.integers(0, 9), st.floats(-2, 2)), min_size=1, max_size=4, unique_by=lambda change: change[0]
)
CART = npred.plant(Loaded)


@given(load=ONE, aim=ONE, first=st.sampled_from(["load", "aim"]))
def test_two_courses_are_set_each_at_its_own_times_whichever_is_named_first(load, aim, first):
    """From a time on each parameter has the last of its own values, and before its first one the declared value."""
    courses = {name: sorted(changes) for name, changes in (("load", load), ("aim", aim))}
    names = [first, *(name for name in courses if name != first)]
    given_ones = {name: tuple(map(list, zip(*courses[name], strict=True))) for name in names}
    pieces = settable.course(CART, given_ones)
    starts = sorted({float(time) for changes in courses.values() for time, _ in changes})
    assert [piece.start for piece in pieces] == [-np.inf, *starts]
    for piece in pieces:
        past = {name: [value for time, value in each if time <= piece.start] for name, each in courses.items()}
        now = {name: values[-1] for name, values in past.items() if values}
        assert piece.values == now
        assert dict(zip(CART.p_names, piece.p, strict=True)) == CART.parameters | now
    t = np.arange(0.0, 12.0, 0.5)
    X, U = settable.targets(CART, pieces, t)
    for name, found in (("aim", X[:, 0]), ("load", U[:, 0])):  # the cart rests at its aim, by an input as its load
        times, values = np.array(courses[name], dtype=float).T
        places = np.searchsorted(times, t, side="right") - 1
        expected = np.where(places < 0, CART.parameters[name], values[places])
        np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("course", "said"),
    [
        ({"aim": ([0.0, 5.0], [1.0])}, r"setpoints: aim: expected \(times, values\), as many of both"),
        ({"aim": ([5.0, 0.0], [1.0, 0.0])}, "the times rising"),
        ({"aim": 3.0}, "setpoints: aim: expected"),
        ({"aims": ([0.0], [1.0])}, "did you mean aim"),
        ({"pull": ([0.0], [1.0])}, "the law was designed with it"),
        ({"aim": ([0.0], [1.5])}, "a rest within its bounds for aim = 1.5"),
    ],
)
def test_a_course_that_cannot_be_is_refused(course, said):
    with pytest.raises(ConfigError, match=said):
        simulated(setpoints=course)


def test_a_table_of_a_pipeline_has_a_course_and_its_loops_are_measured_by_it():
    plant = PENDULUM.plant
    table = {"X0": [0.3, 0.0], "D": PENDULUM.D, "D_hat": PENDULUM.D, "dt": 0.01, "nx": 31, "actuator": "history"}
    table |= {"adaptation": "frozen", "u0": "equilibrium", "setpoints": {"aim": {"at": [6.0, 12.0], "to": [-0.8, 0.9]}}}
    read = Evaluate.model_validate(table | {"scenarios": [{"name": "still", "setpoints": {}}]})
    predictor = npred.predictor(plant, "rk4", 31)
    D = np.array([PENDULUM.D])
    loops = Condition(read, np.array([[0.3, 0.0]]), D, D, 24.0, seed=0).loops(plant, predictor)
    np.testing.assert_allclose(loops.X[0], simulated(setpoints=COURSE).X, atol=1e-12)
    assert behaviour(plant, loops, PENDULUM.D).radius.worst < 3e-3
    still = Condition(read.under(read.scenarios[0]), np.array([[0.3, 0.0]]), D, D, 24.0, seed=0)
    assert still.loops(plant, predictor).target is None
