"""URDF files: a chain of six joints is read, what is fixed is merged, and what is no chain is told in one line."""

from pathlib import Path

import numpy as np
import pytest

from npred.errors import ConfigError
from npred.plants import urdf

SIX = Path(__file__).parent / "six_joint.urdf"
TEXT = SIX.read_text()


def test_six_joints_are_read():
    bodies = urdf.read(SIX)
    assert [body.joint for body in bodies] == ["turn", "shoulder", "elbow-bend", "reach", "roll", "pitch"]
    assert [body.slides for body in bodies] == [False] * 3 + [True] + [False] * 2
    assert [body.damping for body in bodies] == [0.5, 0.4, 0.3, 2.0, 0.0, 0.1]
    assert [body.effort for body in bodies] == [90, 90, 60, 60, 30, 30]
    np.testing.assert_allclose(bodies[2].axis, np.array([0, 1, 0.2]) / np.sqrt(1.04))
    np.testing.assert_allclose(bodies[1].place, [0.05, 0, 0.2])
    np.testing.assert_allclose(bodies[1].turn @ bodies[1].turn.T, np.eye(3), atol=1e-15)


def test_what_is_fixed_is_merged():
    """Hand and tool: the mass adds, the centre is the mean, and the tool's inertia is turned and shifted."""
    hand = urdf.read(SIX)[-1]
    turn = urdf._origin(urdf.ElementTree.fromstring('<a><origin rpy="0 0 0.7"/></a>'))[0]
    turn = turn @ urdf._origin(urdf.ElementTree.fromstring('<a><origin rpy="0.4 0 0"/></a>'))[0]
    own, tool = np.array([0.01, 0, 0.05]), np.array([0, 0.02, 0.1]) + turn @ [0, 0, 0.06]
    centre = (0.5 * own + 0.3 * tool) / 0.8
    assert hand.mass == pytest.approx(0.8)
    np.testing.assert_allclose(hand.centre, centre, rtol=1e-12)
    apart = 0.5 * 0.3 / 0.8 * np.sum((own - tool) ** 2)  # of two points about their common centre
    assert np.trace(hand.inertia) == pytest.approx(0.0045 + 0.0024 + 2 * apart, rel=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('type="prismatic"', 'type="planar"', "joint reach: expected a type of .*prismatic or fixed, got 'planar'"),
        ('<child link="hand"/>', '<child link="foot"/>', "joint pitch names a link 'foot' that is not there"),
        (
            '<parent link="hand"/>',
            '<parent link="tool"/>',
            "hang on base, found a ring of mount, tool",
        ),
        ('<mass value="1.2"/>', '<mass value="0"/>', "joint reach: expected a link with a mass above 0 kg, got 0"),
        ('<mass value="1.2"/>', '<mass value="much"/>', "<mass>: value expected a finite number, got 'much'"),
        ('<mass value="1.2"/>', "", "inertial: expected a <mass>, found none"),
        ('ixx="0.012"', "", "<inertia>: expected an attribute ixx, found none"),
        ('xyz="0 1 0.2"', 'xyz="0 0 0"', "joint elbow-bend: expected an axis, got one of length 0"),
        ('xyz="0 1 0.2"', 'xyz="0 1"', "<axis>: xyz expected 3 numbers, got '0 1'"),
        ('<parent link="wrist"/>', '<parent link="elbow"/>', "it branches at the joints reach, pitch"),
        (
            '<link name="mount"/>',
            '<link name="mount"/><link name="spare"/>',
            "expected one base link, found base, spare",
        ),
        ("<robot", "<!DOCTYPE robot><robot", "expected a URDF file without DOCTYPE"),
        ("</robot>", "", "expected XML, got: no element found"),
    ],
)
def test_what_is_no_chain_is_told(tmp_path, old, new, message):
    assert old in TEXT
    path = tmp_path / "wrong.urdf"
    path.write_text(TEXT.replace(old, new))
    with pytest.raises(ConfigError, match=message) as caught:
        urdf.read(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_other_files_are_told(tmp_path):
    with pytest.raises(ConfigError, match=r"nowhere.urdf: expected a URDF file, got: No such file"):
        urdf.read(tmp_path / "nowhere.urdf")
    path = tmp_path / "mesh.stl"
    path.write_bytes(b" " * (urdf.LARGEST + 1))
    with pytest.raises(ConfigError, match="at most 1048576 bytes"):
        urdf.read(path)
    path.write_text('<robot name="stone"><link name="base"/></robot>')
    with pytest.raises(ConfigError, match="expected a joint that moves, found none"):
        urdf.read(path)
    path.write_text("<html/>")
    with pytest.raises(ConfigError, match="expected a <robot>, got <html>"):
        urdf.read(path)
