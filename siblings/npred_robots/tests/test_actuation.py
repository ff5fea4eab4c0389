"""Which joints of a URDF file have a motor, which follow another, and where they stay."""

import numpy as np
import pytest
from urdf_text import CART, LIFT, TWO, joint, link, motor, write

from npred import plants
from npred.base.errors import ConfigError
from npred.loop.closed_loop import simulate
from npred.plants.base import Plant
from npred.prediction.methods import RK4
from npred_robots import rigid_body, urdf
from npred_robots.chain import chain


def plant(path, *parts, pose=None, **options):
    return Plant("robot", chain(write(path, *parts), pose, **options))


def test_transmissions_say_which_joints_have_a_motor(tmp_path):
    with pytest.warns(UserWarning, match=r"j2 with an effort but without a transmission .*actuated=\(…\)"):
        robot = plant(tmp_path, *TWO, motor("j1"))
    assert robot.inputs == ("j1_torque",) and robot.input_bounds == [(-10.0, 10.0)] and robot.m == 1
    control = '<ros2_control name="c" type="system"><joint name="j2"><command_interface name="effort"/></joint>'
    with pytest.warns(UserWarning, match="j1 with an effort"):
        assert plant(tmp_path, *TWO, control + '<joint name="j1"/></ros2_control>').inputs == ("j2_torque",)


def test_a_joint_with_effort_0_has_no_motor(tmp_path):
    cart = plant(tmp_path, *CART)
    assert cart.states == ("slide", "pivot", "slide_rate", "pivot_rate") and cart.inputs == ("slide_force",)
    assert cart.input_bounds == [(-20.0, 20.0)] and not cart.declares_kappa
    whole = plant(tmp_path, *CART, actuated=("slide", "pivot"))
    x, u = np.array([0.1, 0.4, 0.3, -0.2]), np.array([3.0])
    np.testing.assert_allclose(cart.f(x, u), whole.f(x, np.array([3.0, 0.0])), rtol=1e-12)
    cart.check_mechanics()


def test_the_pole_of_the_cart_is_held_by_a_law_that_is_designed(tmp_path):
    (tmp_path / "cart.py").write_text(
        f"from npred_robots.chain import chain\nCart = chain({str(write(tmp_path, *CART))!r})\n"
    )
    cart = plants.resolve(f"{tmp_path / 'cart.py'}:Cart", kappa="lqr")
    loop = simulate(cart, RK4(cart, 21), D=0.1, D_hat=0.1, X0=[0.1, 0.05, 0.0, 0.0], t_end=12.0, dt=0.02)
    assert np.abs(loop.X[-1]).max() < 1e-3


def test_actuated_says_it_for_a_file_that_does_not(tmp_path):
    assert plant(tmp_path, *TWO, actuated=("j2",)).inputs == ("j2_torque",)
    two = plant(tmp_path, *CART, actuated=("slide", "pivot"))
    assert two.input_bounds == [(-20.0, 20.0), (-np.inf, np.inf)] and two.declares_kappa


def test_one_effort_that_is_missing_leaves_the_others(tmp_path):
    robot = plant(tmp_path, *TWO[:3], joint("j2", "a", "b", "continuous", limit=""))
    assert robot.input_bounds == [(-10.0, 10.0), (-np.inf, np.inf)]


def test_a_joint_that_mimics_is_seen_by_the_motor_of_the_other(tmp_path):
    lift = plant(tmp_path, *LIFT)
    assert lift.states == ("low", "low_rate") and lift.inputs == ("low_force",)
    M, force, damping = lift.call("mechanics", [0.3, 0.2], [7.0], 0.0, [*lift.parameters.values()], np)
    assert M == [[17.0]] and damping == [3.0]  # 5 + 2² · 3 kg
    np.testing.assert_allclose(force, 7.0 - 9.81 * (5.0 + 2 * 3.0))
    np.testing.assert_allclose(lift.safe(np.array([0.3, 0.0])), [0.3, 0.7])  # the limits of both


def test_mimics_turn_by_ratio_and_offset_also_through_another(tmp_path):
    parts = (
        *TWO[:3],
        joint("j2", "a", "b", more='<mimic joint="j1" multiplier="-0.5" offset="0.2"/>'),
        link("c"),
        joint("j3", "b", "c", more='<mimic joint="j2" multiplier="2" offset="0.1"/>'),
    )
    path = write(tmp_path, *parts)
    bodies = urdf.read(path)
    np.testing.assert_allclose(rigid_body.moves(bodies), [(0, 1, 0), (0, -0.5, 0.2), (0, -1, 0.5)])
    free = [rigid_body.Body(**{**vars(body), "mimic": None}) for body in bodies]
    G, at = np.array([[1.0], [-0.5], [-1.0]]), np.array([0.3, 0.05, 0.2])
    wide = np.array(rigid_body.mass_matrix(free, at.tolist(), np))
    np.testing.assert_allclose(rigid_body.mass_matrix(bodies, [0.3], np), G.T @ wide @ G, rtol=1e-12)
    loads = rigid_body.torques(free, at.tolist(), (0.7 * G[:, 0]).tolist(), [0.0] * 3, 9.81, np)
    np.testing.assert_allclose(rigid_body.torques(bodies, [0.3], [0.7], [0.0], 9.81, np), G.T @ loads, rtol=1e-12)


def test_the_reference_and_the_box_stay_within_the_limits(tmp_path):
    parts = (*TWO[:2], joint("j1", "base", "a", limit='effort="9" lower="0.5" upper="2"'), TWO[3])
    robot = plant(tmp_path, *parts)
    goal = robot.target(np.linspace(0, 20, 500))
    assert goal[:, 0].min() > 0.55 and np.ptp(goal[:, 0]) > 0.39 and robot.box["j1"][0] == 0.5
    assert abs(goal[:, 1].mean()) < 0.1 and (robot.safe(goal) > 0.05).all()
    tight = plant(tmp_path, *TWO[:2], joint("j1", "base", "a", limit='effort="9" lower="0" upper="0.04"'), TWO[3])
    goal = tight.target(np.linspace(0, 20, 500))
    assert goal[:, 0].min() > 0.002 and goal[:, 0].max() < 0.038 and np.ptp(goal[:, 0]) > 0.015
    with pytest.raises(ConfigError, match=r"pose expected j1 within its limits 0.5 and 2, got 0; move it inside"):
        plant(tmp_path, *parts, pose=[0.0, 0.0])


@pytest.mark.parametrize(
    ("parts", "options", "message"),
    [
        (
            (*CART, motor("pivot")),
            {"lock": ["slide"]},
            "expected a joint with a motor, got effort 0, or no transmission, for all that move",
        ),
        (TWO, {"actuated": ("j3",)}, "actuated: expected names of joints: j1, j2, got 'j3'; name one of them"),
        (LIFT, {"actuated": ("top",)}, "actuated: expected joints that move by themselves, got top; leave them out"),
        ((*TWO[:3], joint("j2", "a", "b", limit='effort="-1"')), {}, "j2: expected an effort of at least 0, got -1"),
        ((*TWO[:3], joint("j2", "a", "b", more='<mimic joint="j9"/>')), {}, "j2 mimics a joint 'j9' that is not there"),
        ((*TWO[:3], joint("j2", "a", "b", more='<mimic joint="j2"/>')), {}, "joints j2 mimic each other"),
    ],
)
def test_what_moves_no_joint_is_told(tmp_path, parts, options, message):
    with pytest.raises(ConfigError, match=message) as caught:
        plant(tmp_path, *parts, **options)
    assert "\n" not in str(caught.value)
