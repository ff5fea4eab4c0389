"""Docstrings are plain text with `names` in backticks; in reStructuredText |, * and _ mean something."""

import re
from typing import Any

from sphinx.application import Sphinx

NAME = re.compile(r"`([^`]+)`")


def plain(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """The lines of a docstring, in place, so that they look as they were written; what is indented is a formula."""
    made: list[str] = []
    for line in lines:
        indented = line.startswith("    ")
        if indented and not (made and (made[-1].startswith("    ") or not made[-1].strip())):
            made += ["", "::", ""]
        if not indented and made and made[-1].startswith("    "):
            made.append("")
        made.append(line if indented else _escaped(line))
    lines[:] = made


def _escaped(line: str) -> str:
    words = NAME.split(line)  # text, name, text, name, …
    return "".join(f"``{word}``" if k % 2 else re.sub(r"([\\|*]|_\b)", r"\\\1", word) for k, word in enumerate(words))


def setup(app: Sphinx) -> dict[str, bool]:
    """Read every docstring this way."""
    app.connect("autodoc-process-docstring", plain)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
