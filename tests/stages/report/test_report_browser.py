"""The report in a real browser: at a desk and on a phone, in the light and in the dark, and in print."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from browsers import CONTRAST, LEGIBLE, VISIBLE

WIDTHS = (1280, 390)
READABLE = 9.5  # pixels of the smallest letters in a figure

LETTERS = """() => [...document.querySelectorAll(".panel svg text")].map((text) => {
  const box = text.getBoundingClientRect(), size = parseFloat(getComputedStyle(text).fontSize);
  return size * text.ownerSVGElement.getScreenCTM().a;
})"""


@pytest.fixture
def look(browser, reported) -> Iterator[Any]:
    """Open the report in a window; whatever it says or asks for must have been nothing at the end."""
    heard: list[str] = []

    def opened(width: int = 1280, **settings: Any) -> Any:
        page = browser.new_page(viewport={"width": width, "height": 844}, **settings)
        page.on("console", lambda message: heard.append(message.text))
        page.on("pageerror", lambda error: heard.append(str(error)))
        page.on("request", lambda request: heard.append(request.url) if request.url not in (url, "data:,") else None)
        page.goto(url)
        return page

    url = (Path(reported[1]["report"].artifact.folder) / "report.html").as_uri()
    yield opened
    assert heard == []


@pytest.mark.parametrize("width", WIDTHS)
def test_every_figure_is_visible_inside_the_page(look, width):
    page = look(width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    panels = page.locator(".panel svg[role=img]")
    assert panels.count() > 20
    for k in range(panels.count()):
        box = panels.nth(k).bounding_box()
        assert box["width"] >= 250 and box["height"] >= 150
        assert box["x"] >= 0 and box["x"] + box["width"] <= width
    assert min(page.evaluate(LETTERS)) >= READABLE


@pytest.mark.parametrize("width", WIDTHS)
def test_no_letters_of_a_figure_are_cut_off_or_lie_on_each_other(look, width):
    page = look(width)
    outside = page.evaluate("""(width) => [...document.querySelectorAll(".panel svg text")]
      .filter((text) => { const box = text.getBoundingClientRect(); return box.left < 0 || box.right > width; })
      .map((text) => text.textContent)""", width)  # fmt: skip
    assert outside == []
    ticks = page.evaluate("""() => [...document.querySelectorAll(".panel svg")].map((svg) =>
      [...svg.querySelectorAll("text")].map((text) => text.getBoundingClientRect())
        .map((box) => [box.left, box.right, box.top, box.bottom]))""")  # fmt: skip
    for boxes in ticks:
        rows: dict[float, list[list[float]]] = {}
        for box in boxes:
            rows.setdefault(round(box[2]), []).append(box)
        for row in rows.values():
            for left, right in pairwise(sorted(row)):
                assert left[1] <= right[0] + 1.0, "tick labels overlap"


def test_on_a_phone_the_legend_stays_in_sight_and_a_cut_table_has_a_shadow(look):
    page = look(390)
    page.evaluate("document.documentElement.style.scrollBehavior = 'auto'")
    last = page.locator("#figure-figure1 .panel").last
    page.evaluate("(top) => scrollTo(0, top)", last.bounding_box()["y"])
    box = page.locator("#figure-figure1 .keys").bounding_box()
    assert box["y"] >= 0 and box["y"] + box["height"] < 844 / 2
    cut = "[...document.querySelectorAll('.scroll')].filter((e) => e.scrollWidth > e.clientWidth)"
    shadows = page.evaluate(f"{cut}.map((e) => getComputedStyle(e).backgroundAttachment)")
    assert shadows and set(shadows) == {"local, scroll"}


def test_no_table_is_cut_at_a_desk(look):
    tables = "[...document.querySelectorAll('.scroll')].map((e) => [e.ariaLabel, e.scrollWidth - e.clientWidth])"
    found = look(1280).evaluate(tables)
    assert len(found) > 4 and [each for each in found if each[1] > 0] == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_is_legible_in_the_light_and_in_the_dark(look, scheme):
    page = look(color_scheme=scheme)
    for selector in ("p, h1, h2, h3, td, th, figcaption, dt, dd, pre, nav a, th button", ".panel svg text"):
        found = page.evaluate(CONTRAST, [selector, "color" if "svg" not in selector else "fill"])
        assert len(found) > 20 and min(found) >= LEGIBLE
    lines = page.evaluate(CONTRAST, [".keys line:not([stroke='var(--fill)'])", "stroke"])
    assert len(lines) > 10 and min(lines) >= VISIBLE
    background = page.evaluate("getComputedStyle(document.documentElement).backgroundColor")
    assert background == {"light": "rgb(254, 254, 254)", "dark": "rgb(20, 23, 27)"}[scheme]


def test_a_heading_sorts_its_table_by_keyboard(look):
    page = look()
    page.evaluate("document.querySelector('details').open = true")
    button = page.locator("#table-speed th button").nth(3)
    column = "[...document.querySelectorAll('#table-speed tbody tr')].map((row) => Number(row.cells[3].dataset.value))"
    button.focus()
    for key, sign in (("Enter", 1), ("Space", -1)):
        page.keyboard.press(key)
        values = page.evaluate(column)
        assert len(values) > 5 and values == sorted(values, reverse=sign < 0)
    assert page.locator("#table-speed th").nth(3).get_attribute("aria-sort") == "descending"


def test_the_first_stop_of_the_keyboard_skips_to_the_summary(look):
    page = look()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.getAttribute('href')") == "#summary"


def test_the_command_can_be_copied(look):
    page = look()
    page.locator("[data-copies=copied-command]").click()
    page.wait_for_function("document.getElementById('said').textContent !== ''")
    assert page.locator("#said").text_content() in ("Copied", "Selected")


def test_no_panel_is_cut_in_print_and_no_heading_is_left_behind(look):
    page = look()
    page.emulate_media(media="print")
    style = "(name) => { const found = getComputedStyle(document.querySelector(name));"
    kept = style + "return [found.display, found.breakInside, found.breakAfter]; }"
    assert page.evaluate(kept, ".plate")[0] == "block"  # rows of a grid are cut by some browsers
    assert page.evaluate(kept, ".panels")[0] == "contents"
    assert page.evaluate(kept, ".panel")[:2] == ["inline-block", "avoid"]
    assert page.evaluate(kept, ".keys")[1:] == ["avoid", "avoid"]
    assert page.evaluate(kept, "h2")[2] == "avoid"
    plate = "getComputedStyle(document.querySelector('.plate'))"
    assert page.evaluate(f"[{plate}.orphans, {plate}.widows]") == ["1", "1"]  # else three rows stay together


def test_on_paper_a_caption_takes_the_place_beside_a_last_panel_without_a_neighbour(look):
    page = look()
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 718, "height": 1016})  # A4 without its margins
    plates = page.evaluate("""[...document.querySelectorAll('.plate')].map((plate) => {
      const boxes = [...plate.querySelectorAll('.panel, figcaption')].map((part) => part.getBoundingClientRect());
      return boxes.map(({ left, right, top, bottom }) => [left, right, top, bottom]);
    })""")  # fmt: skip
    assert {len(plate) % 2 for plate in plates} == {0, 1}  # both kinds
    for *panels, caption in plates:
        beside = caption[2] < panels[-1][3] and caption[0] >= panels[-1][1]
        assert beside == (len(panels) % 2 == 1)


def test_it_prints_on_light_paper(look):
    page = look(color_scheme="dark")
    page.emulate_media(media="print")
    assert page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--paper').trim()") == "#fefefe"
    assert page.evaluate("getComputedStyle(document.querySelector('nav')).display") == "none"
    page.set_viewport_size({"width": 718, "height": 1016})  # A4 without its margins
    assert min(page.evaluate(LETTERS)) >= READABLE
    assert page.pdf(format="A4").startswith(b"%PDF")
