"""The figure of the delay margin: its curve crosses 0 where the margin ends, and it comes from the command line."""

import numpy as np
import pytest
from matplotlib.figure import Figure as Canvas
from typer.testing import CliRunner

import npred
from npred.cli import app
from npred.lab.report import figures


def drawn(figure):
    axis = Canvas().subplots()
    figure.panels[0].draw(axis)
    return max((line.get_xydata() for line in axis.lines), key=len)


@pytest.mark.parametrize(("name", "D"), [("scalar", 1.0), ("chemostat", 1.5)])
def test_the_curve_is_below_0_in_the_margin_and_above_beyond(name, D):
    plant = npred.plant(name)
    low, high = npred.delay_margin(plant, D)
    errors, rates = drawn(figures.margin(plant, "margin", D)).T
    assert errors[0] < low and errors[-1] > high
    np.testing.assert_array_equal(rates < 0, (errors > low) & (errors < high))


def test_the_command_writes_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["plants", "check", "scalar", "--delay", "1", "--figure", "margin.svg"])
    assert done.exit_code == 0 and (tmp_path / "margin.svg").read_text().startswith("<?xml")
    done = CliRunner().invoke(app, ["plants", "check", "scalar", "--figure", "margin.txt"])
    assert done.exit_code == 2 and "--figure: expected a file that ends in svg, pdf, png" in done.stderr
