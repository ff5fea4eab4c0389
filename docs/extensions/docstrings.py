"""Docstrings are plain text with `names` in backticks; in reStructuredText |, * and _ mean something."""

import re
from itertools import pairwise
from typing import Any

from docutils import nodes
from numpy.typing import ArrayLike
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, NumpyDocstring
from sphinx.util.typing import stringify_annotation

NAME = re.compile(r"`([^`]+)`")
SECTIONS = Config(napoleon_use_param=False, napoleon_use_rtype=False)
ARRAY = stringify_annotation(ArrayLike, "smart")


def plain(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """The lines of a docstring, in place, so that they look as they were written; indented lines are formulas.

    Sphinx's napoleon sets the sections.
    """
    output: list[str] = []
    in_sections = False
    for line, below in pairwise([*lines, ""]):
        in_sections |= set(below) == {"-"}
        indented = line.startswith("    ") and not in_sections
        if indented and not (output and (output[-1].startswith("    ") or not output[-1].strip())):
            output += ["", "::", ""]
        if not indented and not in_sections and output and output[-1].startswith("    "):
            output.append("")
        output.append(line if indented else _escaped(line))
    lines[:] = NumpyDocstring(output, SECTIONS).lines()


def short(app: Sphinx, what: str, name: str, thing: Any, options: Any, signature: Any, returned: Any) -> Any:
    """A signature with the name ArrayLike in place of its long type."""
    return signature and signature.replace(ARRAY, "~numpy.typing.ArrayLike"), returned


def dashes(app: Sphinx, doctree: nodes.document) -> None:
    """A dash for the two hyphens that Sphinx puts between a name and its meaning."""
    for body in doctree.findall(nodes.field_body):
        for text in [text for text in body.findall(nodes.Text) if " -- " in text]:
            text.parent.replace(text, nodes.Text(text.replace(" -- ", " – ", 1)))


def _escaped(line: str) -> str:
    words = NAME.split(line)  # text, name, text, name, …
    return "".join(f"``{word}``" if k % 2 else re.sub(r"([\\|*]|_\b)", r"\\\1", word) for k, word in enumerate(words))


def setup(app: Sphinx) -> dict[str, bool]:
    """Read every docstring this way."""
    app.connect("autodoc-process-docstring", plain)
    app.connect("autodoc-process-signature", short)
    app.connect("doctree-read", dashes)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
