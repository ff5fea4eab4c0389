"""Links of README and docs: on a host of the repository, where an index shows the README, and in the built pages."""

import re
import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import pytest
from conftest import HERE
from docs_pages import dead
from test_packaging import ADDRESS

ROOT = HERE.parent
CODE = re.compile(r"^(```+|~~~+).*?^\1[^\n]*$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(!?)\[(?:[^\[\]]|\[[^\]]*\])*\]\(([^)\s]+)\)|^\[[^\]]+\]:\s+(\S+)$", re.MULTILINE)
PAPER = "https://arxiv.org/"


@cache
def tracked() -> frozenset[Path]:
    """Files of the repository and their folders: what a host shows, and no generated page."""
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True)
    files = [ROOT / name for name in listed.stdout.splitlines()]
    return frozenset([*files, *(folder for file in files for folder in file.parents)])


def links(text: str) -> list[tuple[bool, str]]:
    """(whether it is a picture, target) of each link of Markdown, outside code."""
    plain = CODE.sub(lambda found: "`" if found[1] is None else "", text)
    return [(image == "!", target or reference) for image, target, reference in LINK.findall(plain)]


def anchors(page: Path) -> set[str]:
    """The anchors that a host gives the headings of a page."""
    seen, found = Counter[str](), set()
    for heading in re.findall(r"^#+ +(.+?) *$", re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S), re.M):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", words.lower()).replace(" ", "-")
        found.add(f"{slug}-{seen[slug]}" if seen[slug] else slug)
        seen[slug] += 1
    return found


def wrong(page: Path, target: str) -> bool:
    """Whether a link of a page leads nowhere on a host."""
    path, _, anchor = target.partition("#")
    file = (page.parent / path).resolve() if path else page
    return file not in tracked() or (bool(anchor) and anchor not in anchors(file))


PAGES = sorted(page.relative_to(ROOT) for page in tracked() if page.suffix == ".md" and page.is_file())


def test_there_are_pages_and_a_link_that_leads_nowhere_is_seen(tmp_path: Path):
    page = ROOT / "docs" / "theory.md"
    assert len(PAGES) > 40 and len(anchors(page)) > 8
    assert links("[a](b.md) `[c](d.md)` ![e](f.png)\n```\n[g](h.md)\n```\n") == [(False, "b.md"), (True, "f.png")]
    assert not wrong(page, "fidelity.md#errors-of-the-paper") and not wrong(page, "#the-predictor")
    assert all(wrong(page, each) for each in ("reference/commands.md", "fidelity.md#errors", "../none.md"))


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_every_link_leads_to_a_file_on_a_host(page: Path):
    targets = [target for _, target in links((ROOT / page).read_text())]
    outside = [target for target in targets if "://" in target]
    assert [each for each in outside if each.startswith(ADDRESS)] == []
    assert [each for each in targets if each not in outside and wrong(ROOT / page, each)] == []


def test_every_link_of_the_readme_is_absolute_in_what_an_index_shows():
    pytest.importorskip("hatch_fancy_pypi_readme")
    command = [sys.executable, "-m", "hatchling", "metadata", "readme"]
    shown = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    found, here = links(shown), links((ROOT / "README.md").read_text())
    assert len(found) == len(here) > 20
    for image, link in found:
        if not link.startswith(PAPER):
            parts = re.fullmatch(f"{re.escape(ADDRESS)}/(raw|blob)/main/(.+)", link)
            assert parts and (parts[1] == "raw") == image and not wrong(ROOT / "README.md", parts[2]), link


def test_the_address_of_the_repository_stands_in_one_file():
    text = (ROOT / "pyproject.toml").read_text()
    assert set(re.findall(r"https://\S*?(?=/raw/|/blob/)", text)) == {ADDRESS}
    telling = ("CONTRIBUTING.md", ".github/workflows/publish.yml")  # how to replace the placeholder, and whether it was
    name = ADDRESS.removeprefix("https://")
    files = [file for file in tracked() if file.is_file() and file.stat().st_size < 1e6]
    found = {str(file.relative_to(ROOT)) for file in files if name in file.read_text(errors="ignore")}
    assert found - {*telling, "tests/test_links.py"} == {"pyproject.toml"}


def test_a_built_page_with_a_dead_link_is_seen(tmp_path: Path):
    (tmp_path / "a.html").write_text('<p id="x"><a href="b.html#y">b</a><a href="#x">x</a><img src="c.png?v=1"></p>')
    (tmp_path / "b.html").write_text('<p id="z"><a href="a.html#x">a</a><a href="https://arxiv.org">p</a></p>')
    (tmp_path / "llms.txt").write_text("[a](a.html) [d](d.html)")
    assert dead(tmp_path) == ["a.html: b.html#y", "a.html: c.png?v=1", "llms.txt: d.html"]
