"""MCAP: messages as JSON and of ROS 2, their fields and times, files without an index, encodings that are not read."""

import json
import sys

import pytest

from npred.base.errors import ConfigError, MissingError
from npred.identification import recordings

pytest.importorskip("mcap")
from mcap.writer import CompressionType, IndexType, Writer

START = 1_700_000_000_000_000_000  # ns
HEADER = "std_msgs/Header header\nfloat64[] position\nfloat64[2] effort\nstring frame\nbool on\n" + (
    "=" * 80 + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    + "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)  # fmt: skip


def write(path, messages, encoding="json", **options):
    """A file of messages (topic, time of the log after START in ns, value)."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start()
        channels = {}
        for topic, time, value in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, encoding, 0)
            writer.add_message(channels[topic], START + time, json.dumps(value).encode(), START + time)
        writer.finish()
    return path


def values(path, name, **options):
    t, column, _ = recordings.read(path, [name], **options).series[name]
    return t.tolist(), column.tolist()


def stamped(ns, **fields):
    return {"header": {"stamp": {"sec": (START + ns) // 10**9, "nanosec": (START + ns) % 10**9}}} | fields


@pytest.fixture
def log(tmp_path):
    messages = [
        ("/cmd", 0, {"q": 1.5, "mode": "auto", "on": True}),
        ("/state", 10_000_000, stamped(5_000_000, h=[0.25, {"x": 7}])),
        ("/cmd", 500_000_000, {"q": 2}),
        ("/state", 510_000_000, stamped(495_000_000, h=[0.5, {"x": None}])),
        ("/state", 710_000_000, stamped(705_000_000, h=[])),
    ]
    return write(tmp_path / "log.mcap", messages)


def test_fields_are_read_at_their_stamps_or_at_the_times_of_the_log(log):
    assert values(log, "/cmd.q") == ([0, 0.5], [1.5, 2])
    assert values(log, "/cmd.on") == ([0], [1])
    assert values(log, "/state.h[0]") == (pytest.approx([0.005, 0.495], rel=1e-12), [0.25, 0.5])
    assert values(log, "/state.h[1].x") == (pytest.approx([0.005], rel=1e-12), [7])
    assert values(log, "/state.h[0]", time="log") == (pytest.approx([0.01, 0.51], rel=1e-12), [0.25, 0.5])
    both = recordings.read(log, ["/cmd.q", "/state.h[0]"]).series
    assert both["/cmd.q"].values.tolist() == [1.5, 2] and both["/state.h[0]"].values.tolist() == [0.25, 0.5]
    stamp = ["/state.header.stamp.sec", "/state.header.stamp.nanosec"]
    assert recordings.opened(log).columns() == ["/cmd.q", "/cmd.on", *stamp, "/state.h[0]", "/state.h[1].x"]


@pytest.mark.parametrize(
    "options",
    [{"index_types": IndexType.NONE, "use_statistics": False}, {"use_chunking": False}],
    ids=["no index", "no chunks"],
)
def test_a_file_without_an_index_is_read_as_a_whole(tmp_path, options):
    path = write(tmp_path / "log.mcap", [("/cmd", k * 10**9, {"q": k}) for k in range(5)], **options)
    assert values(path, "/cmd.q") == (pytest.approx([0, 1, 2, 3, 4]), [0, 1, 2, 3, 4])
    assert recordings.opened(path).columns() == ["/cmd.q"]


@pytest.mark.parametrize(
    "key", [("timestamp", "sec", "nsec"), ("header.stamp", "secs", "nsecs"), ("header.stamp", "sec", "nanosec")]
)
def test_stamps_have_several_spellings(tmp_path, key):
    def message(ns):
        stamp = {key[1]: (START + ns) // 10**9, key[2]: (START + ns) % 10**9}
        return {"q": 1, **({"timestamp": stamp} if key[0] == "timestamp" else {"header": {"stamp": stamp}})}

    path = write(tmp_path / "log.mcap", [("/cmd", 10**9 * k, message(10**9 * k + 250_000_000)) for k in range(3)])
    assert values(path, "/cmd.q")[0] == pytest.approx([0.25, 1.25, 2.25], rel=1e-12)


def test_stamps_of_zero_are_none(tmp_path):
    zero = {"header": {"stamp": {"sec": 0, "nanosec": 0}}, "q": 1}
    path = write(tmp_path / "log.mcap", [("/cmd", 0, zero), ("/cmd", 10**9, zero)])
    assert values(path, "/cmd.q")[0] == [0, 1]


def test_times_are_of_one_clock(tmp_path):
    """Stamps of a simulation begin at zero; the log has the time of day."""
    simulated = [{"header": {"stamp": {"sec": 3 + k, "nanosec": 0}}, "x": k} for k in range(3)]
    messages = [("/state", k * 10**9, message) for k, message in enumerate(simulated)]
    path = write(tmp_path / "log.mcap", [*messages, ("/cmd", 10**9, {"q": 1}), ("/cmd", 2 * 10**9, {"q": 2})])
    assert values(path, "/state.x")[0] == [0, 1, 2]
    with pytest.raises(ConfigError, match=r"expected times of one clock, got stamps of /state .*; give --time log"):
        recordings.read(path, ["/state.x", "/cmd.q"])
    both = recordings.read(path, ["/state.x", "/cmd.q"], time="log").series
    assert both["/cmd.q"].t.tolist() == [1, 2] and both["/state.x"].t.tolist() == [0, 1, 2]


def test_times_may_be_a_field(tmp_path):
    path = write(tmp_path / "log.mcap", [("/cmd", k, {"clock": {"ms": 20 * k}, "q": k}) for k in range(3)])
    assert values(path, "/cmd.q", time="clock.ms", time_unit="ms")[0] == pytest.approx([0, 0.02, 0.04])
    assert values(path, "/cmd.q", time="clock.ms", unit="min")[0] == [0, 20, 40]
    with pytest.raises(ConfigError, match=r"expected numbers in /cmd.q, got numbers without a time"):
        recordings.read(path, ["/cmd.q"], time="nothing")


def test_times_are_in_the_unit_of_the_plant_and_their_source_is_said(log):
    assert values(log, "/cmd.q", unit="min") == ([0, 0.5 / 60], [1.5, 2])
    assert recordings.read(log, ["/cmd.q"], unit="min").notes == [
        "log.mcap: 2 messages; times from the stamps of the messages, else of the log, in min."
    ]
    assert recordings.read(log, ["/state.h[0]", "/cmd.q"]).series["/state.h[0]"].rows.tolist() == [1, 2]
    with pytest.raises(ConfigError, match=r"expected a plant with a time_unit .* got 'periods'"):
        recordings.read(log, ["/cmd.q"], unit="periods")
    with pytest.raises(ConfigError, match=r"period: expected none for .*, whose messages have times, got 0.1; drop it"):
        recordings.read(log, ["/cmd.q"], period=0.1)


def test_the_longest_topic_counts(tmp_path):
    path = write(tmp_path / "log.mcap", [("a", 0, {"b": {"q": 1}}), ("a.b", 1, {"q": 2}), ("value", 2, 3.5)])
    assert values(path, "a.b.q")[1] == [2]
    assert values(path, "value")[1] == [3.5]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("/cmd.w", "got '/cmd.w'; did you mean /cmd.q or /cmd.on?"),
        ("/cmd.mode", "got '/cmd.mode'; did you mean"),
        ("/cmd", "got '/cmd'; did you mean /cmd.q"),
        ("/state.h", "got '/state.h'; did you mean /state.h[0]"),
        ("/state.h[9]", "got '/state.h[9]'; did you mean /state.h[0]"),
        ("nothing", "got 'nothing'; choose one of /cmd.q, /cmd.on"),
    ],
)
def test_a_name_without_numbers_is_refused_with_those_that_have_some(log, name, words):
    with pytest.raises(ConfigError) as refusal:
        recordings.read(log, [name])
    assert f"{log}: expected the name of a column with numbers, {words}" in str(refusal.value)


def test_other_encodings_are_refused_and_hide_no_other_topic(tmp_path):
    path = write(tmp_path / "log.mcap", [("/cmd", 0, {"q": 1})], encoding="protobuf")
    words = "expected messages as JSON or of ROS 2 \\(CDR\\), got protobuf with the schema none; convert them"
    with pytest.raises(ConfigError, match=words):
        recordings.read(path, ["/cmd.q"])
    assert recordings.opened(path).columns() == []


def test_what_is_no_mcap_is_refused_in_one_line(tmp_path, log):
    (tmp_path / "text.mcap").write_text("t,q\n0,1\n")
    (tmp_path / "cut.mcap").write_bytes(log.read_bytes()[:-40])
    (tmp_path / "empty.mcap").write_bytes(b"")
    for name in ("text", "cut", "empty"):
        with pytest.raises(ConfigError, match=r": expected an MCAP file, got: .+; check the file$"):
            recordings.read(tmp_path / f"{name}.mcap", ["/cmd.q"])


def test_a_damaged_number_is_refused(tmp_path):
    path = write(tmp_path / "log.mcap", [("/cmd", 0, {"q": 1.5})], compression=CompressionType.NONE)
    path.write_bytes(path.read_bytes().replace(b"1.5", b"7.5"))
    with pytest.raises(ConfigError, match=r"expected an MCAP file, got: .*crc.*; check the file"):
        recordings.read(path, ["/cmd.q"])


def test_messages_of_ros2(tmp_path, monkeypatch):
    writing = pytest.importorskip("mcap_ros2.writer")
    with (tmp_path / "log.mcap").open("wb") as file, writing.Writer(file) as writer:
        schema = writer.register_msgdef("my_msgs/msg/Joints", HEADER)
        for k in range(3):
            ns = START + 10**8 * k
            stamp = {"sec": ns // 10**9, "nanosec": ns % 10**9}
            header = {"stamp": stamp, "frame_id": "base"}
            message = {"header": header, "position": [k, 2.0], "effort": [0.5, -k], "frame": "f", "on": True}
            writer.write_message("/joints", schema, message, log_time=ns + 3_000_000)
    assert values(tmp_path / "log.mcap", "/joints.effort[1]") == (pytest.approx([-0.003, 0.097, 0.197]), [0, -1, -2])
    assert recordings.opened(tmp_path / "log.mcap").columns()[2:] == [
        "/joints.position[0]", "/joints.position[1]", "/joints.effort[0]", "/joints.effort[1]", "/joints.on",
    ]  # fmt: skip
    monkeypatch.setitem(sys.modules, "mcap_ros2.decoder", None)  # as if it were not installed
    with pytest.raises(MissingError, match=r"expected the package mcap-ros2-support, .* pip install 'npred\[mcap\]'"):
        recordings.read(tmp_path / "log.mcap", ["/joints.effort[1]"])
