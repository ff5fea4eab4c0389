"""Logs of printers and traces of CODESYS, whose lines are no rows of a table."""

import numpy as np
import pytest

from npred.base.errors import ConfigError
from npred.identification import recordings


@pytest.fixture
def write(tmp_path):
    def write(name, text, encoding="utf-8"):
        (tmp_path / name).write_bytes(text.encode(encoding))
        return tmp_path / name

    return write


def series(path, *names, **options):
    return {name: each.values.tolist() for name, each in recordings.read(path, names, **options).series.items()}


@pytest.mark.parametrize("name", ["klippy.log", "klippy.log.2024-05-01"])
def test_klipper(write, name):
    text = "Loaded MCU 'mcu' 100 commands\n" + "".join(
        f"Stats {1000 + k}.5: gcodein=0  mcu: mcu_awake=0.01 freq=72e6 "
        f"heater_bed: target=60 temp={20 + k}.5 pwm=1.000 print_time={k}.25 extruder: temp=21.0\n"
        f"webhooks client {k}: New connection\n"
        for k in range(9)
    )
    path = write(name, text)
    assert series(path, "heater_bed.temp") == {"heater_bed.temp": [20.5 + k for k in range(9)]}
    assert series(path, "print_time") == {"print_time": [k + 0.25 for k in range(9)]}  # of the host, not of a heater
    assert recordings.read(path, ["mcu.freq"]).series["mcu.freq"].t[:2].tolist() == [1000.5, 1001.5]


@pytest.mark.parametrize("head", ["2024-03-14 22:35:{:02d},406 - Recv: ok ", "22:35:{:02d}.406 : ", "< "])
def test_marlin(write, head):
    line = "T:{}.25 /210.00 B:60.00 /60.00 T0:{}.25 /210.00 @:127 B@:9 W:?\n"
    text = "start\necho:Marlin 2.1\n" + "".join(
        f"{head.replace('Recv: ok', 'Send: M105').format(k)}\n{head.format(k)}{line.format(20 + k, 20 + k)}"
        for k in range(9)
    )
    path, names = write("serial.log", text), ("T", "T.target", "@", "B@")
    if head == "< ":
        with pytest.raises(
            ConfigError, match=r"expected a column of times .* give the time between two rows by --period"
        ):
            series(path, *names)
    period = 1.0 if head == "< " else None
    read = recordings.read(path, names, period=period).series
    assert read["T"].values.tolist() == [20.25 + k for k in range(9)] and read["T.target"].values.tolist() == [210] * 9
    assert read["@"].values[0] == 127 and read["B@"].values[0] == 9
    np.testing.assert_allclose(read["T"].t - read["T"].t[0], np.arange(9))


TRACE = """<?xml version="1.0" encoding="utf-16"?>
<Trace><TraceConfiguration><Single Name="MicroSeconds" Type="bool">{}</Single></TraceConfiguration><TraceData>
<TraceRecord><TraceVariable VarName="PLC_PRG.u"><Values>0,1.5,2</Values><Timestamps>0,4000,8000</Timestamps>
</TraceVariable><TraceVariable VarName="PLC_PRG.on"><Values>False,True</Values><Timestamps>4000,8000</Timestamps>
</TraceVariable></TraceRecord></TraceData></Trace>"""


@pytest.mark.parametrize(("micro", "second"), [("True", 1e6), ("False", 1e3)])
@pytest.mark.parametrize(("name", "encoding"), [("log.trace", "utf-16"), ("log.xml", "utf-8")])
def test_a_trace_of_codesys(write, micro, second, name, encoding):
    read = recordings.read(write(name, TRACE.format(micro), encoding), ["PLC_PRG.u", "PLC_PRG.on"]).series
    assert read["PLC_PRG.u"].values.tolist() == [0, 1.5, 2] and read["PLC_PRG.on"].values.tolist() == [0, 1]
    np.testing.assert_allclose(read["PLC_PRG.on"].t, [4000 / second, 8000 / second])


@pytest.mark.parametrize(("flags", "second"), [(16, 1e3), (32, 1e6)])
def test_a_trace_of_codesys_as_csv(write, flags, second):
    blocks = "".join(
        f"{j}.Variable; {name}\n{j}.Color; 3\n" + "".join(f"; {4 * k}; {k + j}\n" for k in range(5))
        for j, name in enumerate(("PLC_PRG.u", "PLC_PRG.y"))
    )
    read = recordings.read(write("log.csv", f"Name; Trace\nFlags; {flags}\n{blocks}"), ["PLC_PRG.y"]).series[
        "PLC_PRG.y"
    ]
    assert read.values.tolist() == [1, 2, 3, 4, 5]
    np.testing.assert_allclose(read.t, 4 * np.arange(5) / second)


def test_a_trace_that_is_cut_is_refused_in_one_line(write):
    with pytest.raises(ConfigError, match=r"expected a table of text, got: .*; check the file$"):
        recordings.opened(write("log.trace", TRACE.format("True")[:-60]))
