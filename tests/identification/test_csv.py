"""Tables of text as loggers write them: separators, commas, units, gaps, stamps; faults name their line."""

import csv
import io
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from npred.base.errors import ConfigError
from npred.identification import recordings


@pytest.fixture
def write(tmp_path):
    def write(text, name="log.csv", encoding="utf-8"):
        (tmp_path / name).write_bytes(text.encode(encoding))
        return tmp_path / name

    return write


def values(path, name, **options):
    t, column = recordings.read(path, [name], **options)[name]
    return t.tolist(), column.tolist()


@pytest.mark.parametrize(
    "text",
    [
        "t,q\n0,1.5\n0.5,2\n",
        "t;q\n0;1,5\n0,5;2\n",
        "t\tq\n0\t1,5\n0.5\t2\n",
        "\ufefft,q\r\n0,1.5\r\n0.5,2\r\n",
        "t,q\r0,1.5\r0.5,2\r",
        "# a logger\n\n  # of 2024, \"as it is\n't', q\n".replace("'t'", '"t"') + "0, 1.5\n# a pause\n\n0.5, 2\n,\n",
        "t,q,\n0,1.5,\n0.5,2,\n",
        "t,q\n0,1.5,,\n0.5,2\n",
        "# t,q\n0,1.5\n0.5,2\n",
        "t [s],q (m^3/s)\n0,1.5\n0.5,2\n",
        "q,t\n1.5,0\n2.0e0,+.5\n",
    ],
    ids=["comma", "semicolon", "tab", "BOM and CRLF", "CR", "comments", "a last separator", "empty cells behind",
         "header of np.savetxt", "units", "another order"],
)  # fmt: skip
def test_tables_of_different_loggers_have_the_same_numbers(write, text):
    assert values(write(text), "q") == ([0, 0.5], [1.5, 2])


def test_names_come_without_units_which_are_kept(write):
    path = write("t [ms],T1 [K],T2(K),q[0],q[1],p [bar],p [Pa],T [1]\n" + "1,2,3,4,5,6,7,8\n")
    table = recordings.opened(path)
    assert table.columns() == ["t", "T1", "T2", "q[0]", "q[1]", "p [bar]", "p [Pa]", "T [1]"]
    assert table.units == {"t": "ms", "T1": "K", "T2": "K"}
    assert values(path, "T1 [K]") == values(path, "T1") == ([0.001], [2])
    assert values(path, "p [Pa]") == ([0.001], [7])


@pytest.mark.parametrize(
    ("unit", "factor"), [("s", 1), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9), ("min", 60), ("h", 3600)]
)
def test_times_are_in_seconds(write, unit, factor):
    expected = pytest.approx([3 * factor, 7 * factor], rel=1e-15)
    assert values(write("t,q\n3,1\n7,2\n"), "q", time_unit=unit)[0] == expected
    assert values(write(f"t [{unit}],q\n3,1\n7,2\n"), "q")[0] == expected
    assert values(write("t [h],q\n3,1\n7,2\n"), "q", time_unit=unit)[0] == expected  # what is asked for counts


def test_times_stay_in_the_order_of_the_file(write):
    assert values(write("t,q\n2,1\n0,2\n2,3\n-1,4\n"), "q") == ([2, 0, 2, -1], [1, 2, 3, 4])


@pytest.mark.parametrize("name", ["t", "time", "Time", "timestamp", "stamp"])
def test_the_column_of_times_is_found_or_named(write, name):
    assert values(write(f"q,T,{name}\n1,5,2\n3,5,4\n"), "q") == ([2, 4], [1, 3])
    assert values(write(f"q,clock,{name}\n1,5,2\n3,6,4\n"), "q", time="clock") == ([5, 6], [1, 3])


@pytest.mark.parametrize(
    "stamps",
    [
        ["2024-05-01T12:00:00", "2024-05-01T12:00:00.250", "2024-05-02T12:00:00"],
        ["2024-05-01 12:00:00Z", "2024-05-01 14:00:00.25+02:00", "2024-05-02 12:00:00Z"],
        ["20240501T120000", "20240501T120000.250000", "20240502T120000"],
    ],
)
def test_stamps_are_seconds_from_the_first_row(write, stamps):
    rows = "".join(f"{stamp},{k}\n" for k, stamp in enumerate(stamps))
    assert values(write("time,q\n" + rows + ",9\n"), "q") == ([0, 0.25, 86400], [0, 1, 2])


def test_empty_cells_and_words_for_nothing_are_left_out(write):
    cells = ["1", "", "nan", " NaN ", "NA", "n/a", "null", "None", '""', "2"]
    text = "t,q\n" + "".join(f"{k},{cell}\n" for k, cell in enumerate(cells))
    assert values(write(text), "q") == ([0, 9], [1, 2])


def test_switches_are_numbers(write):
    assert values(write("t,on\n0,true\n1,False\n2,TRUE\n"), "on") == ([0, 1, 2], [1, 0, 1])


def test_a_file_of_another_encoding_is_read(write):
    assert values(write("t,T [°C]\n0,20\n1,21\n", encoding="latin-1"), "T") == ([0, 1], [20, 21])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "log.csv: expected a header line and rows, got an empty file; check the path"),
        ("# only this\n\n", "log.csv: expected a header line and rows, got an empty file"),
        ("t q\n0 1\n", "log.csv:1: expected names between commas, semicolons or tabs, got 't q'; edit that line"),
        ("\n0,1\n1,2\n", "log.csv:2: expected a header line with the names of the columns, got '0,1'; edit that line"),
        ("t,q\n", "log.csv: expected numbers in q, got no rows"),
        ("t,q\n0,1\n# so\n1,2 K\n", "log.csv:4: expected a number in column q, got '2 K'; edit that line"),
        ("t,q\n0,1\n\n1,\"2,5\"\n", "log.csv:4: expected a number in column q, got '2,5'; edit that line"),
        ("t;q\n0;1.234,5\n", "log.csv:2: expected a number in column q, got '1.234,5'; edit that line"),
        ("t,q\n0,1\n1\n", "log.csv:3: expected 2 cells as in the header, got '1'; edit that line"),
        ("t,q\n0,1,2\n", "log.csv:2: expected 2 cells as in the header, got '3'; edit that line"),
        ("t,q\n,0\nnoon,1\n", "log.csv:3: expected a number or an ISO 8601 stamp in column t, got 'noon'; edit"),
        ("t,q\n2024-05-01,1\n2024-05-01T01:00Z,2\n", "log.csv:3: expected a stamp as 2024-05-01T12:00:00.5, all alike, "
         "in column t, got '2024-05-01T01:00Z'; edit that line"),
        ("t,q\n2024-05-01,1\n3,2\n", "log.csv:3: expected a stamp"),
        ("clock,q\n0,1\n", "log.csv: expected a column of times (t, time, Time, timestamp, Timestamp, stamp), got "
         "clock, q; name it by --time"),
        ("t [days],q\n0,1\n", "log.csv: expected a unit of time in the header, one of s, ms, us, µs, ns, min, h, got "
         "'days'; name it by --time-unit"),
        ("t,q,q\n0,1,2\n", "log.csv: expected one column q, got 2; rename them in the header"),
        ("t,q\n0,\"" + "x" * 200_000, "log.csv:2: expected a row of a table, got 'field larger than field limit"),
    ],
)  # fmt: skip
def test_a_fault_is_one_line_with_its_place(write, text, words):
    with pytest.raises(ConfigError) as refusal:
        recordings.read(write(text), ["q"])
    assert words in str(refusal.value) and "\n" not in str(refusal.value)


def test_a_column_of_text_hinders_no_other(write):
    assert values(write("t,mode,q\n0,manual,1\n1,auto,2\n"), "q") == ([0, 1], [1, 2])


NAMES = st.text("abTq_α /,;\"'#|.-0", min_size=1, max_size=8).map(str.strip).filter(lambda name: name not in ("", "t"))
CELLS = st.one_of(st.none(), st.floats(allow_infinity=False), st.floats(-1e3, 1e3))


@given(st.data(), st.lists(NAMES, min_size=1, max_size=5, unique=True), st.sampled_from(",;\t"), st.booleans(),
       st.sampled_from(["\n", "\r\n"]), st.sampled_from(["utf-8", "utf-8-sig"]))  # fmt: skip
def test_what_is_written_is_read(tmp_path_factory, data, names, separator, comma, end, encoding):
    rows = data.draw(st.lists(st.tuples(st.floats(-1e9, 1e9), *[CELLS] * len(names)), min_size=1, max_size=8))
    stream = io.StringIO(newline="")
    csv.writer(stream, delimiter=separator, quoting=csv.QUOTE_ALL, lineterminator=end).writerow(["t", *names])
    for row in rows:
        text = separator.join("" if cell is None else repr(cell) for cell in row)
        stream.write((text.replace(".", ",") if comma and separator != "," else text) + end)
    path = tmp_path_factory.mktemp("table") / "log.csv"
    path.write_bytes(stream.getvalue().encode(encoding))
    assert recordings.columns(path) == ["t", *names]
    for k, name in enumerate(names, 1):
        kept = [(row[0], row[k]) for row in rows if row[k] is not None and not math.isnan(row[k])]
        if not kept:
            with pytest.raises(ConfigError, match="empty cells or NaN alone"):
                recordings.read(path, [name])
            continue
        np.testing.assert_array_equal(np.transpose(recordings.read(path, [name])[name]), kept)


@given(
    st.binary(max_size=60) | st.text('t,q;\t\n\r"#0.1e-[] na', max_size=60).map(lambda text: b"t,q\n" + text.encode())
)
def test_any_bytes_are_read_or_refused_in_one_line(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("table") / "log.csv"
    path.write_bytes(content)
    try:
        t, values = recordings.read(path, ["q"])["q"]
    except ConfigError as refusal:
        assert "\n" not in str(refusal) and "\r" not in str(refusal)
    else:
        assert t.shape == values.shape and np.isfinite([t, values]).all()
