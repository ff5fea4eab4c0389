"""ULog of PX4: a file of the few structures that its specification needs, read back."""

import struct

import pytest

from npred.base.errors import ConfigError
from npred.identification import recordings

pytest.importorskip("pyulog")
START = 5_000_000  # µs


def message(kind, data):
    return struct.pack("<HB", len(data), ord(kind)) + data


@pytest.fixture
def log(tmp_path):
    """Two instances of a topic with an array, one of them with a time of sampling 3 ms before."""
    fields = b"uint64_t timestamp;uint64_t timestamp_sample;float[2] xyz;uint8_t on;uint8_t[3] _padding0;"
    text = message("B", bytes(40)) + message("F", b"rates:" + fields)
    text += message("A", struct.pack("<BH", 0, 0) + b"rates") + message("A", struct.pack("<BH", 1, 1) + b"rates")
    for k in range(4):
        for instance in (0, 1):
            stamp = START + 20_000 * k + 1000
            row = struct.pack("<QQffB", stamp, stamp - 3000, 0.5 * k, float("nan") if k == 2 else -k, k % 2)
            text += message("D", struct.pack("<H", instance) + row)  # without the padding at the end
    path = tmp_path / "log.ulg"
    path.write_bytes(b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", START) + text)
    return path


def test_fields_of_every_instance_are_read(log):
    series = recordings.read(log, ["rates.xyz[0]", "rates[1].xyz[1]", "rates.on"]).series
    assert series["rates.xyz[0]"].t == pytest.approx([0.001, 0.021, 0.041, 0.061])
    assert series["rates.xyz[0]"].values.tolist() == [0, 0.5, 1, 1.5]
    assert series["rates[1].xyz[1]"].t == pytest.approx([0.001, 0.021, 0.061])
    assert series["rates[1].xyz[1]"].values.tolist() == [0, -1, -3]
    assert series["rates.on"].values.tolist() == [0, 1, 0, 1]
    fields = ["timestamp", "timestamp_sample", "xyz[0]", "xyz[1]", "on"]
    assert recordings.opened(log).columns() == [
        f"{topic}.{field}" for topic in ("rates", "rates[1]") for field in fields
    ]


def test_times_may_be_another_field(log):
    t = recordings.read(log, ["rates.on"], time="timestamp_sample", time_unit="us").series["rates.on"].t
    assert t == pytest.approx([4.998, 5.018, 5.038, 5.058])


def test_times_are_in_the_unit_of_the_plant_and_their_source_is_said(log):
    read = recordings.read(log, ["rates.on"], unit="ms")
    assert read.series["rates.on"].t == pytest.approx([1, 21, 41, 61])
    assert read.series["rates.on"].rows.tolist() == [1, 2, 3, 4]
    assert read.notes == ["log.ulg: 4 messages; times from timestamp in us, in ms."]
    with pytest.raises(ConfigError, match=r"period: expected none for .*log.ulg"):
        recordings.read(log, ["rates.on"], period=1)


@pytest.mark.parametrize("name", ["rates.xyz", "rate.on", "rates[2].on"])
def test_names_that_a_log_lacks_are_refused(log, name):
    with pytest.raises(ConfigError, match=r"expected the name of a column with numbers, got .+; did you mean rates"):
        recordings.read(log, [name])


def test_what_is_no_ulog_is_refused_in_one_line_and_prints_nothing(tmp_path, capsys):
    (tmp_path / "log.ulg").write_text("t,q\n")
    with pytest.raises(ConfigError, match=r": expected a ULog file, got: Invalid file format.*; check the file$"):
        recordings.read(tmp_path / "log.ulg", ["rates.on"])
    assert capsys.readouterr().out == ""


def test_a_damaged_log_is_read_as_far_as_it_goes_and_prints_nothing(log, capsys):
    whole = log.read_bytes()
    log.write_bytes(whole[:-5])
    assert recordings.read(log, ["rates[1].on"]).series["rates[1].on"].values.tolist() == [0, 1, 0]
    log.write_bytes(whole + message("D", struct.pack("<H", 9) + bytes(25)))  # of no topic
    assert recordings.read(log, ["rates[1].on"]).series["rates[1].on"].values.tolist() == [0, 1, 0, 1]
    assert capsys.readouterr().out == ""


def test_a_topic_without_times_is_refused(log):
    log.write_bytes(log.read_bytes().replace(b"timestamp;", b"timestomp;"))
    with pytest.raises(ConfigError, match=r"got 'rates.timestamp'; did you mean rates.timestomp"):
        recordings.read(log, ["rates.on"])
