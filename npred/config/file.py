"""Pipeline files: read, overridden by `--set`, parsed."""

import os
import stat
import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from npred import defaults
from npred.config.messages import sentence
from npred.config.pipeline import Pipeline
from npred.config.section import moved
from npred.errors import ConfigError

LONGEST = 2**20  # bytes of a pipeline file


def load(path: Path, overrides: list[str] | None = None) -> Pipeline:
    """The pipeline of a TOML file with `key.path=value` overrides applied.

    Files that it names (a plant's, a delay law's, data) are relative to its folder; those of overrides, and of a
    pipeline that comes through a pipe, to the current one.
    Raises ConfigError, in one line, for a file that is missing or no TOML, an unknown key, a wrong type or value.
    """
    data = table(path)
    for override in overrides or []:
        _apply(data, override)
    return parse(data, str(path))


def table(path: Path) -> dict[str, Any]:
    """The tables of a TOML file as they stand, the files that they name found from here. Raises as `load` does."""
    try:
        folder = path.parent if path.is_file() else Path()
        return moved(tomllib.loads(_file_text(path)), lambda file: str(folder / file))
    except FileNotFoundError:
        raise ConfigError(defaults.missing(path)) from None
    except (OSError, ValueError, RecursionError) as error:
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
        raise ConfigError(f"{source}: {sentence(error)}") from None


def _apply(data: dict[str, Any], override: str) -> None:
    key, sign, text = override.partition("=")
    if not sign or not key:
        raise ConfigError(
            f"--set: expected key.path=value, got {override!r}; for example --set train.deeponet.epochs=5"
        )
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text  # a bare word is a string, so that --set plant=scalar needs no quotes
    put(data, key, value, "--set ")


def put(data: dict[str, Any], key: str, value: Any, what: str = "") -> None:
    """Set a key of tables in place, as train.deeponet.epochs. Raises ConfigError, after `what`, for no such path."""
    *parents, leaf = key.split(".")
    for parent in parents:
        data = data.setdefault(parent, {})
        if not isinstance(data, dict):
            raise ConfigError(f"{what}{key}: expected a table at {parent!r}, got {data!r}; check the key's path")
    data[leaf] = value
