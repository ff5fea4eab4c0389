"""URDF files that branch: Pinocchio, which reads the same file by itself, agrees; `tip` and `lock` leave an arm."""

import numpy as np
import pytest
from urdf_text import TWO, joint, link, write

from npred.base.errors import ConfigError
from npred.plants.base import Plant
from npred_robots import urdf
from npred_robots.chain import chain

FINGERS = (
    link("palm", 0.5),
    '<joint name="flange" type="fixed"><parent link="b"/><child link="palm"/>'
    '<origin xyz="0 0 0.3" rpy="0.2 0 1"/></joint>',
    link("left", 0.2, 0.001, "0.01 0 0.05"),
    link("right", 0.3, 0.002, "0 0.02 0.05"),
    link("nail", 0.1, 0.001),
    joint("open", "palm", "left", "prismatic", "1 0.2 0", 'effort="5" lower="0.01" upper="0.04"'),
    joint("close", "palm", "right", axis="0 1 0.3", more='<mimic joint="open" multiplier="-2" offset="0.1"/>'),
    joint("curl", "right", "nail", axis="1 0 0", more='<dynamics damping="0.3"/>'),
)
HEAVY = link("base", 8.0)


def compared(path, robot, at_rest, ratios):
    """Mass matrix, bias and damping of the plant against Pinocchio's, of which each joint moves by ratio and offset."""
    pin = pytest.importorskip("pinocchio", reason="needs the extra npred[pin]")
    model = pin.buildModelFromUrdf(str(path))
    locked = [model.getJointId(name) for name in at_rest]
    at = pin.neutral(model)
    for name, position in at_rest.items():
        at[model.joints[model.getJointId(name)].idx_q] = position
    model = pin.buildReducedModel(model, locked, at)
    data, n, random = model.createData(), robot.n // 2, np.random.default_rng(0)
    G, offsets = np.zeros((model.nv, n)), np.zeros(model.nv)
    for name, (k, ratio, offset) in ratios.items():
        i = model.joints[model.getJointId(name)].idx_v
        G[i, k], offsets[i] = ratio, offset
    for _ in range(5):
        y, v, u = random.uniform(-1, 1, (3, n))
        M = np.triu(pin.crba(model, data, G @ y + offsets))
        M = G.T @ (M + np.triu(M, 1).T) @ G
        force = u - G.T @ (pin.nonLinearEffects(model, data, G @ y + offsets, G @ v) + model.damping * (G @ v))
        x = np.hstack([y, v])
        np.testing.assert_allclose(M @ robot.f(x, u)[n:], force, rtol=1e-9, atol=1e-9)


def test_a_tree_with_a_mimic_is_pinocchios(tmp_path):
    path = write(tmp_path, *TWO, *FINGERS)
    robot = Plant("robot", chain(path))
    assert robot.states[:4] == ("j1", "j2", "open", "curl")
    moves = {"j1": (0, 1, 0), "j2": (1, 1, 0), "open": (2, 1, 0), "close": (2, -2, 0.1), "curl": (3, 1, 0)}
    compared(path, robot, {}, moves)


def test_the_library_computes_the_same_tree(tmp_path):
    pytest.importorskip("pinocchio", reason="needs the extra npred[pin]")
    path = write(tmp_path, *TWO, *FINGERS)
    (tmp_path / "robot.py").write_text(
        f"from npred_robots import chain, pin_chain\nA = chain.chain({str(path)!r}, lock=['curl'])\n"
        f"B = pin_chain.pin_chain({str(path)!r}, lock=['curl'])\n"
    )
    from npred import plants

    ours, theirs = (plants.resolve(f"{tmp_path / 'robot.py'}:{name}") for name in "AB")
    random = np.random.default_rng(0)
    X, u, t = random.uniform(-1, 1, (9, 6)), random.uniform(-1, 1, (9, 3)), random.uniform(0, 9, 9)
    np.testing.assert_allclose(theirs.f(X, u), ours.f(X, u), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(theirs.kappa(X, t), ours.kappa(X, t), rtol=1e-9, atol=1e-9)


def test_tip_leaves_the_arm_and_locks_the_gripper(tmp_path):
    """Where it is closest to 0 within its limits: `open` at 0.01, so that what mimics it stands at 0.1 - 2 · 0.01."""
    path = write(tmp_path, *TWO, *FINGERS)
    robot = Plant("robot", chain(path, tip="palm"))
    assert robot.states[:2] == ("j1", "j2")
    at_rest = {"open": 0.01, "close": 0.08, "curl": 0.0}
    compared(path, robot, at_rest, {"j1": (0, 1, 0), "j2": (1, 1, 0)})


def test_lock_gives_a_position(tmp_path):
    path = write(tmp_path, *TWO, *FINGERS)
    robot = Plant("robot", chain(path, lock={"open": 0.03, "j2": 0.7, "curl": -0.5}))
    compared(path, robot, {"open": 0.03, "close": 0.04, "curl": -0.5, "j2": 0.7}, {"j1": (0, 1, 0)})


def test_a_heavy_base_with_limbs_is_asked_whether_it_is_mounted(tmp_path):
    limbs = (link("a"), link("b"), joint("j1", "base", "a"), joint("j2", "base", "b"))
    path = write(tmp_path, *limbs, base=HEAVY)
    with pytest.raises(ConfigError, match="got a base base of 8 kg that j1, j2 move against; mounted=True if"):
        urdf.read(path)
    assert len(urdf.read(path, mounted=True)) == 2
    assert [body.joint for body in urdf.read(path, tip="b")] == ["j2"]
    assert len(urdf.read(write(tmp_path, *limbs))) == 2  # a base without a mass is the ground


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tip": "palms"}, r"tip: expected one of the links base, a, .*, got 'palms'; did you mean palm\?$"),
        ({"lock": ["j5"]}, "lock: expected names of joints: j1, j2, flange, .*, got 'j5'"),
        ({"lock": {"j2": np.nan}}, "lock: j2: expected finite numbers"),
        ({"lock": "j5"}, "lock: expected names of joints: j1, j2, flange, .*, got 'j5'"),
        ({"lock": ["j1", "j2", "open", "curl"]}, "expected a joint that moves, found none"),
    ],
)
def test_names_that_are_not_there_are_told(tmp_path, options, message):
    with pytest.raises(ConfigError, match=message):
        urdf.read(write(tmp_path, *TWO, *FINGERS), **options)


def test_a_base_that_floats_is_locked_or_told(tmp_path):
    root = '<joint name="root" type="floating"><parent link="world"/><child link="base"/></joint>'
    path = write(tmp_path, root, '<link name="world"/>', *TWO, base=HEAVY)
    with pytest.raises(ConfigError, match=r"joint root: expected an arm, got a base that floats; lock=\('root',\) if"):
        urdf.read(path)
    assert [body.joint for body in urdf.read(path, lock=["root"])] == ["j1", "j2"]
