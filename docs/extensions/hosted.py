"""Links that lead to a file on a host of the repository, and to the page made of it where the pages are built.

The gallery's pages are made of scripts, those of the reference of code: neither are files of the repository.
"""

import re
from pathlib import Path

from sphinx.application import Sphinx

LINK = re.compile(r"\]\(([^)\s:]+)\)")


def made(target: str) -> str:
    """The page that is made of a link's target, or the target."""
    target = re.sub(r"gallery/(README\.md)?$", "examples/index.rst", target)
    target = re.sub(r"gallery/(\w+)\.py$", r"examples/\1.rst", target)
    return re.sub(r"README\.md#([a-z-]+)$", lambda found: f"{found[1].replace('-', '_')}.md", target)


def lead(app: Sphinx, page: str, source: list[str]) -> None:
    """The text of a page, in place, its links to what is made."""
    source[0] = LINK.sub(lambda link: f"]({made(link[1])})", source[0])


def write(app: Sphinx, error: Exception | None) -> None:
    """llms.txt beside the pages, with links to them."""
    if app.builder.format == "html" and error is None:
        text = (Path(app.srcdir) / "llms.txt").read_text(encoding="utf-8")
        pages = LINK.sub(lambda link: f"]({re.sub(r'[.](md|rst)$', '.html', made(link[1]))})", text)
        (Path(app.outdir) / "llms.txt").write_text(pages, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Read every page this way."""
    app.connect("source-read", lead)
    app.connect("build-finished", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
