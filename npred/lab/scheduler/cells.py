"""Grids of pipelines: `train.deeponet.width=32,64,128` and `seed=0:10` to one configuration per cell."""

import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path

from npred.base.errors import ConfigError
from npred.lab import config
from npred.lab.config import Pipeline

MOST = 100_000
_RANGE = re.compile(r"(-?\d+):(-?\d+)(?::([1-9]\d*))?")
# A piece of a list: nothing of it outside of quotes and brackets is a comma.
_QUOTED = r'"(?:[^"\\]|\\.)*"|\'[^\']*\''


@dataclass(frozen=True)
class Cell:
    """One pipeline of a grid; `values` are those that set it apart from the others, as text."""

    values: dict[str, str]
    config: Pipeline

    @property
    def name(self) -> str:
        """For people: `train.deeponet.width=64 seed=3`."""
        return " ".join(f"{key}={value}" for key, value in self.values.items()) or self.config.name


def cells(path: Path, sets: Sequence[str]) -> list[Cell]:
    """Every combination of the values of `KEY=VALUES`, the last key the fastest; see `values`.

    Raises ConfigError for what `--set` refuses, naming the cell, and for a grid of more than 100 000 cells.
    """
    axes: dict[str, list[str]] = {}
    for text in sets:
        key, sign, listed = text.partition("=")
        axes[key + sign] = values(listed) if sign else [listed]
    if prod(len(axis) for axis in axes.values()) > MOST:
        raise ConfigError(f"--set: expected a grid of at most {MOST} cells, got more; shorten an axis")
    several = [key for key, axis in axes.items() if len(axis) > 1]
    combinations = []
    for chosen in product(*axes.values()):
        value_of = dict(zip(axes, chosen, strict=True))
        pipeline = config.load(path, [key + value for key, value in value_of.items()])
        combinations.append(Cell({key.removesuffix("="): value_of[key] for key in several}, pipeline))
    return combinations


def values(text: str) -> list[str]:
    """The values meant by a text: `32,64,128` is three, `0:10` the numbers 0 to 9, `0:10:5` 0 and 5.

    What TOML reads as one value, as the list `[0.01,0.005]` or the text `"a,b"`, is one value. Raises ConfigError for
    a range without numbers and for an empty item in a list.
    """
    pieces = [text] if _toml(text) else list(_pieces(text))
    expanded = [value for piece in pieces for value in _expanded(piece.strip() if len(pieces) > 1 else piece)]
    if len(pieces) > 1 and "" in expanded:
        raise ConfigError(f"--set: expected values between the commas, got {text!r}; drop the empty one")
    return list(dict.fromkeys(expanded))


def _pieces(text: str) -> Iterator[str]:
    depth, start = 0, 0
    for match in re.finditer(rf"{_QUOTED}|[\[\]{{}},]", text):
        token = match.group()
        depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(token, 0)
        if token == "," and depth == 0:
            yield text[start : match.start()]
            start = match.end()
    yield text[start:]


def _expanded(piece: str) -> list[str]:
    match = _RANGE.fullmatch(piece)
    if match is None:
        return [piece]
    numbers = range(int(match[1]), int(match[2]), int(match[3] or 1))
    if not 0 < len(numbers) <= MOST:
        raise ConfigError(f"--set: expected a range as 0:10, its end not in it, got {piece!r}; write 0:10 or 0:10:5")
    return [str(number) for number in numbers]


def _toml(text: str) -> bool:
    try:
        tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError):
        return False
    return True
