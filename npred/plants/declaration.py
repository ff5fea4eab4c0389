"""What a plant's author declared, checked part by part: a mistake is told in one line, before anything is traced."""

import math
import re
from collections.abc import Mapping, Sequence
from keyword import iskeyword
from typing import Any

import numpy as np

from npred.errors import ConfigError, similar

NAME = re.compile(r"\w[\w., -]{0,99}")
REQUIRED = ("states", "inputs", "f", "kappa")
LONGEST = 40  # letters of a label or a unit
MARKUP = set("$\\")  # what matplotlib would read as mathematics


def called(plant: Any) -> None:
    """Raise ConfigError for a name of a plant that could be more than a name where it is written, in C say."""
    if not isinstance(plant, str) or not NAME.fullmatch(plant):
        raise ConfigError(
            f"plant: expected a name of letters, digits, spaces and . , _ -, got {plant!r}; choose another"
        )


def check(plant: str, declaration: Any) -> None:
    """Raise ConfigError for a part that is missing, or for an f, kappa or V that is no function."""
    for part in REQUIRED:
        if not hasattr(declaration, part):
            raise ConfigError(f"plant {plant}: expected {', '.join(REQUIRED)}, found no {part}; declare it")
    for part in [*REQUIRED[2:], "V", "reference"]:
        if not callable(getattr(declaration, part, check)):
            raise ConfigError(f"plant {plant}: expected {part} to be a function, got {getattr(declaration, part)!r}")


def completed(declaration: Any) -> Any:
    """The declaration, with V = 0 where it has none: such a plant can be looked at, and be offered one."""
    if hasattr(declaration, "V"):
        return declaration
    return type(declaration.__name__, (declaration,), {"V": staticmethod(_zero)})


def _zero(x: Any, t: Any, p: Any, M: Any = None) -> Any:
    return np.zeros(len(x)) if M is None else 0.0


def names(plant: str, part: str, given: Any) -> tuple[str, ...]:
    """The names of states, inputs or parameters. Raises ConfigError unless they are different identifiers."""
    if isinstance(given, str) or not isinstance(given, Sequence | Mapping):
        raise ConfigError(f'plant {plant}: {part} expected names as ("h",), got {given!r}; write a tuple')
    for name in given:
        if not isinstance(name, str) or not name.isidentifier() or iskeyword(name) or name.startswith("_"):
            raise ConfigError(f"plant {plant}: {part} expected names that Python accepts, got {name!r}; rename it")
    if len(set(given)) < len(given) or (not given and part != "parameters"):
        raise ConfigError(f"plant {plant}: {part} expected different names, at least one, got {tuple(given)}; fix it")
    return tuple(given)


def parameters(plant: str, defaults: Any, overrides: Mapping[str, Any]) -> dict[str, float]:
    """The parameters' values. Raises ConfigError for one that is not declared, or is not a finite number."""
    if not isinstance(defaults, Mapping):
        raise ConfigError(f'plant {plant}: parameters expected a table {{"a": 1.0}}, got {defaults!r}; write a dict')
    names(plant, "parameters", defaults)
    for key in overrides:
        if key not in defaults:
            known = ", ".join(defaults) or "none"
            near = similar(key, defaults)
            raise ConfigError(f"plant {plant}: unknown parameter {key!r}; expected one of: {known}{near}")
    return {key: _number(f"plant {plant}: parameter {key}", value) for key, value in {**defaults, **overrides}.items()}


def box(plant: str, given: Any, states: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """The range of each initial state. Raises ConfigError for a state that is not declared, or for no range."""
    if not isinstance(given, Mapping):
        raise ConfigError(f'plant {plant}: box expected ranges as {{"h": (0.0, 1.0)}}, got {given!r}; write a dict')
    for name in given:
        if name not in states:
            raise ConfigError(f"plant {plant}: box has an unknown state {name!r}; expected one of {', '.join(states)}")
    ranges = {name: span(f"plant {plant}: box[{name!r}]", value) for name, value in given.items()}
    for name, ends in ranges.items():
        if not np.isfinite(ends).all():
            raise ConfigError(f"plant {plant}: box[{name!r}] expected finite ends, got {ends}; fix it")
    return ranges


def guess(plant: str, given: Any, n: int) -> np.ndarray:
    """Where the equilibrium is searched from, (n,). Raises ConfigError for anything else."""
    try:
        values = np.array(given, dtype=float)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (n,) or not np.isfinite(values).all():
        raise ConfigError(f"plant {plant}: guess expected {n} finite numbers, one per state, got {given!r}; fix it")
    return values


def input_bounds(plant: str, given: Any, m: int) -> list[tuple[float, float]] | None:
    """The range of each input, or None. Raises ConfigError for a wrong number of ranges, or for no range."""
    if given is None:
        return None
    if isinstance(given, str | Mapping) or np.ndim(given) != 2 or len(given) != m:
        raise ConfigError(f"plant {plant}: input_bounds expected {m} pairs (low, high), got {given!r}; one per input")
    return [span(f"plant {plant}: input_bounds[{k}]", pair) for k, pair in enumerate(given)]


def delays(plant: str, given: Any, m: int) -> tuple[float, ...] | None:
    """The delay of each input in seconds, or None. Raises ConfigError unless they are m positive numbers."""
    if given is None:
        return None
    if isinstance(given, str | Mapping) or np.ndim(given) != 1 or len(given) != m:
        raise ConfigError(f"plant {plant}: delays expected {m} seconds, one per input, got {given!r}; fix it")
    values = tuple(_number(f"plant {plant}: delays[{k}]", value) for k, value in enumerate(given))
    if min(values) <= 0:
        raise ConfigError(f"plant {plant}: delays expected seconds above 0, got {given!r}; fix it")
    return values


def period(plant: str, given: Any) -> float | None:
    """After how many seconds f and kappa repeat, or None. Raises ConfigError unless it is a positive number."""
    if given is None:
        return None
    seconds = _number(f"plant {plant}: period", given)
    if seconds <= 0:
        raise ConfigError(f"plant {plant}: period expected seconds above 0, got {given!r}; fix it")
    return seconds


def texts(plant: str, part: str, given: Any, known: tuple[str, ...]) -> dict[str, str]:
    """Labels or units by state or input. Raises ConfigError for a name that is not declared, or for no such text."""
    if not isinstance(given, Mapping):
        raise ConfigError(f'plant {plant}: {part} expected texts as {{"h": "m"}}, got {given!r}; write a dict')
    for name in given:
        if name not in known:
            raise ConfigError(f"plant {plant}: {part} has an unknown name {name!r}; expected one of {', '.join(known)}")
    return {name: text(f"plant {plant}: {part}[{name!r}]", value) for name, value in given.items()}


def text(what: str, given: Any) -> str:
    """A few words for a figure. Raises ConfigError unless it is one short line of plain text."""
    if not isinstance(given, str) or not given.isprintable() or len(given) > LONGEST or MARKUP & set(given):
        raise ConfigError(
            f"{what}: expected up to {LONGEST} letters on one line, without $ and backslash, got {given!r}; shorten it"
        )
    return given.strip()


def span(what: str, given: Any) -> tuple[float, float]:
    """A range (low, high). Raises ConfigError unless it is two numbers in order."""
    try:
        low, high = (float(end) for end in given)
    except (TypeError, ValueError):
        low = high = math.nan
    if not low <= high:
        raise ConfigError(f"{what}: expected a range (low, high) with low <= high, got {given!r}; fix it")
    return low, high


def _number(what: str, given: Any) -> float:
    try:
        value = float(given)
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{what}: expected a finite number, got {given!r}; fix it")
    return value
