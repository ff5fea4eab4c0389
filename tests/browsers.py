"""Chromium for tests, and the contrast of what it shows."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

NEEDED = "NPRED_BROWSER"  # set by .ci/run: then a browser that is missing is a failure
FOUND = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
LEGIBLE = 4.5  # contrast of text, WCAG 2.2 AA
VISIBLE = 3.0  # of lines that carry meaning

CONTRAST = """([selector, property]) => {
  const light = (colour) => {
    const parts = colour.match(/[\\d.]+/g).slice(0, 3).map((part) => part / 255)
      .map((part) => (part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4));
    return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2];
  };
  const grounds = [document.body, document.documentElement].map((part) => getComputedStyle(part).backgroundColor);
  const page = light(grounds.find((colour) => colour.startsWith("rgb(")));
  return [...document.querySelectorAll(selector)].map((element) => getComputedStyle(element)[property])
    .filter((colour) => colour.startsWith("rgb("))
    .map(light).map((own) => (Math.max(own, page) + 0.05) / (Math.min(own, page) + 0.05));
}"""


@contextmanager
def chromium() -> Iterator[Any]:
    """Chromium, headless; the test is skipped where there is none, unless the environment says that it is needed."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        sync_playwright = None
    if FOUND is None or sync_playwright is None:
        lacking = f"expected Chromium and playwright, got {FOUND} and {sync_playwright}"
        pytest.fail(lacking) if os.environ.get(NEEDED) else pytest.skip(lacking)
    with sync_playwright() as started:
        opened = started.chromium.launch(executable_path=FOUND, args=["--no-sandbox"])
        yield opened
        opened.close()
