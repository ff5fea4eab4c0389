"""URDF files: a chain of six joints is read, what is fixed is merged, and what is no chain is told in one line."""

import os

import numpy as np
import pytest
from six_joint import SIX, TEXT
from urdf_text import TWO, joint, link, write

from npred.base.errors import ConfigError
from npred_robots import urdf
from npred_robots.chain import chain


def test_six_joints_are_read():
    bodies = urdf.read(SIX)
    assert [body.joint for body in bodies] == ["turn", "shoulder", "elbow-bend", "reach", "roll", "pitch"]
    assert [body.slides for body in bodies] == [False] * 3 + [True] + [False] * 2
    assert [body.damping for body in bodies] == [0.5, 0.4, 0.3, 2.0, 0.0, 0.1]
    assert [body.effort for body in bodies] == [90, 90, 60, 60, 30, 30]
    np.testing.assert_allclose(bodies[2].axis, np.array([0, 1, 0.2]) / np.sqrt(1.04))
    np.testing.assert_allclose(bodies[1].position, [0.05, 0, 0.2])
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
        ('type="prismatic"', 'type="planar"', "joint reach: expected a type of .*prismatic, fixed, got 'planar'"),
        ('type="prismatic"', 'type="prismatik"', r"did you mean prismatic\?"),
        ('<child link="hand"/>', '<child link="foot"/>', "joint pitch names a link 'foot' that is not there"),
        (
            '<parent link="hand"/>',
            '<parent link="tool"/>',
            "hang on base, found a ring of mount, tool",
        ),
        ('<mass value="1.2"/>', '<mass value="-1"/>', "link forearm: expected a mass of at least 0 kg, got -1"),
        (
            '<mass value="1.2"/>',
            '<mass value="much"/>',
            "link forearm: <mass>: value expected a finite number, got 'much'",
        ),
        ('<mass value="1.2"/>', "", "link forearm: <inertial>: expected a <mass>, found none"),
        ('ixx="0.012"', "", "link \\w+: <inertia>: expected an attribute ixx, found none"),
        ('xyz="0 1 0.2"', 'xyz="0 0 0"', "joint elbow-bend: expected an axis, got one of length 0"),
        ('xyz="0 1 0.2"', 'xyz="0 1"', "joint elbow-bend: <axis>: xyz expected 3 numbers, got '0 1'"),
        ('ixx="0.012"', 'ixx="-0.1"', r"link \w+: expected principal moments of inertia of at least 0 kg m², got -0.1"),
        (
            '<link name="mount"/>',
            '<link name="tool"/>',
            "expected different names, got two links tool; rename one link",
        ),
        ("</robot>", '<loop_joint name="tie"/></robot>', "expected a tree, got <loop_joint> tie, which closes a loop"),
        ('name="reach"', 'name="roll"', "expected different names, got two joints roll; rename one joint"),
        ('<link name="mount"/>', '<link name="mount_${side}"/>', "got xacro, a template, in <link>; run xacro"),
        ('<link name="mount"/>', "<xacro:mount/>", "got xacro, a template; run xacro FILE > robot.urdf"),
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


XACRO = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (XACRO, "expected URDF, got xacro, a template, in <xacro:arm>; run xacro FILE"),
        ("<robot/>", "expected links, found none"),
        (
            '<robot><link name="a"/><link name="b"/>' + joint("j", "a", "b") + "</robot>",
            "expected links with an <inertial>, got none: a drawing; write the masses",
        ),
    ],
)
def test_files_that_are_not_ready_are_told(tmp_path, text, message):
    (tmp_path / "robot.urdf").write_text(text)
    with pytest.raises(ConfigError, match=message):
        urdf.read(tmp_path / "robot.urdf")


@pytest.mark.parametrize(
    ("kind", "mass", "message"),
    [
        (
            "revolute",
            1.0,
            "joint j2: expected a link b with inertia about its axis above 0, got 0; write its <inertial>",
        ),
        ("prismatic", 0.0, r"joint j2: expected a link b with mass above 0, got 0; .*, or lock=\('j2',\)"),
    ],
)
def test_a_joint_that_moves_no_mass_is_told(tmp_path, kind, mass, message):
    path = write(tmp_path, TWO[0], link("b", mass, 0.0, "0 0 0"), TWO[2], joint("j2", "a", "b", kind))
    with pytest.raises(ConfigError, match=message):
        urdf.read(path)
    assert len(urdf.read(path, lock=["j2"])) == 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<inertia ", "<moments ", "link b: <inertial>: expected a <inertia>, found none"),
        ('izz="0.01"', 'izz="x"', "link b: <inertia>: izz expected a finite number, got 'x'"),
        ('<origin xyz="0 0 0.2"/>', '<origin rpy="0 0"/>', "link b: <origin>: rpy expected 3 numbers, got '0 0'"),
        ('velocity="3" effort="10"', 'effort="ten"', "joint j2: <limit>: effort expected a finite number, got 'ten'"),
        ('<child link="b"/>', "<child/>", "joint j2: <child>: expected an attribute link, found none"),
        ('<axis xyz="0 1 0"/>', '<dynamics friction="-1"/>', "joint j2: expected a friction of at least 0, got -1"),
    ],
)
def test_a_fault_inside_a_link_or_a_joint_names_it(tmp_path, old, new, message):
    """The faulty one is the second of two that look alike."""
    path = write(tmp_path, *TWO)
    head, middle, tail = path.read_text().rpartition(old)
    text = head + new + tail.replace("</inertia>", "</moments>") if middle else ""
    path.write_text(text)
    with pytest.raises(ConfigError, match=f"robot.urdf: {message}"):
        urdf.read(path)


def test_dry_friction_is_left_out_and_said_once_for_all_joints_that_move(tmp_path, recwarn):
    rubbing = [f'<dynamics damping="1" friction="{friction}"/>' for friction in ("0.5", "2", "0")]
    joints = [joint(f"j{k}", "base" if k == 0 else f"l{k - 1}", f"l{k}", more=more) for k, more in enumerate(rubbing)]
    path = write(tmp_path, *(link(f"l{k}") for k in range(3)), *joints)
    with pytest.warns(UserWarning, match="robot.urdf: dry friction of j0, j1 left out; npred simulates") as said:
        rough = urdf.read(path)
    assert len(said) == 1
    path.write_text(path.read_text().replace("friction", "other"))
    assert [body.damping for body in rough] == [body.damping for body in urdf.read(path)] == [1.0] * 3
    assert not recwarn.list
    path.write_text(path.read_text().replace("other", "friction"))
    with pytest.warns(UserWarning, match="dry friction of j1 left out"):
        urdf.read(path, lock=["j0"])


def test_a_link_without_mass_between_two_joints_is_no_mistake(tmp_path):
    path = write(tmp_path, link("a", 0.0, 0.0), TWO[1], TWO[2], joint("j2", "a", "b", axis="1 0 0"))
    assert [body.mass for body in urdf.read(path)] == [0.0, 1.0]


@pytest.mark.parametrize(("first", "second", "name"), [("j-1", "j_1", "j_1"), ("j", "j_rate", "j_rate")])
def test_joints_that_make_one_name_are_told(tmp_path, first, second, name):
    path = write(tmp_path, *TWO[:2], joint(first, "base", "a"), joint(second, "a", "b"))
    with pytest.raises(
        ConfigError, match=f"robot.urdf: .* the joints {first} and {second} both make {name}; rename one"
    ):
        chain(path)


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


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-32"])
def test_no_entity_is_expanded_in_any_encoding(tmp_path, encoding):
    path = tmp_path / "wide.urdf"
    head = f'<?xml version="1.0" encoding="{encoding}"?><!DOCTYPE robot [<!ENTITY a "turned">]>'
    text = TEXT[TEXT.index("<robot") :].replace('name="turn"', 'name="&a;"')
    path.write_bytes((head + text).encode(encoding))
    with pytest.raises(ConfigError, match="expected a URDF file in UTF-8, got zero bytes"):
        urdf.read(path)


def test_only_a_regular_file_is_read_links_to_one_included(tmp_path):
    (tmp_path / "link.urdf").symlink_to(SIX)
    assert len(urdf.read(tmp_path / "link.urdf")) == 6
    (tmp_path / "loop.urdf").symlink_to("loop.urdf")
    os.mkfifo(tmp_path / "pipe.urdf")
    for name in ("pipe.urdf", "loop.urdf", "."):
        with pytest.raises(ConfigError, match=r"expected a URDF file of at most .*, got: a link, a folder or a device"):
            urdf.read(tmp_path / name)


def test_thousands_of_links_fixed_in_a_row_are_merged(tmp_path):
    """Each is 1 mm above the one before; the last has the mass."""
    count = 3000
    rows = ['<robot name="tower"><link name="base"/><joint name="turn" type="revolute"><parent link="base"/>']
    rows += ['<child link="l0"/></joint>', *(f'<link name="l{k}"/>' for k in range(count))]
    rise = '<origin xyz="0 0 0.001"/>'
    rows += [
        f'<joint name="j{k}" type="fixed">{rise}<parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(count)
    ]
    inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    rows += [f'<link name="l{count}"><inertial><mass value="2"/>{inertia}</inertial></link></robot>']
    (tmp_path / "tower.urdf").write_text("".join(rows))
    (body,) = urdf.read(tmp_path / "tower.urdf")
    assert body.mass == 2
    np.testing.assert_allclose(body.centre, [0, 0, 3])
