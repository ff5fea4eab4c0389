"""The extensions of the documentation and the links of its pages, for tests."""

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

from conftest import HERE, process_environment

DOCS = HERE.parent / "docs"
sys.path.append(str(DOCS / "extensions"))


def built(name: str, extension: str, folder: Path) -> Path:
    """The HTML of one page of docs/, built without the others, to which its links lead nowhere."""
    source = folder / "source"
    source.mkdir()
    (source / f"{name}.md").write_text((DOCS / f"{name}.md").read_text(encoding="utf-8"), encoding="utf-8")
    settings = {
        "extensions": f"myst_parser,{extension}", "html_theme": "furo", "root_doc": name,
        "html_static_path": str(DOCS / "_static"), "html_css_files": "npred.css",
        "suppress_warnings": "myst.xref_missing",
    }  # fmt: skip
    words = [word for key, value in settings.items() for word in ("-D", f"{key}={value}")]
    environment = process_environment(PYTHONPATH=f"{HERE.parent}:{DOCS / 'extensions'}")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-C", *words, str(source), str(folder / "html")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return folder / "html" / f"{name}.html"


class _Links(HTMLParser):
    """The targets and the anchors of a page."""

    def __init__(self, text: str):
        super().__init__()
        self.targets: list[str] = []
        self.anchors: set[str] = {"", "top"}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.targets += [value for key, value in attrs if key in ("href", "src") and value]
        self.anchors |= {value for key, value in attrs if key == "id" and value}


def dead(folder: Path) -> list[str]:
    """Each link of built pages, and of llms.txt beside them, that leads to no file of the folder or to no anchor."""
    pages = {page: _Links(page.read_text(encoding="utf-8")) for page in sorted(folder.rglob("*.html"))}
    links = [(page, target) for page, found in pages.items() for target in found.targets]
    for page in folder.glob("llms.txt"):
        links += [(page, target) for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))]
    found = []
    for page, target in links:
        path, _, anchor = target.partition("#")
        file = (page.parent / unquote(path.partition("?")[0])).resolve() if path else page
        there = file.exists() and (file not in pages or unquote(anchor) in pages[file].anchors)
        if not re.match(r"[a-z]+:", target) and not there:
            found.append(f"{page.relative_to(folder)}: {target}")
    return found
