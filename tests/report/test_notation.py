"""What figures call states and inputs, with units; one markup for subscripts, and what each medium makes of it."""

from types import SimpleNamespace
from typing import Any

import pytest

from npred import plants
from npred.lab.report.figures.notation import (
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
from npred.lab.report.figures.style import MEDIA, SCREEN, lettered, medium

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
