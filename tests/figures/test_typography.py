"""One markup for subscripts, and what each medium makes of it."""

import pytest

from npred.figures.style import MEDIA, SCREEN, lettered, medium
from npred.figures.typography import markup, mathematics, plain, raised


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
