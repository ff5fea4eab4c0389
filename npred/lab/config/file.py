"""Pipeline files: read, overridden by `--set`, parsed, written; and the fault of one, in one line."""

import json
import os
import re
import reprlib
import stat
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from npred.base import defaults, json_files
from npred.base.errors import ConfigError, similar
from npred.lab.config import section
from npred.lab.config.pipeline import Pipeline
from npred.lab.config.section import Section, map_paths, tables

LONGEST = 2**20  # bytes of a pipeline file


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
        return map_paths(tomllib.loads(_file_text(path)), lambda file: str(folder / file))
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
    """The first fault of a pipeline: its key, what was expected there, and what came. An unknown key of the top level
    comes first: what is below it was meant for another table, which may be faulty without it. In a value that may be of
    several types, the deepest fault counts.
    """
    faults: list[Any] = error.errors()
    first = min(faults, key=lambda each: (each["type"], len(each["loc"])) != ("extra_forbidden", 1))
    key = _key(first)
    first = max((each for each in faults if _key(each) == key), key=lambda each: len(_path(each)))
    unknown, path = first["type"] == "extra_forbidden", _path(first)
    where = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).removeprefix(".")
    where = json_files.escaped(where)
    if unknown:
        keys, leaf = list(_leaves()), str(path[-1])
        table = "".join(f"{part}." for part in path[:-1] if isinstance(part, str))
        there = sorted({key.removeprefix(table).partition(".")[0] for key in keys if key.startswith(table)})
        expected = f"; expected one of {', '.join(there)}" if there else ""
        elsewhere = " or ".join(key for key in keys if key.endswith(f".{leaf}") and ".scenarios." not in key)
        near = similar(leaf, there) or similar(leaf, [part for key in keys for part in key.split(".")])
        return f"{where}: unknown key{expected}" + (f"; did you mean {elsewhere}?" if elsewhere else near)
    if first["type"] == "fault":
        return f"{where}: {first['msg']}"
    if first["type"] == "value_error":  # which begins with a key; a dataclass names itself
        said = str(first["ctx"]["error"])
        above = where.rpartition(".")[0] if path and said.startswith(f"{path[-1]}:") else where
        return f"{above + '.' if above else ''}{said}"
    said = [section.expected(each) for each in faults if _path(each) == path]
    kinds, cures = (list(dict.fromkeys(each)) for each in zip(*said, strict=True))
    kinds, cure = " or ".join(kinds), cures[0] if len(cures) == 1 else "write one of these"
    came = "none" if first["type"] == "missing" else reprlib.repr(first["input"])
    near = similar(str(first["input"]), re.findall(r"'(.*?)'", kinds)) or f"; {cure}"
    return f"{where}: expected {kinds}, got {came}{near}"


def _path(error: Any) -> list[str | int]:
    """Where an error is: its keys and places in lists, without the names of a union's types."""
    unknown = error["type"] == "extra_forbidden"
    loc = [*error["loc"], *(error.get("ctx", {}).values() if unknown else ())]
    keys, key = (loc[:-1], loc[-1:]) if unknown else (loc, [])  # an unknown one may be anything
    return [part for part in keys if isinstance(part, int) or (part.isidentifier() and part != "float")] + key


def _key(error: Any) -> list[str | int]:
    """The key whose value an error is in, without the places in its lists."""
    path = _path(error)
    while path and isinstance(path[-1], int):
        path.pop()
    return path


def _leaves(model: type = Pipeline, path: str = "") -> Iterator[str]:
    """Every key of a pipeline file, dotted."""
    if issubclass(model, Section):
        kinds = {name: field.annotation for name, field in model.model_fields.items()}
    else:
        kinds = {field.name: field.type for field in fields(model)}
    for name, kind in kinds.items():
        inner = tables(kind)
        yield from _leaves(inner[0], f"{path}{name}.") if inner else [path + name]


def dumps(table: Mapping[str, object]) -> str:
    """The TOML text of nested tables, which nothing in Python writes; a key with the value None is left out."""
    return "\n".join(_lines(table, ())).strip() + "\n"


def _lines(table: Mapping[str, object], path: tuple[str, ...]) -> list[str]:
    filled = {key: value for key, value in table.items() if value is not None}
    leaves = [f"{_written(key)} = {_value(value)}" for key, value in filled.items() if not isinstance(value, Mapping)]
    head = ["", f"[{'.'.join(map(_written, path))}]"] if path and (leaves or not filled) else []
    below = [line for k, v in filled.items() if isinstance(v, Mapping) for line in _lines(v, (*path, k))]
    return [*head, *leaves, *below]


def _written(key: str) -> str:
    return key if re.fullmatch("[A-Za-z0-9_-]+", key) else json.dumps(key, ensure_ascii=False)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        filled = {_written(key): _value(item) for key, item in value.items() if item is not None}
        return f"{{ {', '.join(f'{key} = {item}' for key, item in filled.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value)
