"""The log of a rig: what was written comes back, and its summary counts what was put there by hand."""

from pathlib import Path

import numpy as np
import pytest

import npred
from npred.lab.report import figures
from npred.loop.settable import course
from npred_rig import log

PLANT, DT = npred.plant("scalar"), 0.01
COURSE = course(PLANT, {})
LATE = 1e-4


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """100 calls of which number 40 is left out; a sample for each second call, number 7 lost, 20 and 21 exchanged."""
    controller = npred.controller(PLANT, npred.predictor(PLANT, "rk4", 21), None, DT, D_hat=0.3, actuator="history")
    written = log.LogFile(tmp_path / "log.csv", controller)
    for k in [k for k in range(100) if k != 40]:
        t = k * DT + LATE
        age = t - (k - k % 2) * DT
        values = (-1.0, 0.3, 0.01, age, 3, k >= 90, LATE, 2e-4)
        written.row(t, (*PLANT.inputs, *log.CALL), values)
    order = [k for k in range(50) if k != 7]
    order[19], order[20] = order[20], order[19]
    for k in order:
        taken = 2 * k * DT
        values = (0.0, k, taken + 0.05, np.nan if k < 10 else 0.29, 1 / (k + 1))
        written.row(taken, (*PLANT.states, *log.SAMPLE, *log.truth(PLANT)), values)
    written.end(log.OVER)
    return tmp_path / "log.csv"


def test_the_summary_counts_what_is_in_the_log(path):
    said = log.summary(PLANT, COURSE, log.read(path), DT)
    assert (said["calls"], said["skipped"], said["refused"]) == (99, 1, 3)
    assert (said["samples"], said["samples_lost"], said["samples_reordered"]) == (49, 1, 1)
    assert (said["D_hat"], said["D_hat_spread"], said["delay"]) == (0.3, 0.01, 0.29)
    assert said["samples_late"] == pytest.approx(0.05)
    assert said["handed_over"] == pytest.approx(10 / 99)
    assert said["without_sample"] == pytest.approx(49 / 98)  # the second call of each pair; 41 has what 40 did not take
    assert said["late_max_us"] == pytest.approx(100)
    assert said["took_median_us"] == pytest.approx(200)
    assert said["radius"] == pytest.approx(1 / 46)  # of the plant at the first sample in the last tenth


@pytest.mark.parametrize("lost", ["", "inf", "-inf"])
def test_a_plant_that_left_the_finite_numbers_has_no_radius(path, lost):
    *rows, last, why = path.read_text().splitlines()
    path.write_text("\n".join([*rows, ",".join([*last.split(",")[:-1], lost]), why]) + "\n")
    assert log.summary(PLANT, COURSE, log.read(path), DT)["radius"] is None


def test_a_log_that_was_cut_says_no_reason(path):
    assert log.read(path).why == log.OVER
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    assert log.read(path).why == ""


def test_the_last_row_is_the_last_call(path):
    assert log.last_row(path).startswith("t 0.9901, U -1, D_hat 0.3, ")
    assert log.last_row(path.with_name("none.csv")) == ""


def test_the_figure_has_a_panel_for_each_series(path):
    plate = log.figure(PLANT, "drawn", log.read(path))
    assert [panel.title for panel in plate.panels] == ["X", "U", "delay estimate D̂ (s)", "age of the sample (s)"]
    assert "ends at 0.3, the stamps say 0.29" in plate.panels[2].alt
    figures.write(plate, path.parent, formats=["svg"])
    assert path.with_name("drawn.svg").stat().st_size > 5000
