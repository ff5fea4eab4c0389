"""The page to play with: its loops, natively and in a browser, are those of npred.simulate; and what it shows."""

import ctypes
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from browsers import CONTRAST, LEGIBLE, VISIBLE
from docs_pages import built

import npred
from npred.base import errors
from npred.kernels import compiler

pytest.importorskip("sphinx")
import play

WIDTHS = (1280, 390)
LARGEST = 400_000  # bytes of all that the page loads
TOLERANCE = 1e-9  # of the largest value of each column
SHORTEST = 40  # rows of a loop that are compared; all of those that are not chaotic
SCENES = [pytest.param(scene, id=scene.plant) for scene in play.SCENES]
# where the sliders of D, D_hat(0) and gamma are, the noise, and whether the predictor is on
POSITIONS = [
    pytest.param("first", "first", "first", 0.0, 1, id="as it opens"),
    pytest.param("first", "first", "first", 0.0, 0, id="predictor off"),
    pytest.param("low", "high", "low", 0.03, 1, id="short D, noise"),
    pytest.param("high", "low", "first", 0.1, 1, id="long D, much noise"),
    pytest.param("first", "first", "never", 0.0, 1, id="gamma 0"),
    pytest.param("high", "first", "first", 0.05, 0, id="off, noise"),
]
PLACES = {"first": 0, "low": 1, "high": 2}


def values(scene: Any, D: str, D_hat: str, gamma: str, noise: float) -> dict[str, float]:
    sliders = {"D": scene.D[PLACES[D]], "D_hat": scene.D_hat[PLACES[D_hat]], "noise": noise}
    return sliders | {"gamma": 0.0 if gamma == "never" else scene.gamma[PLACES[gamma]]}


def simulated(scene: Any, at: dict[str, float], predicts: int) -> np.ndarray:
    """The same loop by npred.simulate, with the bounds of U that the exported controller has: rows of X, U, D_hat.

    They end where a loop whose start differs in the last digit is a hundredth of the tolerance away: such a loop is
    chaotic, and nothing that rounds otherwise in each step follows it further.
    """
    rows, other = (_simulated(scene, at, predicts, start) for start in (1.0, 1.0 + 2.0**-51))
    apart = (np.abs(other - rows) > 0.01 * TOLERANCE * np.abs(rows).max(axis=0)).any(axis=1)
    return rows[: np.argmax(apart) if apart.any() else None]


def _simulated(scene: Any, at: dict[str, float], predicts: int, start: float) -> np.ndarray:
    plant = npred.plant(scene.plant)
    bounds, limits = scene.D_hat[1:], play.controller(scene).settings.input_bounds
    law = npred.DelayAdaptation(gamma=at["gamma"], b=play.B, bounds=bounds) if predicts and at["gamma"] else None
    loop = npred.simulate(
        plant, npred.predictor(plant, "rk4", scene.nx), D=at["D"], D_hat=at["D_hat"] if predicts else 0.0,
        X0=start * np.array(scene.X0), t_end=scene.t_end, dt=scene.dt, every=scene.every, adaptation=law,
        input_bounds=limits.reshape(plant.m, 2), u0=plant.m * [0.0],
        measurement=npred.Measurement(relative_noise=at["noise"]),
    )  # fmt: skip
    return np.concatenate([loop.X, loop.U, loop.D_hat[:, None]], axis=1)


def native(scene: Any, at: dict[str, float], predicts: int) -> np.ndarray:
    """The loop's C, compiled for this machine."""
    function = compiler.library(play.source(scene)).play
    function.restype = ctypes.POINTER(ctypes.c_double)
    function.argtypes = [*4 * [ctypes.c_double], ctypes.c_int]
    plant = npred.plant(scene.plant)
    shape = (scene.steps // scene.every + 1, plant.n + plant.m + 1)
    return np.ctypeslib.as_array(function(at["D"], at["D_hat"], at["gamma"], at["noise"], predicts), shape).copy()


def assert_agree(found: np.ndarray, expected: np.ndarray) -> None:
    assert np.isfinite(expected).all() and expected[:, 0].std() > 0
    assert len(expected) >= SHORTEST
    assert (np.abs(found[: len(expected)] - expected).max(axis=0) <= TOLERANCE * np.abs(expected).max(axis=0)).all()


@pytest.mark.parametrize(("D", "D_hat", "gamma", "noise", "predicts"), POSITIONS)
@pytest.mark.parametrize("scene", SCENES)
def test_the_loop_in_C_is_that_of_simulate(scene, D, D_hat, gamma, noise, predicts):
    at = values(scene, D, D_hat, gamma, noise)
    assert_agree(native(scene, at, predicts), simulated(scene, at, predicts))


def test_a_state_that_leaves_the_finite_numbers_ends_the_loop_as_nan():
    scene = play.SCENES[0]._replace(X0=(1e200, 1e200))
    rows = native(scene, values(scene, "first", "first", "first", 0.0), 1)
    assert np.isfinite(rows[0, :2]).all() and np.isnan(rows[-1, :2]).all()


def test_without_ziglang_the_script_holds_no_loops(monkeypatch):
    monkeypatch.setattr(play, "find_spec", lambda name: None)
    text = play.script()
    assert text.count('"module": ""') == len(play.SCENES)
    assert play.script(before=text + "// as it was") == text + "// as it was"
    assert play.script(text, play.SCENES[:1]) != text


@pytest.fixture(scope="module")
def url(tmp_path_factory) -> str:
    """The page as a file."""
    if not errors.installed("ziglang"):
        pytest.skip("needs pip install 'npred[docs]'")
    return built("play", "play", tmp_path_factory.mktemp("play")).as_uri()


@pytest.fixture
def look(browser, url):
    """Open the page in a window and wait for its first curve; it says nothing to the console, and loads few bytes."""
    heard: list[str] = []

    asked: list[str] = []

    def opened(width: int = 1280, script: str = "", **settings: Any) -> Any:
        page = browser.new_page(viewport={"width": width, "height": 844}, **settings)
        page.on("console", lambda message: heard.append(message.text))
        page.on("pageerror", lambda error: heard.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        if script:
            page.route("**/play_loops.js*", lambda route: route.fulfill(body=script))
        page.goto(url)
        if not script:
            page.wait_for_function("performance.getEntriesByName('first curve').length")
        return page

    yield opened
    assert heard == []
    assert all(url.startswith("file:") for url in asked)
    assert sum(Path(unquote(urlsplit(url).path)).stat().st_size for url in set(asked)) <= LARGEST


def move(page: Any, name: str, value: float) -> None:
    page.evaluate("""async ([name, value]) => {
      form.elements[name].value = value;
      await update();
    }""", [name, value])  # fmt: skip


def sentence(page: Any) -> str:
    return page.inner_text("#play-sentence")


@pytest.mark.parametrize("number", range(len(play.SCENES)))
def test_the_loops_in_a_browser_are_those_of_simulate(look, number):
    page, scene = look(), play.SCENES[number]
    for D, D_hat, gamma, noise, predicts in (position.values for position in POSITIONS):
        at = values(scene, D, D_hat, gamma, noise)
        rows = page.evaluate("""async ([number, at, predicts]) =>
          run(await load(LOOPS[number]), LOOPS[number], at, predicts)""", [number, at, predicts])  # fmt: skip
        assert_agree(np.array(rows), simulated(scene, at, predicts))


@pytest.mark.parametrize("width", WIDTHS)
def test_all_is_inside_the_page(look, width):
    page = look(width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for part in page.locator("#play :is(input, select, button, span, svg)").all():
        box = part.bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= width
    assert page.locator("#play svg").count() == 4
    assert min(svg.bounding_box()["height"] for svg in page.locator("#play svg").all()) >= 100


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_is_legible(look, scheme):
    page = look(color_scheme=scheme)
    for selector, kind, least in (
        ("#play span, #play-sentence, #play figcaption", "color", LEGIBLE),
        ("#play text", "fill", LEGIBLE),
        ("#play path:not(.grid)", "stroke", VISIBLE),
    ):
        contrasts = page.evaluate(CONTRAST, [selector, kind])
        assert len(contrasts) > 3 and min(contrasts) >= least


def test_a_slider_moves_by_the_keyboard_and_says_its_value(look):
    page = look()
    slider = page.get_by_label("Delay D")
    before = page.locator("#play path.first").first.get_attribute("d")
    slider.focus()
    page.keyboard.press("ArrowRight")
    page.wait_for_function("document.activeElement.previousElementSibling.textContent === '1.01 s'")
    assert slider.get_attribute("aria-valuetext") == "1.01 s"
    assert page.locator("#play path.first").first.get_attribute("d") != before
    page.keyboard.press("Tab")
    page.keyboard.press("Home")
    page.wait_for_function("document.activeElement.getAttribute('aria-valuetext') === '0.10 s'")


def test_the_page_says_what_one_sees(look):
    page = look()
    assert sentence(page).startswith("Settled within 5 %") and sentence(page).endswith("D is 1.00 s.")
    page.uncheck("[name=predicts]")
    page.wait_for_function("document.getElementById('play-sentence').textContent.startsWith('Does not settle')")
    assert page.locator("#play input:disabled").count() == 2
    page.click("button[type=reset]")
    page.wait_for_function("document.getElementById('play-sentence').textContent.startsWith('Settled')")
    move(page, "gamma", page.evaluate("form.elements.gamma.min"))
    assert page.get_by_label("Gain γ").get_attribute("aria-valuetext") == "0: D̂ stays"
    assert sentence(page).startswith("Does not settle") and "D̂ ends at 2.00 s" in sentence(page)
    move(page, "D_hat", 1)
    assert sentence(page).startswith("Settled")
    page.select_option("[name=scene]", "1")
    page.wait_for_function("shown?.of === LOOPS[1]")
    assert sentence(page).startswith("Settled")


def test_what_the_page_tells_to_try_is_so(look):
    page = look()
    move(page, "D", 2.5)
    assert sentence(page).startswith("Does not settle")
    move(page, "gamma", 2)
    assert sentence(page).startswith("Settled")


@pytest.mark.parametrize(
    ("course", "said"),
    [
        pytest.param("k === 5 ? 0.06 : 0.0", "Settled within 5 % at t = 0.6 s.", id="settled"),
        pytest.param("k === 5 ? NaN : 0.0", "Overflows at t = 0.5 s.", id="not finite"),
        pytest.param("0.5 * (-1) ** k", "Does not settle: x swings between −0.5 and 0.5 at the end.", id="swings"),
        pytest.param("2 * Math.exp(-k / 50)", "Not settled in 10 s, but the swings become smaller.", id="slowly"),
        pytest.param("0.11", "Not settled in 10 s: it stays within 11 % of rest at the end.", id="near"),
    ],
)
def test_the_sentence_of_a_course(look, course, said):
    page = look()
    assert page.evaluate(f"""outcome({{
      of: {{ states: ["x"], rest: [0], axes: [[-0.5, 0.5]], dt: 0.1, every: 1, t_end: 10 }},
      rows: Array.from({{ length: 100 }}, (_, k) => [{course}]),
    }})""") == said  # fmt: skip


def test_without_ziglang_the_page_says_so(look, monkeypatch):
    monkeypatch.setattr(play, "find_spec", lambda name: None)
    page = look(script=play.script())
    assert "without ziglang" in page.inner_text("#play-notice")
    assert not page.is_visible("#play-controls")
