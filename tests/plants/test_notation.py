"""What figures call states and inputs, with units, in each medium; and the figure of the delay margin."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure as Canvas
from typer.testing import CliRunner

import npred
from npred import plants
from npred.cli import app
from npred.lab.report import figures
from npred.lab.report.figures.style import MEDIA, SCREEN, lettered, medium
from npred.plants.notation import (
    common_unit,
    markup,
    mathematics,
    plain,
    quantity,
    raised,
    spelt,
    symbol,
    timed,
)

TANK: Any = SimpleNamespace(
    labels={"h": "level h_{1}"}, units={"h": "m", "q": "m^3/h", "T": "K^-1"}, time_unit="h", declares_delay=False
)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("x1", "x_{1}"), ("x_12", "x_{12}"), ("theta", "θ"), ("omega2", "ω_{2}"), ("Omega", "Ω"), ("T_out", "T_{out}"),
        ("eps_kappa", "eps_kappa"), ("T_kappa", "T_{κ}"), ("level", "level"), ("joint_1_rate", "joint_1_rate"),
        ("theta_dot", "theta_dot"), ("e", "e"),
    ],
)  # fmt: skip
def test_a_name_is_written_in_the_letters_that_it_spells(name, text):
    assert spelt(name) == text


def test_a_quantity_has_its_label_and_its_unit():
    assert [quantity(TANK, name) for name in ("h", "q", "T", "v1", "D_hat")] == [
        "level h_{1} (m)", "q (m³/h)", "T (K⁻¹)", "v_{1}", "D̂ (h)",
    ]  # fmt: skip
    assert symbol(TANK, "h") == "level h_{1}" and timed(TANK, "t") == "t (h)"


def test_a_norm_has_a_unit_where_all_its_parts_share_one():
    assert common_unit(TANK, ("h",)) == "m"
    assert common_unit(TANK, ("h", "q"), "state units") == common_unit(TANK, ("v",), "state units") == "state units"


@pytest.mark.parametrize("name", [row["name"] for row in plants.named()])
def test_a_plant_of_mechanics_has_a_unit_for_every_state_and_input(name):
    plant = plants.resolve(name)
    if plant.units and name != "chemostat":
        assert set(plant.units) == {*plant.states, *plant.inputs}


def test_each_medium_lowers_a_subscript_in_its_own_way():
    text = "x_{1} versus ε_{κ} & T_{out}"
    assert plain(text) == "x₁ versus ε_κ & T_out"
    assert markup(text) == "x<sub>1</sub> versus ε<sub>κ</sub> &amp; T<sub>out</sub>"
    assert mathematics(text) == r"x$_{\mathrm{1}}$ versus ε$_{\mathrm{κ}}$ & T$_{\mathrm{out}}$"


def test_markup_lets_nobodys_tags_through():
    assert markup("_{<b>}_{a}<script>") == "_{&lt;b&gt;}<sub>a</sub>&lt;script&gt;"


def test_powers_are_raised_and_braces_that_are_no_subscript_stay():
    assert raised("m/s^2, s^-1, s^{-2}, a^b") == "m/s², s⁻¹, s⁻², a^b"
    assert plain("a_b {c} _{}") == mathematics("a_b {c} _{}") == "a_b {c} _{}"


@pytest.mark.parametrize("style", MEDIA.values())
def test_matplotlib_can_set_any_subscript(style):
    from matplotlib.mathtext import MathTextParser

    with medium(style):
        MathTextParser("path").parse(lettered("T_{a b,.+*/-9ü} T_{%} D̂ P̂ s⁻¹"))


def test_a_page_gets_the_text_as_it_is():
    with medium(SCREEN):
        assert lettered("ε_{κ} ⁻³ D̂") == "ε_{κ} ⁻³ D̂"


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
