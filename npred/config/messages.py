"""What is wrong with a pipeline file, in one line."""

from collections.abc import Iterable, Iterator
from typing import Any, get_args

from pydantic import ValidationError
from pydantic.fields import FieldInfo

from npred.config.pipeline import Pipeline
from npred.config.section import Section
from npred.config.train import Network
from npred.errors import similar

GONE = {  # tables and keys of earlier versions
    "refine": "expected no such table, for that stage was taken out; drop it, and check networks by [evaluate.guard]",
    "evaluate.guard.correct": "expected no such key, for the correction was taken out: it hid errors; drop it",
}


def sentence(error: ValidationError) -> str:
    """The first fault of a pipeline, with its key: what was expected, what came."""
    first: Any = error.errors()[0]
    named = [part for part in first["loc"] if part != "float"]  # without a union's types
    fields = [part for part in named if isinstance(part, int) or part.isidentifier()]
    where = ".".join(str(part) for part in fields)
    if first["type"] == "extra_forbidden":
        path = first["loc"] + tuple(first.get("ctx", {}).values())
        where = ".".join(map(str, path))
        return f"{where}: {_unknown(where, _siblings(path))}"
    if first["type"] == "fault":
        place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in fields)
        return f"{place.removeprefix('.')}: {first['msg']}"
    if first["type"] == "value_error":
        return f"{where + '.' if where else ''}{first['ctx']['error']}"
    if first["type"] == "missing":
        example = ' as plant = "my_plant.py:Tank"' if where == "plant" else ""
        return f"{where}: expected a value, found none; add it{example}"
    if first["type"] == "too_short":
        return f"{where}: expected at least one value, got {first['input']!r}; give one"
    expected = [
        e["msg"].removeprefix("Input should be ") for e in error.errors() if e["loc"][: len(fields)] == tuple(fields)
    ]
    return f"{where}: expected {' or '.join(dict.fromkeys(expected))}, got {first['input']!r}; give such a value"


def _unknown(key: str, siblings: list[str]) -> str:
    return GONE.get(key) or f"unknown key; expected one of {', '.join(siblings)}{_meant(key, siblings)}"


def _siblings(loc: tuple[int | str, ...]) -> list[str]:
    model: Any = Pipeline
    for part in loc[:-1]:
        if isinstance(part, str):
            model = _table(model.model_fields[part].annotation) if part in model.model_fields else Network
    return sorted(model.model_fields)


def _table(kind: Any) -> Any:
    """The table that a key holds, or a list of."""
    return next(
        (part for part in (kind, *get_args(kind)) if isinstance(part, type) and issubclass(part, Section)), kind
    )


def _meant(key: str, siblings: list[str]) -> str:
    """A suggestion for an unknown key: one of the same table that is spelt alike, else one of another table."""
    leaf = key.rpartition(".")[2]
    near = similar(leaf, siblings)
    keys = [other for other, _ in leaves()]
    elsewhere = [other for other in keys if other.rpartition(".")[2] == leaf]
    if elsewhere and "sizes" in siblings:
        return f"; did you mean sizes = {{ {leaf} = … }}?"
    return near or (f"; did you mean {' or '.join(elsewhere)}?" if elsewhere else similar(key, keys))


def leaves(
    model: type[Section] = Pipeline, path: str = "", networks: Iterable[str] = ()
) -> Iterator[tuple[str, FieldInfo]]:
    """Every key of a pipeline file, dotted, with its declaration; `networks` are names of tables below train."""
    for name in networks:
        yield from leaves(Network, f"train.{name}.")
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, Section):
            yield from leaves(field.annotation, f"{path}{name}.")
        else:
            yield path + name, field
