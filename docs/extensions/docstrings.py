"""Docstrings are plain text with `names` in backticks; in reStructuredText |, * and _ mean something."""

import inspect
import re
from collections.abc import Iterator
from typing import Any

from sphinx.application import Sphinx

NAME = re.compile(r"`([^`]+)`")
# What a public argument is, wherever it has this name: its shape, its unit.
PARAMETERS = {
    "X": "states, (..., n), in the plant's units",
    "u": "inputs under way on the nodes of [0, 1], (..., nx, m); of one input (nx,) too",
    "D": "true delays in the plant's unit of time, (...), or a function of t",
    "D_hat": "estimates of the delay in the plant's unit of time, (...)",
    "X0": "states at t = 0, (..., n)",
    "t": "times in the plant's unit of time, (...)",
    "t_end": "length of the loops, in the plant's unit of time",
    "dt": "control step, in the plant's unit of time",
    "input_bounds": "pairs (low, high), (m, 2); by default the plant's",
    "u0": 'inputs before t = 0: numbers (m,), a table (k, m), a function of t, "equilibrium" or "law"',
    "samples": "steps to keep (X, u, D_hat) of, (..., S)",
    "every": "control steps between two kept states",
    "nx": "nodes on [0, 1], both ends in",
    "tolerance": "in units of U",
    "Q": "one number, or (n,), or (n, n)",
    "R": "one number, or one for each output",
}


def parameters(thing: Any) -> Iterator[str]:
    """The arguments of a function or a class with their defaults, of which PARAMETERS says more, as field list."""
    try:
        signature = inspect.signature(thing)
    except (TypeError, ValueError):
        return
    yield ""
    for name, argument in signature.parameters.items():
        if name in PARAMETERS:
            default = "" if argument.default is argument.empty else f"; by default ``{argument.default}``"
            yield f":param {name}: {_escaped(PARAMETERS[name])}{default if 'default' not in PARAMETERS[name] else ''}"


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
    public = what in ("function", "class", "method") and name.startswith("npred.")
    lines[:] = [*made, *(parameters(thing) if public else ())]


def _escaped(line: str) -> str:
    words = NAME.split(line)  # text, name, text, name, …
    return "".join(f"``{word}``" if k % 2 else re.sub(r"([\\|*]|_\b)", r"\\\1", word) for k, word in enumerate(words))


def setup(app: Sphinx) -> dict[str, bool]:
    """Read every docstring this way."""
    app.connect("autodoc-process-docstring", plain)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
