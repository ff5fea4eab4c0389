"""Public docstrings with the sections of NumPy's style, for help() and the reference."""

import inspect
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from textwrap import fill
from typing import Any, get_origin

WIDTH = 100  # of a line of help()
Rows = Sequence[Sequence[str]]  # of two texts


@cache
def table() -> Mapping[str, Any]:
    """npred/parameters.toml: tables of "type: meaning" by a parameter's name."""
    return tomllib.loads(files("npred").joinpath("parameters.toml").read_text(encoding="utf-8"))


@cache
def documented(thing: Any) -> Any:
    """A function or class, with sections in its docstring: Parameters, where the table has all of them; Returns and
    Raises by its last paragraphs "Returns …." and "Raises AError for …; BError for ….".

    Without such words a class that is returned says itself what it is.
    """
    text, _, raised = inspect.cleandoc(thing.__doc__ or "").partition("\nRaises ")
    text, _, returned = text.partition("\nReturns ")
    signature = inspect.signature(thing)
    rows = table()["any"] | table().get(thing.__qualname__, {})
    sections: dict[str, Rows] = {}
    if all(name in rows for name in signature.parameters if name != "self"):
        sections["Parameters"] = [_parameter(p, rows[n]) for n, p in signature.parameters.items() if n != "self"]
    sections["Returns"] = [*_returned(signature.return_annotation, returned)]
    sections["Raises"] = [part.partition(" ")[::2] for part in _joined(raised).split("; ") if part]
    thing.__doc__ = "\n".join([text.strip(), *(line for head, rows in sections.items() for line in _lines(head, rows))])
    return thing


def _parameter(parameter: inspect.Parameter, words: str) -> tuple[str, str]:
    kind, _, meaning = words.partition(": ")
    star = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
    if parameter.default is not parameter.empty:
        empty = str(parameter.default) in ("None", "", "()", "{}")
        kind += ", optional" if empty else ", default " + repr(parameter.default).replace("'", '"')
    return f"{star}{parameter.name} : {kind}", meaning


def _returned(annotation: Any, words: str) -> Iterator[tuple[str, str]]:
    kind = get_origin(annotation) or annotation
    if words:
        yield inspect.formatannotation(annotation), words
    elif getattr(kind, "__module__", "").startswith("npred."):
        yield kind.__name__, (kind.__doc__ or "").partition("\n\n")[0]


def _joined(words: str) -> str:
    return " ".join(words.split()).rstrip(".")


def _lines(head: str, rows: Rows) -> Iterator[str]:
    if rows:
        yield from ("", head, "-" * len(head))
    for name, words in rows:
        sentence = _joined(words[0].upper() + words[1:]) + "."
        yield from (name, fill(sentence, WIDTH, initial_indent="    ", subsequent_indent="    "))
