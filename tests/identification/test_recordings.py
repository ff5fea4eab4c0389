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
from npred.identification.recordings import csv

FORMATS = "csv, txt, tsv, mcap, bag, db3, ulg"


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,valve,level,empty\n0,1,2.5,\n1,,2.25,nan\n,3,7,\n3,inf,1,NaN\n")
    return path


def test_series_have_times_of_their_own_without_what_is_not_finite(table):
    series = recordings.read(table, ["level", "valve"])
    assert list(series) == ["level", "valve"]
    np.testing.assert_array_equal(series["level"].t, [0, 1, 3])
    np.testing.assert_array_equal(series["level"].values, [2.5, 2.25, 1])
    np.testing.assert_array_equal(series["valve"].t, [0])
    assert recordings.columns(table) == ["t", "valve", "level", "empty"]


@pytest.mark.parametrize(
    ("name", "names", "words"),
    [
        ("none.csv", ["level"], "none.csv: expected a recording, found no file; check the path"),
        ("log.xyz", ["level"], f"log.xyz: expected a file that ends in {FORMATS}, got 'xyz'"),
        ("log", ["level"], f"log: expected a file that ends in {FORMATS}, got ''; convert it"),
        ("log.csv", ["vlave"], "log.csv: expected the name of a column with numbers, got 'vlave'; did you mean valve"),
        ("log.csv", ["q"], "got 'q'; choose one of t, valve, level, empty"),
        ("log.csv", ["empty"], "log.csv: expected numbers in empty, got empty cells or NaN alone; name another column"),
    ],
)
def test_what_cannot_be_read_is_one_line(table, name, names, words):
    for other in ("log.xyz", "log"):
        table.with_name(other).write_text("t,level\n0,1\n")
    with pytest.raises(ConfigError) as refusal:
        recordings.read(table.with_name(name), names)
    assert words in str(refusal.value) and "\n" not in str(refusal.value)


def test_numbers_without_a_time_are_not_called_empty(tmp_path):
    (tmp_path / "log.csv").write_text("t,level\n,1\n,2\n")
    with pytest.raises(ConfigError, match="expected numbers in level, got numbers without a time"):
        recordings.read(tmp_path / "log.csv", ["level"])


def test_an_unknown_unit_is_refused(table):
    with pytest.raises(ConfigError, match=r"time_unit: expected one of s, ms, us, µs, ns, min, h, got 'days'"):
        recordings.read(table, ["level"], time_unit="days")


def test_suffixes_are_found_in_capitals(table):
    table.rename(table.with_name("LOG.CSV"))
    assert recordings.columns(table.with_name("LOG.CSV"))[0] == "t"


def test_the_formats_that_read_text_need_no_package():
    assert {name for name in registry.RECORDINGS.names() if registry.RECORDINGS.load("recording", name) is csv.Csv} == {
        "csv", "txt", "tsv",
    }  # fmt: skip


def test_without_the_package_of_a_format_it_is_asked_for(table):
    suffixes = {"mcap": "mcap", "bag": "rosbag", "db3": "rosbag", "ulg": "ulog"}  # and the extra of each
    program = (
        "import without_extras, pathlib\nfrom npred.base import errors\nfrom npred.identification import recordings\n"
        f"for suffix in {list(suffixes)}:\n    path = pathlib.Path(f'log.{{suffix}}')\n    path.touch()\n"
        "    try:\n        recordings.columns(path)\n    except errors.MissingError as error:\n        print(error)\n"
        "print(recordings.columns(pathlib.Path('log.csv'))[0])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=table.parent, env=process_environment(), capture_output=True, text=True
    )
    *lines, first = done.stdout.splitlines()
    assert (first, done.stderr) == ("t", "")
    for line, (suffix, extra) in zip(lines, suffixes.items(), strict=True):
        assert line.startswith(f"recording {suffix}: expected the package ")
        assert line.endswith(f", found none; pip install 'npred[{extra}]'")


def test_a_package_brings_a_format(package, tmp_path):
    text = (
        "import numpy as np\nfrom npred.identification.recordings import TimeSeries\n"
        "class Log:\n    def __init__(self, path):\n        self.path = path\n"
        "    def columns(self):\n        return ['q']\n"
        "    def series(self, names, time, unit):\n"
        "        return {name: TimeSeries(np.arange(2.0), np.ones(2)) for name in names}\n"
    )
    package("abc = shed_of_tanks:Log", text, group="npred.identification.recordings")
    (tmp_path / "log.abc").write_bytes(b"")
    assert recordings.columns(tmp_path / "log.abc") == ["q"]
    assert recordings.read(tmp_path / "log.abc", ["q"])["q"].values.tolist() == [1, 1]


def test_failures_of_a_decoder_are_one_line():
    with (
        pytest.raises(ConfigError, match=r"^a.bag: expected a bag, got: first; check the file$"),
        recordings.decoding(Path("a.bag"), "a bag"),
    ):
        raise RuntimeError("first\nsecond")
