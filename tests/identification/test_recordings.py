"""Recordings by their suffix: what cannot be opened or has no numbers is refused in one line."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import process_environment

from npred.base import registry
from npred.base.errors import ConfigError
from npred.identification import recordings
from npred.identification.recordings.arrays import Hdf5, Json, Mat
from npred.identification.recordings.text import Text


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,valve,level,empty\n0,1,2.5,\n1,,2.25,nan\n,3,7,\n3,inf,1,NaN\n")
    return path


def test_series_have_times_of_their_own_without_what_is_not_finite(table):
    series = recordings.read(table, ["level", "valve"]).series
    assert list(series) == ["level", "valve"]
    np.testing.assert_array_equal(series["level"].t, [0, 1, 3])
    np.testing.assert_array_equal(series["level"].values, [2.5, 2.25, 1])
    np.testing.assert_array_equal(series["valve"].t, [0])
    assert recordings.opened(table).columns() == ["t", "valve", "level", "empty"]


@pytest.mark.parametrize(
    ("name", "names", "words"),
    [
        ("none.csv", ["level"], "none.csv: expected a recording, found no file; check the path"),
        ("photo.png", ["level"], "photo.png: expected a table of text, got bytes of another kind; save it as CSV"),
        ("log.csv", ["vlave"], "log.csv: expected the name of a column with numbers, got 'vlave'; did you mean valve"),
        ("log.csv", ["q"], "got 'q'; choose one of t, valve, level, empty"),
        ("log.csv", ["empty"], "log.csv: expected numbers in empty, got empty cells or NaN alone; name another column"),
    ],
)
def test_what_cannot_be_read_is_one_line(table, name, names, words):
    table.with_name("photo.png").write_bytes(bytes(range(32)))
    with pytest.raises(ConfigError) as refusal:
        recordings.read(table.with_name(name), names)
    assert words in str(refusal.value) and "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("log.csv.zip", "expected a table of text, got bytes of another kind; unpack it, and name the file in it"),
        ("log.pkl", "it may run code when it is read; save it as Parquet or CSV"),
        ("log.mf4", "export its signals as .mat or CSV"),
        ("log.tdms", "export its channels as CSV"),
        ("folder", "expected a folder with metadata.yaml, as a bag of ROS 2, or with .parquet files"),
    ],
)
def test_what_is_not_read_is_named_with_the_next_step(tmp_path, name, words):
    path = tmp_path / name
    path.mkdir() if "." not in name else path.write_bytes(b"PK\x03\x04 or another head")
    with pytest.raises(ConfigError, match=words):
        recordings.opened(path)


def test_numbers_without_a_time_are_not_called_empty(tmp_path):
    (tmp_path / "log.csv").write_text("t,level\n,1\n,2\n")
    with pytest.raises(ConfigError, match="expected numbers in level, got numbers without a time"):
        recordings.read(tmp_path / "log.csv", ["level"])


def test_an_unknown_unit_is_refused(table):
    with pytest.raises(ConfigError, match=r"time_unit: expected one of s, ms, us, µs, ns, min, h, d, got 'weeks'"):
        recordings.read(table, ["level"], time_unit="weeks")


def test_suffixes_are_found_in_capitals(table):
    table.rename(table.with_name("LOG.CSV"))
    assert recordings.opened(table.with_name("LOG.CSV")).columns()[0] == "t"


def test_the_formats_of_tables():
    classes = {name: registry.RECORDINGS.load("recording", name) for name in registry.RECORDINGS.names()}
    assert {name for name, kind in classes.items() if kind is Text} == {
        "csv", "txt", "tsv", "dat", "asc", "log", "lvm", "trace",
    }  # fmt: skip
    assert classes["mat"] is Mat and classes["json"] is classes["jsonl"] is Json and classes["h5"] is Hdf5


def test_without_the_package_of_a_format_it_is_asked_for(table):
    suffixes = dict.fromkeys(("csv", "json", "mat", "parquet", "xlsx", "npz", "h5"), "identify")
    suffixes |= {"mcap": "mcap", "bag": "rosbag", "db3": "rosbag", "ulg": "ulog"}  # and the extra of each
    program = (
        "import without_extras, pathlib\nfrom npred.base import errors\nfrom npred.identification import recordings\n"
        f"for suffix in {list(suffixes)}:\n    path = pathlib.Path(f'log.{{suffix}}')\n    path.touch()\n"
        "    try:\n        recordings.opened(path)\n    except errors.MissingError as error:\n        print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=table.parent, env=process_environment(), capture_output=True, text=True
    )
    assert done.stderr == ""
    for line, (suffix, extra) in zip(done.stdout.splitlines(), suffixes.items(), strict=True):
        assert line.startswith(f"recording {suffix}: expected the package ")
        assert line.endswith(f", found none; pip install 'npred[{extra}]'")


def test_a_package_brings_a_format(package, tmp_path):
    text = (
        "import numpy as np\nfrom npred.identification.recordings import Contents, TimeSeries\n"
        "class Log:\n    def __init__(self, path):\n        self.path = path\n"
        "    def columns(self):\n        return ['q']\n"
        "    def contents(self, names, source):\n"
        "        series = TimeSeries(np.arange(2.0), np.ones(2), np.arange(1, 3))\n"
        "        return Contents(dict.fromkeys(names, series), [f'{source.period} {source.unit}'])\n"
    )
    package("abc = shed_of_tanks:Log", text, group="npred.recordings")
    (tmp_path / "log.abc").write_bytes(b"")
    assert recordings.opened(tmp_path / "log.abc").columns() == ["q"]
    read = recordings.read(tmp_path / "log.abc", ["q"], period=2.0, unit="h")
    assert read.series["q"].values.tolist() == [1, 1] and read.notes == ["2.0 h"]


def test_failures_of_a_decoder_are_one_line():
    with (
        pytest.raises(ConfigError, match=r"^a.bag: expected a bag, got: first; check the file$"),
        recordings.decoding(Path("a.bag"), "a bag"),
    ):
        raise RuntimeError("first\nsecond")
