"""An arm by MuJoCo: Pinocchio and SciPy agree on it, and what the engine cannot do is said in one line."""

import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from npred import plants
from npred.base.errors import ConfigError, MissingError
from npred.loop import metrics
from npred.loop.closed_loop import simulate
from npred.prediction.methods import RK4
from npred.prediction.methods.rollout import Rollout
from npred_robots import mujoco_chain

FILE = Path(__file__).with_name("arm.xml")
TEXT = FILE.read_text()
D, U = 0.3, np.array([5.0, -8.0, 3.0])
START = np.array([0.3, -0.4, 0.05, 0.2, 0.1, -0.1])


@pytest.fixture(scope="module", autouse=True)
def engine():
    return pytest.importorskip("mujoco", reason="needs the extra npred[mujoco]")


@pytest.fixture(scope="module")
def arm(engine):
    return plants.make("three", mujoco_chain(FILE))


def damping(n=3):
    return np.array([2.0, 1.0, 5.0])[:n]


@pytest.fixture(scope="module")
def points():
    random = np.random.default_rng(0)
    return random.uniform(-1, 1, (20, 6)), random.uniform(-5, 5, (20, 3)), random.uniform(0, 9, 20)


@pytest.fixture(scope="module")
def library():
    """Pinocchio's model of the same file, which it reads by itself: mass matrix and bias, gravity in it."""
    pin = pytest.importorskip("pinocchio", reason="needs the extra npred[pin]")
    model = pin.buildModelFromMJCF(str(FILE))
    data = model.createData()
    np.testing.assert_allclose(model.armature, [0.1, 0.05, 0.2])

    def mass(q):
        M = np.array(pin.crba(model, data, q))
        return np.triu(M) + np.triu(M, 1).T  # crba's has the armature in it

    def bias(q, v):
        return np.array(pin.nonLinearEffects(model, data, q, v))

    return mass, bias


def test_accelerations_are_those_of_pinocchios_mass_matrix_and_bias(arm, points, library):
    X, u, _ = points
    mass, bias = library
    for x, push, rate in zip(X, u, arm.f(X, u), strict=True):
        q, v = x[:3], x[3:]
        np.testing.assert_allclose(rate[:3], v)
        np.testing.assert_allclose(mass(q) @ rate[3:], push - bias(q, v) - damping() * v, rtol=1e-9, atol=1e-9)


def test_the_law_is_computed_torque_by_pinocchios_parts(arm, points, library):
    """kappa = M a + bias + damping speed, a and the speed from the errors, written anew here."""
    X, _, times = points
    mass, bias = library
    stiffness, gain, amplitude, frequency, _ = arm.p
    for x, t, torque in zip(X, times, arm.kappa(X, times), strict=True):
        q, v, turn = x[:3], x[3:], frequency * t + np.arange(3)
        error, slip = q - amplitude * np.sin(turn), v - amplitude * frequency * np.cos(turn)
        push = -amplitude * frequency**2 * np.sin(turn) - stiffness * error - gain * slip
        speed = amplitude * frequency * np.cos(turn) - gain * error / 2
        np.testing.assert_allclose(torque, mass(q) @ push + bias(q, v) + damping() * speed, rtol=1e-9, atol=1e-9)


def test_gravity_is_a_parameter(arm):
    weightless = plants.make("three", mujoco_chain(FILE), {"gravity": 0.0})
    rest = np.zeros(6)
    assert np.abs(weightless.f(rest, np.zeros(3))).max() < 1e-12 < 1.0 < np.abs(arm.f(rest, np.zeros(3))).max()


@pytest.fixture(scope="module")
def exact(arm):
    """X(D) with a constant input, by SciPy."""
    run = solve_ivp(lambda t, x: arm.f(x, U), (0.0, D), START, "DOP853", rtol=1e-11, atol=1e-12)
    return run.y[:, -1]


@pytest.mark.parametrize(("integrator", "order"), [(None, 1), ("Euler", 1), ("RK4", 4)])
def test_the_engines_rollout_has_the_order_of_its_integrator(integrator, order, exact):
    plant = plants.make("three", mujoco_chain(FILE, integrator=integrator))
    steps = np.array([8, 16, 32]) if order == 4 else np.array([64, 128, 256])
    errors = [np.linalg.norm(Rollout(plant)(START, np.tile(U, (k + 1, 1)), D)[-1] - exact) for k in steps]
    assert -np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(order, abs=0.25)


def test_a_step_of_rk4_on_its_accelerations_is_the_engines(arm, exact):
    """npred's RK4 on mj_forward and the engine's own RK4 are one method."""
    plant = plants.make("three", mujoco_chain(FILE, integrator="RK4"))
    u = np.tile(U, (13, 1))
    np.testing.assert_allclose(RK4(arm)(START, u, D), Rollout(plant)(START, u, D), rtol=1e-9, atol=1e-11)


def test_rows_of_several_delays_are_rolled_each_by_itself(arm):
    u = np.random.default_rng(1).uniform(-5, 5, (4, 11, 3))
    X, delays = np.tile(START, (4, 1)), np.array([0.1, 0.3, 0.0, 0.1])
    together = Rollout(arm)(X, u, delays)
    for row, delay, P in zip(u, delays, together, strict=True):
        np.testing.assert_array_equal(Rollout(arm)(START, row, delay), P)
    np.testing.assert_array_equal(together[2], np.tile(START, (11, 1)))


def test_where_the_engine_gives_up_it_is_nan_and_no_file_is_written(arm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    P = Rollout(arm)(np.array([START, START * 1e9]), np.zeros((2, 5, 3)), D)
    assert np.isfinite(P[0]).all() and np.isnan(P[1, -1]).all()
    assert list(tmp_path.iterdir()) == []


def test_the_loop_tracks_with_the_engines_rollout_and_not_without_prediction(arm):
    settings = {"D": D, "X0": arm.target(0.0), "t_end": 3.0, "dt": 0.01, "u0": arm.u_target(0.0)}
    radii = [
        metrics.radius(loop, arm.target(loop.t))
        for loop in (simulate(arm, Rollout(arm, 61), D_hat=delay, **settings) for delay in (D, 0.0))
    ]
    assert radii[0] < 0.02 < 0.1 < radii[1]


PAD = '<body name="three" pos="0.05 0 0.2">'


def test_contacts_limits_and_dry_friction_of_the_file_are_left_out_and_said(tmp_path, arm, points):
    """f stays a smooth function of state and input."""
    more = (
        TEXT.replace('name="bend"', 'name="bend" range="-0.01 0.01" limited="true" frictionloss="3"')
        .replace("</worldbody>", '<geom type="plane" size="1 1 .1" pos="0 0 0.5"/></worldbody>')
        .replace(
            '<body name="three" pos="0.05 0 0.2">', '<body name="three" pos="0.05 0 0.2"><geom size="0.2" mass="0"/>'
        )
    )
    path = tmp_path / "more.xml"
    path.write_text(more)
    with pytest.warns(UserWarning, match="more.xml: contacts of 2 geoms and dry friction left out"):
        other = plants.make("more", mujoco_chain(path))
    X, u, t = points
    np.testing.assert_allclose(other.f(X, u), arm.f(X, u), rtol=1e-12)
    assert abs(other.target(t)[:, 1]).max() <= 0.01  # the reference keeps the limit


RAIL = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="slider" type="slide" axis="1 0 0"/>
<geom type="box" size=".1 .1 .1" mass="1" contype="0" conaffinity="0"/><body><joint name="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .3 0 .5" size=".03" mass=".2"/></body></body></worldbody>
<actuator><motor joint="slider" ctrlrange="-3 3" gear="10"/></actuator></mujoco>"""


def robot(folder, text, **options):
    """The plant of a file with that text."""
    (folder / "robot.xml").write_text(text)
    return plants.make("robot", mujoco_chain(folder / "robot.xml", **options))


def by_the_engine(engine, folder, q, v, sent):
    """q'' and the actuators' forces of the file, as MuJoCo has them."""
    model = engine.MjModel.from_xml_path(str(folder / "robot.xml"))
    data = engine.MjData(model)
    data.qpos, data.qvel, data.ctrl = q, v, sent
    engine.mj_forward(model, data)
    return data.qacc.copy(), data.qfrc_actuator.copy()


def test_a_motor_pushes_one_joint_in_its_bounds_and_gravity_is_the_files(engine, tmp_path):
    rail = robot(tmp_path, RAIL)
    assert rail.inputs == ("slider_force",) and rail.input_bounds == [(-30.0, 30.0)] and not rail.declares_kappa
    assert rail.parameters == {"gravity": 0.0}
    q, v = np.array([0.2, 0.4]), np.array([0.3, -0.7])
    expected, force = by_the_engine(engine, tmp_path, q, v, [2.0])
    assert force[0] == 20.0
    np.testing.assert_allclose(rail.f(np.hstack([q, v]), np.array([20.0]))[2:], expected, rtol=1e-12)


def test_gravity_may_point_anywhere(engine, tmp_path):
    text = RAIL.replace('"0 0 0"/>', '"3 0 -4"/>', 1)
    tilted = robot(tmp_path, text)
    expected, _ = by_the_engine(engine, tmp_path, np.zeros(2), np.zeros(2), [0.0])
    assert tilted.parameters == {"gravity": 5.0} and np.abs(expected).max() > 1
    np.testing.assert_allclose(tilted.f(np.zeros(4), np.zeros(1))[2:], expected, rtol=1e-12)


MOTORS = '<actuator><motor joint="slider" group="3"/><motor joint="hinge" group="31"/></actuator></mujoco>'
GROUPS = re.sub("<actuator>.*", MOTORS, RAIL, flags=re.DOTALL)


@pytest.mark.parametrize("disabled", ["", "3", "0 3 5", "3 31"])
def test_a_disabled_actuator_is_no_input_as_in_the_engine(engine, tmp_path, disabled):
    """Its group, of 0 to 30, is that which the engine leaves out: what moves nothing there is not offered here."""
    text = GROUPS.replace("<option", f'<option actuatorgroupdisable="{disabled}"' if disabled else "<option")
    if "31" in disabled:
        with pytest.raises(ConfigError, match="expected an MJCF file"):
            robot(tmp_path, text)
        return
    rail = robot(tmp_path, text)
    at_rest, _ = by_the_engine(engine, tmp_path, np.zeros(2), np.zeros(2), [0.0, 0.0])
    moved = [by_the_engine(engine, tmp_path, np.zeros(2), np.zeros(2), sent)[0] for sent in np.eye(2)]
    acting = [k for k, q in enumerate(moved) if (q != at_rest).any()]
    assert rail.inputs == tuple(("slider_force", "hinge_torque")[k] for k in acting)
    for unit, k in zip(np.eye(rail.m), acting, strict=True):
        np.testing.assert_allclose(rail.f(np.zeros(4), unit)[2:], moved[k], rtol=1e-12)


@pytest.mark.parametrize(
    ("option", "new"), [('<option actuatorgroupdisable="3 5"', 'group="5"'), ("<option", 'group="31"')]
)
def test_a_file_whose_actuators_are_all_disabled_has_no_input_unless_named(tmp_path, option, new):
    text = GROUPS.replace('group="31"', new)
    if new == 'group="31"':
        text = text.replace('gravity="0 0 0"/>', 'gravity="0 0 0"><flag actuation="disable"/></option>')
    else:
        text = text.replace("<option", option)
    with pytest.raises(ConfigError, match=r"expected a joint with a motor, got none; name them: actuated"):
        robot(tmp_path, text)
    named = robot(tmp_path, text, actuated=["hinge"])
    assert named.inputs == ("hinge_torque",)
    assert np.abs(named.f(np.zeros(4), np.ones(1)) - named.f(np.zeros(4), np.zeros(1))).max() > 0.1


def test_an_input_that_moves_nothing_is_refused(tmp_path):
    """A servo whose range of targets lies beyond what its force can reach is at its limit all the time."""
    servo = '<position joint="slider" kp="10" ctrlrange="2 3" forcerange="-1 1"/>'
    text = RAIL.replace('<motor joint="slider" ctrlrange="-3 3" gear="10"/>', servo)
    with pytest.raises(ConfigError, match="actuator actuator_0: expected an effect on its joint, got none; take it"):
        robot(tmp_path, text)


@pytest.mark.parametrize(
    ("actuator", "bounds"),
    [
        ('<motor joint="slider" ctrlrange="2 5"/>', (2.0, 5.0)),
        ('<motor joint="slider" ctrlrange="-9 -3"/>', (-9.0, -3.0)),
        ('<motor joint="slider" forcerange="3 8"/>', (3.0, 8.0)),
        ('<motor joint="slider"/>', None),
        ('<position joint="slider" kp="10" ctrlrange="2 3"/>', (2.0, 3.0)),
    ],
)
def test_an_input_with_bounds_anywhere_has_an_effect(tmp_path, actuator, bounds):
    text = RAIL.replace('<motor joint="slider" ctrlrange="-3 3" gear="10"/>', actuator)
    assert robot(tmp_path, text).input_bounds == (bounds and [bounds])


def test_an_inertial_that_the_engine_refuses_comes_with_its_body(tmp_path):
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 5"/>'
    text = RAIL.replace('<body><joint name="hinge"', f'<body name="upper">{inertial}<joint name="hinge"')
    with pytest.raises(ConfigError, match=r"must satisfy A \+ B >= C.*Element name 'upper'.*; fix the file"):
        robot(tmp_path, text)


def test_forcerange_and_gear_narrow_the_bounds(tmp_path):
    text = RAIL.replace('gear="10"', 'gear="-10" forcerange="-1 2"')
    assert robot(tmp_path, text).input_bounds == [(-20.0, 10.0)]


@pytest.mark.parametrize(
    ("servo", "name", "unit"),
    [
        ('<position joint="{}" kp="90" kv="4" gear="2" ctrlrange="-1 1"/>', "bend_target", "rad"),
        ('<velocity joint="{}" kv="7" ctrlrange="-1 1"/>', "bend_speed", "rad/s"),
    ],
)
def test_a_servo_is_sent_its_target_and_the_law_makes_up_for_its_feedback(engine, tmp_path, points, servo, name, unit):
    servos = "".join(servo.format(joint) for joint in ("reach", "turn", "bend"))  # in another order than the joints
    text = TEXT.replace("</mujoco>", f"<actuator>{servos}</actuator></mujoco>")
    text = re.sub('actuatorfrcrange=".*?"', "", text)
    arm = robot(tmp_path, text, pose=[0.1, 0.0, 0.0])
    assert arm.inputs[1] == name and arm.units[name] == unit and arm.input_bounds == [(-1.0, 1.0)] * 3
    X, u, t = points
    for x, sent in zip(X, u / 5, strict=True):  # within what the engine clips to
        expected, _ = by_the_engine(engine, tmp_path, x[:3], x[3:], sent[[2, 0, 1]])
        np.testing.assert_allclose(arm.f(x, sent)[3:], expected, rtol=1e-9, atol=1e-9)
    at = arm.target(t)  # where the law asks for the wave's own acceleration, whatever the damping
    step = 1e-4
    acceleration = (arm.target(t + step)[:, 3:] - arm.target(t - step)[:, 3:]) / (2 * step)
    np.testing.assert_allclose(arm.f(at, arm.kappa(at, t))[:, 3:], acceleration, atol=1e-6)
    u = arm.kappa(at, t)[:9]
    path = Rollout(arm)(at[:9], np.repeat(u[:, None], 401, axis=1), np.full(9, 0.02))
    exact = RK4(arm)(at[:9], np.repeat(u[:, None], 401, axis=1), np.full(9, 0.02))
    np.testing.assert_allclose(path[:, -1], exact[:, -1], atol=2e-4)


def test_actuated_takes_the_place_of_the_files_actuators(tmp_path):
    text = TEXT.replace("</mujoco>", '<actuator><position joint="turn" kp="100"/></actuator></mujoco>')
    arm = robot(tmp_path, text, actuated=["turn", "bend", "reach"])
    assert arm.inputs == ("turn_torque", "bend_torque", "reach_force") and arm.input_bounds[0] == (-40.0, 40.0)


FINGERS = """<mujoco><worldbody><body><joint name="arm" axis="0 1 0"/><geom size=".1" mass="1"/>
<body pos="0 0 .2"><joint name="left" type="slide" axis="1 0 0"/><geom size=".02" mass=".1"/></body>
<body pos="0 .1 .2"><joint name="right" type="slide" axis="1 0 0"/><geom size=".02" mass=".1"/></body></body>
</worldbody><tendon><fixed name="split"><joint joint="left" coef="1"/><joint joint="right" coef="1"/></fixed></tendon>
<equality><joint joint1="left" joint2="right"/></equality>
<actuator><motor joint="arm"/><position tendon="split"/></actuator><sensor><jointpos joint="left"/></sensor>
<keyframe><key qpos="0 0 0"/></keyframe></mujoco>"""


@pytest.mark.filterwarnings("ignore:.*left out")
def test_a_gripper_is_locked_with_what_ties_its_fingers(tmp_path):
    arm = robot(tmp_path, FINGERS, lock=["left", "right"])
    assert arm.states == ("arm", "arm_rate") and arm.inputs == ("arm_torque",)
    inertia = 0.4 * 0.1**2 + 2 * (0.4 * 0.1 * 0.02**2 + 0.1 * 0.2**2)
    slope = arm.f(np.zeros(2), np.ones(1))[1] - arm.f(np.zeros(2), np.zeros(1))[1]
    assert slope == pytest.approx(1 / inertia)
    with pytest.raises(ConfigError, match=r"'left' .*; lock all that it ties"):
        robot(tmp_path, FINGERS, lock=["left"])
    with pytest.raises(ConfigError, match=r"expected a joint with a motor, got none; name them: actuated=\('arm',\)"):
        robot(tmp_path, FINGERS, lock=["left", "right"], actuated=())
    with pytest.raises(ConfigError, match="lock: expected names of joints: arm, left, right, got 'lift'"):
        robot(tmp_path, FINGERS, lock=["lift"])


def test_names_units_and_bounds_come_from_the_file(arm):
    assert arm.states[:3] == ("turn", "bend", "reach") and arm.inputs == ("turn_torque", "bend_torque", "reach_force")
    assert arm.units["reach_rate"] == "m/s"
    assert arm.input_bounds == [(-40.0, 40.0), (-30.0, 20.0), (-50.0, 50.0)]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('type="slide"', 'type="ball"', "joint reach: expected type hinge or slide"),
        (
            '<joint name="turn" axis="0 0.2 1" armature="0.1" damping="2" actuatorfrcrange="-40 40"/>',
            "<freejoint/>",
            r"joint joint_0: expected type hinge or slide, got free; lock=\('joint_0',\) if it is mounted",
        ),
        (
            "</mujoco>",
            '<equality><joint joint1="turn" joint2="bend"/></equality></mujoco>',
            r"got the joint equality equality_0, which ties .*; take it out, or lock=\('turn', 'bend'\)",
        ),
        (
            "</mujoco>",
            '<tendon><fixed name="rope"><joint joint="turn" coef="1"/></fixed></tendon></mujoco>',
            "expected rigid bodies and joints, got the tendon rope; take it out",
        ),
        (
            "</mujoco>",
            '<actuator><intvelocity name="a" joint="turn" actrange="-1 1"/></actuator></mujoco>',
            "actuator a: expected one without a state, got another; take it out, or name the joints",
        ),
        (
            "</mujoco>",
            '<actuator><damper joint="turn" ctrlrange="0 1"/></actuator></mujoco>',
            "actuator actuator_0: expected a constant gain, got another",
        ),
        (
            "</mujoco>",
            '<actuator><motor joint="turn"/><velocity joint="turn"/></actuator></mujoco>',
            "joint turn: expected one actuator, got two",
        ),
        (
            "</mujoco>",
            '<actuator><motor joint="turn"/></actuator></mujoco>',
            "joint reach: expected a motor or a spring for what slides along gravity, got neither: contacts",
        ),
        ("<mujoco", "<robot", "expected an MJCF file, got:"),
        ('mass="2.5"', 'mass="heavy"', "expected an MJCF file, got:"),
    ],
)
def test_what_is_no_such_arm_is_one_line(tmp_path, old, new, message):
    path = tmp_path / "wrong.xml"
    path.write_text(TEXT.replace(old, new))
    with pytest.raises(ConfigError, match=message) as failure:
        mujoco_chain(path)
    assert "\n" not in str(failure.value)


def test_an_integrator_that_there_is_not_is_named():
    with pytest.raises(ConfigError, match="integrator: expected one of Euler, RK4, implicit, implicitfast, got 'rk5'"):
        mujoco_chain(FILE, integrator="rk5")


def test_without_the_engine_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(MissingError, match=r"pip install 'npred\[mujoco\]'"):
        mujoco_chain(FILE)


def test_threads_do_not_meet_in_the_engines_memory(arm):
    rng = np.random.default_rng(5)
    jobs = [(rng.normal(size=(200, arm.n)), rng.normal(size=(200, arm.m))) for _ in range(4)]
    serial = [(arm.f(X, u, 0.0), arm.kappa(X, 0.0)) for X, u in jobs]
    with ThreadPoolExecutor(4) as threads:
        for _ in range(5):
            found = list(threads.map(lambda job: (arm.f(*job, 0.0), arm.kappa(job[0], 0.0)), jobs))
            for here, there in zip(found, serial, strict=True):
                np.testing.assert_array_equal(here[0], there[0])
                np.testing.assert_array_equal(here[1], there[1])
