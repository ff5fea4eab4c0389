"""A class of a user's own file, named as my_plant.py:Tank. A file is code: it is run when somebody names it."""

import hashlib
import inspect
from keyword import iskeyword
from pathlib import Path
from typing import Any, NamedTuple

from npred import json_files
from npred.errors import ConfigError
from npred.symbolic import source_lines

SUFFIX = ".py:"


class Source(NamedTuple):
    """A file of code: its name without folders, its text, and the sha256 of its bytes."""

    file: str
    text: str
    sha256: str


class Loaded(NamedTuple):
    """A class, its name, and its file."""

    name: str
    declaration: Any
    source: Source


def named(spec: str) -> bool:
    """Whether the text names a class of a file."""
    return SUFFIX in spec


def split(spec: str) -> tuple[Path, str]:
    """File and class of my_plant.py:Tank. Raises ConfigError for a class that no Python file could have."""
    path, _, name = spec.partition(SUFFIX)
    if not name.isidentifier() or iskeyword(name):
        raise ConfigError(f"{spec}: expected the name of a class after the colon, got {name!r}; write my_plant.py:Tank")
    return Path(path + ".py"), name


def read(what: str, path: Path) -> Source:
    """The file as it is now. Raises ConfigError where it cannot be read, or is none: a pipe, a device."""
    try:
        return _source(path, json_files.regular(path).read_bytes())
    except OSError as error:
        raise ConfigError(f"{what}: expected a file at {path}, got: {error.strerror}; check the path") from None


def declaring(declaration: Any) -> Source | None:
    """The file of the module that a class comes from; None where there is none, as at a prompt."""
    try:
        path = Path(inspect.getfile(declaration))
        return _source(path, path.read_bytes())
    except (TypeError, OSError):
        return None


def _source(path: Path, content: bytes) -> Source:
    return Source(path.name, content.decode(errors="replace"), hashlib.sha256(content).hexdigest())


def load(what: str, spec: str) -> Loaded:
    """Run the file and take the class. Raises ConfigError, in one line, where either is missing or the file fails."""
    path, name = split(spec)
    if not path.is_file():  # a pipe or a device would be read without an end
        raise ConfigError(
            f"{what} {spec}: expected a Python file, found none at {path}; check the path, which a pipeline gives from "
            "its own folder and the command line from yours"
        )
    content = path.read_bytes()
    space: dict[str, Any] = {"__name__": path.stem, "__file__": str(path)}
    try:
        exec(compile(content, str(path), "exec"), space)
    except SyntaxError as error:
        line = f":{error.lineno}" if error.lineno else ""
        raise ConfigError(f"{what} {path}{line}: expected Python, got a syntax error: {error.msg}; fix it") from None
    except (Exception, SystemExit) as error:
        line = source_lines.last_line(error, str(path))
        raise ConfigError(f"{what} {path}{line}: failed on import: {source_lines.told(error)}; fix the file") from None
    if not isinstance(space.get(name), type):
        own = [key for key, value in space.items() if isinstance(value, type) and value.__module__ == path.stem]
        raise ConfigError(
            f"{what} {path}: expected a class {name}, found {', '.join(own) or 'none'}; check the name after the colon"
        )
    return Loaded(name, space[name], _source(path, content))
