"""Bags of ROS 1 and ROS 2, written and read."""

import shutil

import numpy as np
import pytest

from npred.base.errors import ConfigError
from npred.identification import recordings

pytest.importorskip("rosbags")
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

START = 1_700_000_000_000_000_000  # ns


def write(path, writer, store, serialize, **more):
    """Three messages of a joint with a stamp 2 ms before the log, and three of a number without one."""
    types = store.types
    with writer as bag:
        joints = bag.add_connection("/joints", "sensor_msgs/msg/JointState", typestore=store)
        number = bag.add_connection("/cmd", "std_msgs/msg/Float64", typestore=store)
        for k in range(3):
            ns = START + k * 10**8
            sec, nanosec = divmod(ns - 2_000_000, 10**9)
            stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **more)
            arrays = {key: np.array([k, 10.0 * k]) for key in ("position", "velocity", "effort")}
            message = types["sensor_msgs/msg/JointState"](header=header, name=["a", "b"], **arrays)
            bag.write(joints, ns, serialize(message, "sensor_msgs/msg/JointState"))
            bag.write(number, ns, serialize(types["std_msgs/msg/Float64"](data=0.5 * k), "std_msgs/msg/Float64"))
    return path


@pytest.fixture
def ros1(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)
    return write(tmp_path / "log.bag", rosbag1.Writer(tmp_path / "log.bag"), store, store.serialize_ros1, seq=0)


@pytest.fixture
def ros2(tmp_path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    return write(tmp_path / "log", rosbag2.Writer(tmp_path / "log", version=8), store, store.serialize_cdr)


@pytest.mark.parametrize("kind", ["ros1", "ros2"])
def test_both_kinds_of_bags_are_read(request, kind):
    bag = request.getfixturevalue(kind)
    series = recordings.read(bag, ["/joints.position[1]", "/cmd.data"]).series
    assert series["/joints.position[1]"].t == pytest.approx([-0.002, 0.098, 0.198], rel=1e-12)
    assert series["/joints.position[1]"].values.tolist() == [0, 10, 20]
    assert series["/cmd.data"].t == pytest.approx([0, 0.1, 0.2], rel=1e-12)
    assert series["/cmd.data"].values.tolist() == [0, 0.5, 1]
    names = recordings.opened(bag).columns()
    assert {"/cmd.data", "/joints.velocity[0]", "/joints.header.stamp.sec"} <= set(names)
    assert not [name for name in names if "frame_id" in name or "msgtype" in name]


def test_a_db3_file_stands_for_its_folder(ros2):
    (file,) = ros2.glob("*.db3")
    assert recordings.read(file, ["/cmd.data"]).series["/cmd.data"].values.tolist() == [0, 0.5, 1]


def test_names_that_a_bag_lacks_are_refused(ros1):
    with pytest.raises(ConfigError, match=r"got '/cmd.date'; did you mean /cmd.data"):
        recordings.read(ros1, ["/cmd.date"])


def test_what_is_no_bag_is_refused_in_one_line(tmp_path, ros2):
    (tmp_path / "text.bag").write_text("t,q\n")
    shutil.copytree(ros2, tmp_path / "cut")
    next((tmp_path / "cut").glob("*.db3")).write_bytes(b"no database")
    for name in ("text.bag", "cut"):
        with pytest.raises(ConfigError, match=r": expected a bag of ROS, got: .+; check the file$"):
            recordings.read(tmp_path / name, ["/cmd.data"])
