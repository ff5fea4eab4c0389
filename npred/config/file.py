"""Pipeline files: read, overridden by `--set`, parsed; and what is wrong with one, in one line."""

import dataclasses
import json
import os
import re
import stat
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, get_args

from pydantic import ValidationError
from pydantic.fields import FieldInfo

from npred import defaults
from npred.config.pipeline import Pipeline
from npred.config.section import Section, moved
from npred.config.train import Network
from npred.errors import ConfigError, similar

LONGEST = 2**20  # bytes of a pipeline file
GONE = {  # tables and keys of earlier versions
    "refine": "expected no such table, for that stage was taken out; drop it, and check networks by [evaluate.guard]",
    "evaluate.guard.correct": "expected no such key, for the correction was taken out: it hid errors; drop it",
}


WORDS = {  # of what pydantic expects, in turn
    "^Input should be ": "",
    "^a valid (list|tuple|dictionary|boolean|string).*": r"a \1",
    "^a tuple$": "a range [low, high]",
    "^a dictionary$": "a table",
    "^a boolean$": "true or false",
    "^a string$": "a text in quotes",
    "^a valid integer.*": "a whole number",
    "^a valid number.*": "a number",
    "^greater than or equal to (.*)": r"a number of at least \1",
    "^greater than (.*)": r"a number above \1",
    "^less than or equal to (.*)": r"a number of at most \1",
    "^less than (.*)": r"a number below \1",
}


def load(path: str | Path, overrides: list[str] | None = None) -> Pipeline:
    """The pipeline of a TOML file with `key.path=value` overrides applied.

    Files that it names (a plant's, a delay law's, data) are relative to its folder; those of overrides, and of a
    pipeline that comes through a pipe, to the current one.
    Raises ConfigError, in one line, for a file that is missing or no TOML, an unknown key, a wrong type or value.
    """
    path = Path(path)
    data = table(path)
    for text in overrides or []:
        override(data, text)
    return parse(data, str(path))


def table(path: Path) -> dict[str, Any]:
    """The tables of a TOML file as they stand, the files that they name found from here. Raises as `load` does."""
    try:
        folder = path.parent if path.is_file() else Path()
        return moved(tomllib.loads(_file_text(path)), lambda file: str(folder / file))
    except FileNotFoundError:
        raise ConfigError(defaults.missing(path)) from None
    except (OSError, ValueError, RecursionError) as error:
        if path.suffix == ".py":
            raise ConfigError(defaults.of_code(path)) from None
        raise ConfigError(f"{path}: expected a TOML file, got: {error}; write TOML, as seed = 0") from None


def _file_text(path: Path) -> str:
    """The text of a file, or of a pipe that somebody writes to: an abandoned one would be waited for without an end."""
    waits = getattr(os, "O_NONBLOCK", 0)  # Windows has no pipes among its files
    descriptor = os.open(path, os.O_RDONLY | waits)
    with open(descriptor, "rb", buffering=0) as file:
        first = file.read(LONGEST + 1)  # None where a pipe's writer has written nothing yet
        if first == b"" and stat.S_ISFIFO(os.fstat(descriptor).st_mode):
            raise ValueError("a pipe that nobody writes to")
        content = first or b""
        if waits:
            os.set_blocking(descriptor, True)
        while chunk := file.read(LONGEST + 1 - len(content)):
            content += chunk
    if len(content) > LONGEST:
        raise ValueError(f"more than {LONGEST} bytes")
    return content.decode("utf-8")


def parse(data: dict[str, Any], source: str) -> Pipeline:
    """The pipeline of a plain dictionary; `source` names it in errors."""
    try:
        return Pipeline.model_validate(data)
    except ValidationError as error:
        raise ConfigError(f"{source}: {_sentence(error)}") from None


def override(data: dict[str, Any], text: str) -> None:
    """Set a key of tables in place by the text key.path=value. Raises ConfigError for another one."""
    key, sign, value_text = text.partition("=")
    if not sign or not key:
        raise ConfigError(f"--set: expected key.path=value, got {text!r}; for example --set train.deeponet.epochs=5")
    put(data, key, value(value_text), "--set ")


def value(text: str) -> Any:
    """A value of TOML; a bare word is a string, so that --set plant=scalar needs no quotes."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def put(data: dict[str, Any], key: str, value: Any, what: str = "") -> None:
    """Set a key of tables in place, as train.deeponet.epochs. Raises ConfigError, after `what`, for no such path."""
    *parents, leaf = key.split(".")
    for parent in parents:
        data = data.setdefault(parent, {})
        if not isinstance(data, dict):
            raise ConfigError(f"{what}{key}: expected a table at {parent!r}, got {data!r}; check the key's path")
    data[leaf] = value


def _sentence(error: ValidationError) -> str:
    """The first fault of a pipeline, with its key: what was expected, what came."""
    first: Any = error.errors()[0]
    named = [part for part in first["loc"] if part != "float"]  # without a union's types
    fields = [part for part in named if isinstance(part, int) or part.isidentifier()]
    where = ".".join(str(part) for part in fields)
    if first["type"] == "extra_forbidden":
        path = first["loc"] + tuple(first.get("ctx", {}).values())
        where = ".".join(map(str, path))
        keys = _siblings(path)
        unknown = f"unknown key; expected one of {', '.join(keys)}{_meant(where, keys)}"
        return f"{where}: {GONE.get(where, unknown)}"
    if first["type"] == "fault":
        place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in fields)
        return f"{place.removeprefix('.')}: {first['msg']}"
    if first["type"] == "value_error":
        said = str(first["ctx"]["error"])
        if fields and said.startswith(f"{fields[-1]}:"):  # of a dataclass, which names itself
            where = ".".join(map(str, fields[:-1]))
        return f"{where + '.' if where else ''}{said}"
    if first["type"] == "missing":
        example = ' as plant = "my_plant.py:Tank"' if where == "plant" else ""
        return f"{where}: expected a value, found none; add it{example}"
    if first["type"] == "too_short":
        return f"{where}: expected at least one value, got {first['input']!r}; give one"
    words = [_words(e["msg"]) for e in error.errors() if e["loc"][: len(fields)] == tuple(fields)]
    # "a number or a number above 0" is a number above 0
    expected = [word for word in dict.fromkeys(words) if not any(other.startswith(f"{word} ") for other in words)]
    came = first["input"]
    near = similar(str(came), re.findall(r"'(.*?)'", " ".join(expected))) or f"; {_cure(expected, came)}"
    return f"{where}: expected {' or '.join(expected)}, got {came!r}{near}"


def _cure(expected: list[str], came: Any) -> str:
    """What to write instead: 1000 for 1e3, [0.5] for 0.5."""
    if "a whole number" in expected and isinstance(came, float) and came.is_integer():
        return f"write {came:.0f}"
    single = expected == ["a list"] and isinstance(came, str | int | float)
    return f"write {json.dumps([came])}" if single else "write such a value"


def _words(message: str) -> str:
    """What pydantic expects, in the words of npred."""
    for form, words in WORDS.items():
        message = re.sub(form, words, message)
    return message


def _siblings(loc: tuple[int | str, ...]) -> list[str]:
    model: Any = Pipeline
    for part in loc[:-1]:
        if isinstance(part, str):
            model = _table(model.model_fields[part].annotation) if part in model.model_fields else Network
    return sorted(getattr(model, "model_fields", None) or [field.name for field in dataclasses.fields(model)])


def _table(kind: Any) -> Any:
    """The table that a key holds, or a list of."""
    parts = (kind, *get_args(kind))
    return next((part for part in parts if dataclasses.is_dataclass(part) or hasattr(part, "model_fields")), kind)


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
        elif dataclasses.is_dataclass(field.annotation):
            for key in dataclasses.fields(field.annotation):
                kind: Any = key.type
                yield f"{path}{name}.{key.name}", FieldInfo.from_annotated_attribute(kind, key.default)
        else:
            yield path + name, field
