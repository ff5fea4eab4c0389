"""A class of a user's own file, named as my_plant.py:Tank. A file is code: it is run when somebody names it."""

import hashlib
from pathlib import Path
from typing import Any, NamedTuple

from npred.errors import ConfigError
from npred.plants import blame

SUFFIX = ".py:"


class Loaded(NamedTuple):
    """A class, its name, and the sha256 of its file."""

    name: str
    declaration: Any
    source: str


def named(spec: str) -> bool:
    """Whether the text names a class of a file."""
    return SUFFIX in spec


def split(spec: str) -> tuple[Path, str]:
    """File and class of my_plant.py:Tank."""
    path, _, name = spec.partition(SUFFIX)
    return Path(path + ".py"), name


def digest(what: str, path: Path) -> str:
    """The sha256 of the file. Raises ConfigError where it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError(f"{what}: expected a file at {path}, got: {error.strerror}; check the path") from None


def load(what: str, spec: str) -> Loaded:
    """Run the file and take the class. Raises ConfigError, in one line, where either is missing or the file fails."""
    path, name = split(spec)
    if not path.is_file():
        raise ConfigError(
            f"{what} {spec}: expected a Python file, found none at {path}; check the path, which a pipeline gives from "
            "its own folder and the command line from yours"
        )
    text = path.read_bytes()
    space: dict[str, Any] = {"__name__": path.stem, "__file__": str(path)}
    try:
        exec(compile(text, str(path), "exec"), space)
    except SyntaxError as error:
        line = f":{error.lineno}" if error.lineno else ""
        raise ConfigError(f"{what} {path}{line}: expected Python, got a syntax error: {error.msg}; mend it") from None
    except (Exception, SystemExit) as error:
        line = blame.last_line(error, str(path))
        raise ConfigError(f"{what} {path}{line}: failed on import: {blame.told(error)}; mend the file") from None
    if not isinstance(space.get(name), type):
        own = [key for key, value in space.items() if isinstance(value, type) and value.__module__ == path.stem]
        raise ConfigError(
            f"{what} {path}: expected a class {name}, found {', '.join(own) or 'none'}; check the name after the colon"
        )
    return Loaded(name, space[name], hashlib.sha256(text).hexdigest())
