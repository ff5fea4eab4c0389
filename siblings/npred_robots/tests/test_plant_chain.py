"""A robot arm from its URDF file, traced: what every plant must show, and a library's black box of the same arm."""

import numpy as np
import plant_claims
import pytest
from six_joint import SIX, TEXT

from npred import plants
from npred.base.errors import ConfigError, MissingError
from npred.diagnosis import equilibrium
from npred.lab.scheduler.configuration import identity
from npred.loop import metrics
from npred.loop.closed_loop import simulate
from npred.plants.base import Plant
from npred.prediction.methods import RK4
from npred_robots import pin_chain
from npred_robots.chain import chain

PLANT = Plant("six", chain(SIX))
D = 0.2
FREE = [(-np.inf, np.inf)] * 6
FILE = f"""
from npred_robots.chain import chain

Arm = chain({str(SIX)!r}, pose=[0.1, 0.2, 0.0, 0.0, 0.0, 0.0])
"""


def test_its_mechanics_are_those_of_f():
    PLANT.check_mechanics()


def test_a_file_of_three_lines_declares_it(tmp_path):
    path = tmp_path / "arm.py"
    path.write_text(FILE)
    plant = plants.resolve(f"{path}:Arm", {"amplitude": 0.0})
    assert plant.states[2] == "elbow_bend" and plant.inputs[3] == "reach_force"
    assert plant.input_bounds[3] == (-60.0, 60.0)
    np.testing.assert_allclose(plant.target(1.0), [0.1, 0.2] + [0.0] * 10, atol=1e-16)


@pytest.mark.parametrize(("joint", "state"), [("1st", "joint_1st"), ("lambda", "joint_lambda"), ("_a.b", "joint_a_b")])
def test_a_joint_may_have_any_name(tmp_path, joint, state):
    path = tmp_path / "named.urdf"
    path.write_text(TEXT.replace('"shoulder"', f'"{joint}"'))
    assert Plant("six", chain(path)).states[1] == state


def test_the_file_is_part_of_the_identity(tmp_path):
    path = tmp_path / "heavier.urdf"
    path.write_text(TEXT.replace('<mass value="1.2"/>', '<mass value="1.3"/>'))
    assert identity(Plant("six", chain(path)))["program"] != identity(PLANT)["program"]
    path.write_text(TEXT.replace("Six joints", "6 joints"))
    assert identity(Plant("six", chain(path))) == identity(PLANT)


def test_a_pose_of_another_length_is_told():
    with pytest.raises(ConfigError, match="pose expected 6 numbers"):
        chain(SIX, pose=[0.0])


def test_the_reference_is_a_trajectory_of_the_law():
    assert equilibrium.slip(PLANT, 20.0)[0] < 1e-9


def test_derivatives_equal_differences():
    plant_claims.derivatives_equal_differences(PLANT)


@pytest.mark.parametrize("method", ["euler", "heun", "rk4"])
def test_predictor_order(method):
    plant_claims.has_its_order(PLANT, method, D)


def test_the_loop_is_the_golden_one():
    X0, dt = PLANT.target(0.0) + 0.02, 0.0025
    golden = plant_claims.golden_loop(PLANT, D, X0, 0.6, dt)
    loop = simulate(PLANT, plant_claims.Held(PLANT, 161), D=D, D_hat=D, X0=X0, t_end=0.6, dt=dt, input_bounds=FREE)
    np.testing.assert_allclose(loop.X, golden, rtol=0, atol=1e-6)


def test_it_tracks_from_its_box_with_the_predictor_and_only_with_it():
    """With it up to half a step of the held input on a moving reference."""
    X0 = plant_claims.box(PLANT, 8)
    for D_hat, low, high in ((D, 0.0, 1e-2), (0.0, 0.1, np.inf)):
        loops = simulate(PLANT, RK4(PLANT, 41), D=D, D_hat=D_hat, X0=X0, t_end=6.0, every=20)
        radii = metrics.radius(loops, PLANT.target(loops.t))
        assert (radii >= low).all() and (radii <= high).all()


@pytest.fixture(scope="module")
def library():
    pytest.importorskip("pinocchio", reason="needs the extra npred[pin]")
    return plants.make("six", pin_chain.pin_chain(SIX))


def test_the_library_agrees_on_every_function(library):
    random = np.random.default_rng(0)
    X, u, t = random.uniform(-1, 1, (20, 12)), random.uniform(-5, 5, (20, 6)), random.uniform(0, 9, 20)
    np.testing.assert_allclose(library.f(X, u), PLANT.f(X, u), rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(library.kappa(X, t), PLANT.kappa(X, t), rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(library.V(X, t), PLANT.V(X, t), rtol=1e-12)
    np.testing.assert_allclose(library.target(t), PLANT.target(t), rtol=1e-14)


def test_the_library_closes_the_same_loop(library):
    """Traced and compiled against called, from the same start: the states agree to 1e-10."""
    settings = {"D": D, "D_hat": D, "X0": PLANT.target(0.0) + 0.05, "t_end": 1.0, "dt": 0.01}
    traced, called = (simulate(p, RK4(p, 11), **settings) for p in (PLANT, library))
    assert np.ptp(traced.X[:, 0]) > 0.01
    np.testing.assert_allclose(called.X, traced.X, rtol=0, atol=1e-10)
    np.testing.assert_allclose(called.U, traced.U, rtol=0, atol=1e-8)


def test_without_the_library_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pinocchio", None)
    with pytest.raises(MissingError, match=r"pip install 'npred\[pin\]'"):
        pin_chain.pin_chain(SIX)
