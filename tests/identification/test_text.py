"""Tables of text as loggers write them: separators, headers, units, gaps, stamps; what is left out is said."""

import bz2
import csv
import gzip
import io
import lzma
import math
import re

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
    t, column, _ = recordings.read(path, [name], **options).series[name]
    return t.tolist(), column.tolist()


def notes(path, name, **options):
    return recordings.read(path, [name], **options).notes


@pytest.mark.parametrize(
    "text",
    [
        "t,q\n0,1.5\n0.5,2\n",
        "t;q\n0;1,5\n0,5;2\n",
        "t\tq\n0\t1,5\n0.5\t2\n",
        "t|q\n0|1.5\n0.5|2\n",
        "t q\n0 1.5\n0.5 2\n",
        "  t        q\n  0.000E+00  0.150E+01\n  0.500E+00  0.200E+01\n",
        "time (s)   q (l per min)\n0          1,5\n0,5        2\n",
        "\ufefft,q\r\n0,1.5\r\n0.5,2\r\n",
        "t,q\r0,1.5\r0.5,2\r",
        "# a logger\n\n  # of 2024, \"as it is\n't', q\n".replace("'t'", '"t"') + "0, 1.5\n# a pause\n\n0.5, 2\n,\n",
        "% a logger\n% t q\n0 1.5\n% a pause\n0.5 2\n",
        "%t,q\n0,1.5\n0.5,2\n",
        "t,q,\n0,1.5,\n0.5,2,\n",
        "# t,q\n0,1.5\n0.5,2\n",
        "t [s],q (m^3/s)\n0,1.5\n0.5,2\n",
        "q,t\n1.5,0\n2.0e0,+.5\n",
        "sep=;\nt;q\n0;1,5\n0,5;2\n",
        '"t";"q"\n"0";"1,5"\n"0,5";"2"\n',
        't,q\n0,"1,5"\n"0,5",2\n',
        "logger,7\nsince 1999\n\nt,q\n0,1.5\n0.5,2\n",
        "t,q\ns,l/min\n0,1.5\n0.5,2\n",
        "q,t\nl/min,[s]\n1.5,0\n2,.5\n",
        "t,q\n0,1.5\n0.5,2\n0.7",
        "t,q\n0,1.5\n0.5,2\n\0\0\0\0",
    ],
    ids=["comma", "semicolon", "tab", "bar", "blank", "aligned", "aligned header", "BOM and CRLF", "CR", "comments",
         "comments by %", "% in the header", "a last separator", "header of np.savetxt", "units",
         "another order", "sep", "all quoted", "quoted commas", "lines above", "row of units", "units in brackets",
         "cut", "NUL"],
)  # fmt: skip
def test_tables_of_different_loggers_have_the_same_numbers(write, text):
    assert values(write(text), "q") == ([0, 0.5], [1.5, 2])


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize("name", ["log.csv", "log.dat", "log.TXT", "log.asc", "log.xyz", "log"])
def test_encodings_and_suffixes(write, encoding, name):
    path = write("t,T [°C]\r\n0,20\r\n1,21\r\n", name, encoding)
    assert values(path, "T") == ([0, 1], [20, 21])
    assert recordings.read(path, ["T"]).units == {"T": "°C"}


def test_names_come_without_units_which_are_kept(write):
    path = write("t [ms],T1 [K],T2(K),q[0],q[1],p [bar],p [Pa],T [1]\n" + "1,2,3,4,5,6,7,8\n")
    table = recordings.opened(path)
    assert table.columns() == ["t", "T1", "T2", "q[0]", "q[1]", "p [bar]", "p [Pa]", "T [1]"]
    assert recordings.read(path, ["T1", "q[0]", "T2 [K]".replace(" [K]", "(K)")]).units == {"T1": "K", "T2(K)": "K"}
    assert values(path, "T1 [K]") == values(path, "T1") == ([0.001], [2])
    assert values(path, "p [Pa]") == ([0.001], [7])


def test_a_row_of_units_is_no_row(write):
    path = write("Time,T,q\nms,°C,l/min\n1000,20,1\n2000,21,2\n")
    read = recordings.read(path, ["T", "q"])
    assert read.units == {"T": "°C", "q": "l/min"}
    assert read.series["T"].t.tolist() == [1, 2] and read.series["T"].rows.tolist() == [3, 4]
    assert read.notes == ["log.csv: 2 rows; times from column Time in ms (its header), in s."]


def test_an_angle_has_the_unit_in_its_name(write):
    path = write("t,angle_deg,arm.rad,grad,q [deg]\n0,1,2,3,4\n")
    assert recordings.read(path, ["angle_deg", "arm.rad", "grad", "q"]).units == {
        "angle_deg": "deg", "arm.rad": "rad", "q": "deg",
    }  # fmt: skip


def test_labview(write):
    text = (
        "LabVIEW Measurement\t\nSeparator\tTab\nDate\t2024/07/22\nTime\t17:18:18,93\n***End_of_Header***\t\n\t\n"
        "Channels\t2\t\nSamples\t3\t3\t\nX_Dimension\tTime\tTime\t\nDelta_X\t0,1\t0,1\t\n***End_of_Header***\t\t\n"
        "X_Value\tflow\tlevel\tComment\n"
    ) + "".join(f"0,{k}\t1,{k}\t0,2{k}\n" for k in range(9))
    assert values(write(text, "log.lvm"), "level") == ([k / 10 for k in range(9)], [(20 + k) / 100 for k in range(9)])
    text = "Y_Unit_Label\tVolts\t\tg\t\nX_Value\tU\tX_Value\ta\tComment\n" + 2 * "0.0\t-1.5\t0.0\t0.5\n"
    assert recordings.opened(write(text, "log.lvm")).columns() == ["X_Value", "U", "X_Value", "a"]


def test_columns_without_names_are_called_by_their_place(write):
    path = write(" 0.0 10 1.5\n 0.1 20 2.5\n")
    assert recordings.opened(path).columns() == ["1", "2", "3"]
    assert values(path, "3", time="1") == ([0, 0.1], [1.5, 2.5])
    with pytest.raises(ConfigError, match=r"expected a column of times .*, got 1, 2, 3; name it by --time, .*--period"):
        values(path, "3")
    named = write("t,u\n0,1\n1,2\n", "named.csv")
    with pytest.raises(ConfigError, match="got '2'; choose one of t, u"):
        values(named, "2")


def test_a_file_without_times_has_a_period(write):
    path = write("u,y\n1,2\n3,4\nx\n5,6\n")
    assert values(path, "y", period=0.5) == ([0, 0.5, 1.5], [2, 4, 6])  # the bad row took its time
    assert notes(path, "y", period=0.5, unit="min")[0] == "log.csv: 3 rows; row k is at k times 0.5 min (period)."
    for period in (0, -1, math.nan, math.inf):
        with pytest.raises(
            ConfigError, match=r"period: expected a time above 0 in s, got .*; give that between two rows"
        ):
            values(path, "y", period=period)
    with pytest.raises(ConfigError, match=r"period: expected either the times of 'u' or a period, got both; drop one"):
        values(path, "y", period=1.0, time="u")


UNITS = [("s", 1), ("ms", 1e-3), ("us", 1e-6), ("µs", 1e-6), ("ns", 1e-9), ("min", 60), ("h", 3600), ("d", 86400),
         ("days", 86400), ("Sec", 1)]  # fmt: skip


@pytest.mark.parametrize(("unit", "factor"), UNITS)
@pytest.mark.parametrize(("plant", "seconds"), [("s", 1), ("min", 60), ("h", 3600)])
def test_times_are_in_the_unit_of_the_plant(write, unit, factor, plant, seconds):
    expected = pytest.approx([3 * factor / seconds, 7 * factor / seconds], rel=1e-15)
    for header in ("t [{}]", "time ({})", "t_{}", "Time / {}", "elapsed time in {}"):
        path = write(f"{header.format(unit)},q\n3,1\n7,2\n")
        assert values(path, "q", unit=plant)[0] == expected
        assert re.search(rf"in ({unit}|{unit.casefold()}) \(its header\), in {plant}", notes(path, "q", unit=plant)[0])
    if unit == unit.lower():
        assert values(write("t,q\n3,1\n7,2\n"), "q", time_unit=unit, unit=plant)[0] == expected
        assert values(write("t [h],q\n3,1\n7,2\n"), "q", time_unit=unit, unit=plant)[0] == expected  # the flag counts


def test_without_a_unit_times_are_in_the_plants_and_that_is_said(write):
    path = write("time,q\n3,1\n7,2\n")
    assert values(path, "q", unit="min")[0] == values(path, "q", unit="periods")[0] == [3, 7]
    assert notes(path, "q", unit="min") == [
        "log.csv: 2 rows; times from column time, in min, the plant's unit: the file names none."
    ]


def test_a_plant_with_a_unit_that_is_no_time(write):
    path = write("t [ms],q\n3,1\n7,2\n")
    assert values(path, "q", unit="periods")[0] == [3, 7]
    assert "in ms (its header), taken as periods, the plant's unit" in notes(path, "q", unit="periods")[0]
    assert values(write("t [periods],q\n3,1\n7,2\n"), "q", unit="periods")[0] == [3, 7]
    path = write("time,q\n2024-05-01,1\n2024-05-02,2\n")
    with pytest.raises(
        ConfigError, match=r"expected a plant with a time_unit .*one of s, ms, .*, got 'periods'; change"
    ):
        values(path, "q", unit="periods")


def test_numbers_that_may_be_stamps_get_a_note(write):
    path = write("time,q\n1700000000000,1\n1700000000500,2\n")
    assert notes(path, "q")[1].startswith("column time may be ms since 1970")
    assert values(path, "q", time_unit="ms", unit="min")[0] == pytest.approx([1700000000 / 60, 1700000000.5 / 60])
    assert len(notes(write("time,q\n1700,1\n1701,2\n"), "q")) == 1


def test_times_stay_in_the_order_of_the_file(write):
    assert values(write("t,q\n2,1\n0,2\n2,3\n-1,4\n"), "q") == ([2, 0, 2, -1], [1, 2, 3, 4])


@pytest.mark.parametrize(
    "name", ["t", "time", "Time", "timestamp", "stamp", "Time [s]", "t (s)", "seconds", "Date", "DateTime", "Zeit",
             "elapsed", "Date/Time", "time_s", "X_Value"],
)  # fmt: skip
def test_the_column_of_times_is_found_or_named(write, name):
    assert values(write(f"q,T,{name}\n1,5,2\n3,5,4\n"), "q") == ([2, 4], [1, 3])
    assert values(write(f"q,clock,{name}\n1,5,2\n3,6,4\n"), "q", time="clock") == ([5, 6], [1, 3])


@pytest.mark.parametrize("name", ["T", "Ts", "Timer", "delay [s]", "s", "h", "Target time error", "index", ""])
def test_a_number_of_another_name_is_no_time(write, name):
    with pytest.raises(ConfigError, match="expected a column of times"):
        values(write(f"{name},q\n0,1\n1,2\n"), "q")


@pytest.mark.parametrize(
    "stamps",
    [
        ["2024-05-01T12:00:00", "2024-05-01T12:00:00.250", "2024-05-02T12:00:00"],
        ["2024-05-01 12:00:00Z", "2024-05-01 14:00:00.25+02:00", "2024-05-02 12:00:00Z"],
        ["20240501T120000", "20240501T120000.250000", "20240502T120000"],
        ["01.05.2024 12:00:00", "01.05.2024 12:00:00.25", "02.05.2024 12:00:00"],
        ["1.5.2024 12:00", "1.5.2024 12:00:00.25", "2.5.2024 12:00"],
        ['"01.05.2024 12:00:00,000"', '"01.05.2024 12:00:00,250"', '"02.05.2024 12:00:00,000"'],
        ["2024/05/01 12:00:00", "2024/05/01 12:00:00.25", "2024/05/02 12:00:00"],
        ["31/12/2024 12:00:00.00", "31/12/2024 12:00:00.25", "01/01/2025 12:00:00.00"],
        ["12/31/2024 12:00:00.00 PM", "12/31/2024 12:00:00.25 PM", "01/01/2025 12:00:00.00 PM"],
        ["01/05/2024 12:00:00.00", "01/05/2024 12:00:00.25", "02/05/2024 12:00:00.00"],
        ["01-May-2024 12:00:00.00", "01-May-2024 12:00:00.25", "02-May-2024 12:00:00.00"],
        ["0:00:00", "0:00:00.25", "24:00:00"],
        ["0 days 00:00:00", "0 days 00:00:00.250000", "1 days 00:00:00"],
    ],
)  # fmt: skip
def test_stamps_are_since_the_first_row(write, stamps):
    rows = "".join(f"{stamp},{k}\n" for k, stamp in enumerate(stamps))
    for name in ("time", "", "Unnamed: 0"):
        path = write(f"{name},q\n{rows},9\n")
        assert values(path, "q") == ([0, 0.25, 86400], [0, 1, 2])
        assert values(path, "q", unit="h")[0] == pytest.approx([0, 0.25 / 3600, 24])
    assert notes(path, "q", unit="h") == ["log.csv: 4 rows; times from the stamps in column Unnamed: 0, in h."]


def test_a_column_without_a_name_between_others_is_called_by_its_place(write):
    path = write(",T,,q\n0.0,1,2,3\n0.5,4,5,6\n")
    assert recordings.opened(path).columns() == ["1", "T", "3", "q"]
    assert values(path, "3", time="1") == ([0, 0.5], [2, 5])


@pytest.mark.parametrize("text", ["Date;Time;q\n{}", "{}", "q;Uhrzeit;Datum\n{}"])
def test_date_and_time_may_be_two_columns(write, text):
    rows = [("31.12.2024", "23:59:59,5", 1), ("01.01.2025", "00:00:00,0", 2), ("01.01.2025", "00:00:01,0", 3)]
    back = text.startswith("q")
    lines = "\n".join(";".join(map(str, reversed(row) if back else row)) for row in rows)
    path = write(text.format(lines))
    column = "q" if "q" in text else "3"
    assert values(path, column) == ([0, 0.5, 1.5], [1, 2, 3])
    assert "from the stamps in columns" in notes(path, column)[0]
    if column == "q":
        assert values(path, "q", time="Date" if "Date" in text else "Datum")[0] == [0, 0.5, 1.5]


def test_a_time_of_the_day_by_twelve_hours(write):
    path = write("Date,Time,T\n03/04/2024,11:59:00 PM,1\n03/05/2024,12:00:00 AM,2\n03/05/2024,12:01:00 AM,3\n")
    assert values(path, "T", unit="min")[0] == [0, 1, 2]
    assert values(write("Time,T\n11:59:00 AM,1\n12:00:00 PM,2\n1:00:00 pm,3\n"), "T", unit="min")[0] == [0, 1, 61]


def test_a_time_of_the_day_may_lack_seconds(write):
    assert values(write("time,q\n12:30,1\n13:45,2\n"), "q", unit="min")[0] == [0, 75]


def test_what_is_no_stamp_is_left_out_and_said(write):
    path = write("time,q\n01.05.2024 00:00,1\nnoon,2\n01.05.2024 00:02,3\n")
    assert values(path, "q", unit="min") == ([0, 2], [1, 3])
    assert (
        notes(path, "q")[1]
        == "column time: cells that hold no stamp are left out with the row: 1, as 'noon' in line 3."
    )


def test_words_for_nothing_are_left_out(write):
    cells = ["1", "", "nan", " NaN ", "NA", "n/a", "null", "None", '""', "2"]
    text = "t,q\n" + "".join(f"{k},{cell}\n" for k, cell in enumerate(cells))
    assert values(write(text), "q") == ([0, 9], [1, 2])


@pytest.mark.parametrize("word", ["-", "Bad Input", "2 K", "No Data", "#VALUE!", "1.2.3", "---"])
def test_other_words_are_left_out_and_said(write, word):
    path = write(f"t,q,h\n0,1,1\n1,{word},2\n2,{word},3\n3,4,4\n")
    assert values(path, "q") == ([0, 3], [1, 4])
    assert notes(path, "q")[1:] == [f"column q: cells that hold no number are left out: 2, as {word!r} in line 3."]
    assert recordings.read(path, ["q"]).series["q"].rows.tolist() == [2, 5]
    assert len(notes(path, "h")) == 1


def test_decimal_commas(write):
    path = write('t,q\n0,"2,5"\n1,"1.234,5"\n2,3\n')
    assert values(path, "q") == ([0, 1, 2], [2.5, 1234.5, 3])
    assert notes(path, "q")[1:] == ["column q: the comma in '2,5' is taken for a decimal comma."]
    path = write("t;q\n0;2,5\n1;-1.234,5e1\n2;3\n")
    assert values(path, "q") == ([0, 1, 2], [2.5, -12345, 3])
    assert len(notes(path, "q")) == 1


@pytest.mark.parametrize(("suffix", "pack"), [("gz", gzip.compress), ("bz2", bz2.compress), ("xz", lzma.compress)])
def test_a_packed_table(tmp_path, suffix, pack):
    path = tmp_path / f"log.csv.{suffix}"
    path.write_bytes(pack(b"t,q\n0,1.5\n0.5,2\n"))
    assert values(path, "q") == ([0, 0.5], [1.5, 2])
    path.write_bytes(pack(b"t,q\n0,1.5\n0.5,2\n")[:-12])
    with pytest.raises(ConfigError, match=r"expected a table of text, got: .*; check the file"):
        values(path, "q")


def test_stamps_with_blanks_beside_words(write):
    path = write("Time,u [V],mode\n" + "".join(f"2024-01-01 00:00:0{k}.500,{k},auto\n" for k in range(9)))
    assert values(path, "u") == ([*range(9)], [*range(9)])


LONG = [
    ("timestamp,topic,value\n", "{t},{name},{value}\n"),
    ("entity_id,state,last_changed\n", "{name},{value},2024-01-01T00:00:{t:02d}.000Z\n"),
    ("#datatype,string,long,dateTime:RFC3339,double,string\n#default,_result,,,,\n,result,table,_time,_value,_field\n",
     ",,0,2024-01-01T00:00:{t:02d}Z,{value},{name}\n"),
    ('"VarName";"TimeString";"VarValue";"Validity";"Time_ms"\n',
     '"{name}";"14.05.2020 10:15:{t:02d}";{comma};1;{days}\n'),
]  # fmt: skip


@pytest.mark.parametrize(("head", "row"), LONG, ids=["MQTT", "Home Assistant", "Influx", "WinCC"])
def test_a_long_table_has_a_series_for_each_topic(write, head, row):
    """All by one clock; WinCC's Time_ms is in millionths of a day."""
    cells = [{"t": 2 * k + j, "name": name, "value": k + 0.5 * j, "comma": f"{k + 0.5 * j:.1f}".replace(".", ","),
              "days": f"{43965427442 + (2 * k + j) / 0.0864:.6f}".replace(".", ",")}
             for k in range(20) for j, name in enumerate(("valve", "room/T"))]  # fmt: skip
    path = write(head + "".join(row.format(**cell) for cell in cells))
    read = recordings.read(path, ["room/T", "valve"])
    begin = read.series["valve"].t[0]
    np.testing.assert_allclose(read.series["valve"].t - begin, 2 * np.arange(20), atol=1e-5)
    np.testing.assert_allclose(read.series["room/T"].t - begin, 1 + 2 * np.arange(20), atol=1e-5)
    assert read.series["room/T"].values.tolist() == [k + 0.5 for k in range(20)]
    assert recordings.opened(path).columns()[:2] == ["valve", "room/T"]


def test_a_table_with_columns_of_such_names_has_them_too(write):
    path = write("t,name,value\n" + "".join(f"{k},{'ab'[k % 2]},{k}\n" for k in range(9)))
    assert values(path, "value") == ([*range(9)], [*range(9)])


def test_switches_are_numbers(write):
    assert values(write("t,on\n0,true\n1,False\n2,TRUE\n"), "on") == ([0, 1, 2], [1, 0, 1])
    assert values(write("t,on\n0,on\n1,Off\n2,\n3,ON\n"), "on") == ([0, 1, 3], [1, 0, 1])


def test_lines_that_are_no_rows_are_left_out_and_said(write):
    body = "".join(f"{k},{k}\n" for k in range(9))
    assert notes(write(f"t,q\n{body}9\n10,1,2\n11,12\n"), "q")[1:] == [
        "lines without 2 cells are left out: line 11, and 1 more."
    ]
    assert notes(write(f"t,q\n{body}9\n10,11\n"), "q")[1:] == ["lines without 2 cells are left out: line 11."]
    assert notes(write(f"made by Bob\non a Monday\nt,q\n{body}"), "q")[1:] == [
        "above the numbers, lines that are no header are skipped: 2."
    ]
    assert values(write(f"t,q\n{body}t,q\n9,1\n"), "q") == ([*range(10)], [*range(9), 1])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "log.csv: expected a table, got an empty file; check the path"),
        ("# only this\n\n", "log.csv: expected a table, got an empty file"),
        ("a text\nof two lines\n", "log.csv: expected two columns of numbers or more, got 'a text'; check the file"),
        ("q\n1\n2\n", "log.csv: expected two columns of numbers or more, got 'q'; check the file"),
        ("t,q\n", "log.csv: expected two columns of numbers or more, got 't,q'"),
        ("t,q,h\n0,on the way,1\n1,far,2\n", "got 'q' with words as 'on the way'; name another"),
        ("t,q\nnoon,1\nnight,2\nday,3\n", "stamps as 2024-05-01T12:00:00.5, in column t, got 'noon'"),
        ("t,q\n30/30/2024,1\n31/31/2024,2\n", "stamps as 2024-05-01T12:00:00.5, in column t, got '30/30/2024'"),
        ("clock,q\n0,1\n", "log.csv: expected a column of times (t, time, date, ...), got clock, q; name it"),
        ("t [samples],q\n0,1\n", "log.csv: expected a unit of time in the header, one of s, ms, us, µs, ns, min, h, d, "
         "got 'samples'; name it by --time-unit"),
        ("t,q,q\n0,1,2\n", "log.csv: expected one column q, got 2; rename them in the header"),
        ("t,q\n0,\"" + "x" * 200_000, "log.csv: expected a table of text, got: field larger than field limit"),
        ("\x01\x00\x03\x04PK", "log.csv: expected a table of text, got bytes of another kind; save it as CSV"),
    ],
)  # fmt: skip
def test_a_fault_is_one_line(write, text, words):
    with pytest.raises(ConfigError) as refusal:
        recordings.read(write(text), ["q"])
    assert words in str(refusal.value) and "\n" not in str(refusal.value)


def test_a_column_of_text_hinders_no_other(write):
    assert values(write("t,mode,q\n0,manual,1\n1,auto,2\n"), "q") == ([0, 1], [1, 2])


NAMES = st.text("abTq_α /,;\"'#|.-0", min_size=1, max_size=8).map(str.strip).filter(
    lambda name: any(c in "abTqα" for c in name) and name != "t"
)  # fmt: skip
CELLS = st.one_of(st.none(), st.floats(allow_infinity=False), st.floats(-1e3, 1e3))


@given(st.data(), st.lists(NAMES, min_size=1, max_size=5, unique=True), st.sampled_from(",;\t"), st.booleans(),
       st.sampled_from(["\n", "\r\n"]), st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]))  # fmt: skip
def test_what_is_written_is_read(tmp_path_factory, data, names, separator, comma, end, encoding):
    rows = data.draw(st.lists(st.tuples(st.floats(-1e9, 1e9), *[CELLS] * len(names)), min_size=1, max_size=8))
    stream = io.StringIO(newline="")
    csv.writer(stream, delimiter=separator, quoting=csv.QUOTE_ALL, lineterminator=end).writerow(["t", *names])
    for row in rows:
        text = separator.join("" if cell is None else repr(cell) for cell in row)
        stream.write((text.replace(".", ",") if comma and separator != "," else text) + end)
    path = tmp_path_factory.mktemp("table") / "log.csv"
    path.write_bytes(stream.getvalue().encode(encoding))
    assert recordings.opened(path).columns() == ["t", *names]
    for k, name in enumerate(names, 1):
        kept = [(row[0], row[k], n) for n, row in enumerate(rows, 2) if row[k] is not None and not math.isnan(row[k])]
        if not kept:
            with pytest.raises(ConfigError, match="empty cells or NaN alone"):
                recordings.read(path, [name])
            continue
        series = np.transpose(recordings.read(path, [name]).series[name])
        np.testing.assert_allclose(series, kept, rtol=1e-14, atol=0)


@given(
    st.binary(max_size=60) | st.text('t,q;\t\n\r"#0.1e-[] na', max_size=60).map(lambda text: b"t,q\n" + text.encode())
)
def test_any_bytes_are_read_or_refused_in_one_line(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("table") / "log.csv"
    path.write_bytes(content)
    try:
        t, values, rows = recordings.read(path, ["q"]).series["q"]
    except ConfigError as refusal:
        assert "\n" not in str(refusal) and "\r" not in str(refusal)
    else:
        assert t.shape == values.shape == rows.shape and np.isfinite([t, values]).all()
