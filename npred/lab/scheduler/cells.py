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
    try:
        tomllib.loads(f"value = {text}")
        pieces = [text]
    except (tomllib.TOMLDecodeError, RecursionError):
        pieces = list(_pieces(text))
    expanded = []
    for piece in pieces:
        match = _RANGE.fullmatch(piece := piece.strip() if len(pieces) > 1 else piece)
        numbers = range(int(match[1]), int(match[2]), int(match[3] or 1)) if match else ()
        if match and not 0 < len(numbers) <= MOST:
            cure = "write 0:10 or 0:10:5"
            raise ConfigError(f"--set: expected a range as 0:10, its end not in it, got {piece!r}; {cure}")
        expanded += map(str, numbers) if match else [piece]
    if len(pieces) > 1 and "" in expanded:
        raise ConfigError(f"--set: expected values between the commas, got {text!r}; drop the empty one")
    return list(dict.fromkeys(expanded))


def _pieces(text: str) -> Iterator[str]:
    """The text between the commas that are outside of quotes and brackets."""
    depth, start = 0, 0
    for match in re.finditer(r"""\"(?:[^"\\]|\\.)*\"|'[^']*'|[\[\]{},]""", text):
        token = match.group()
        depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(token, 0)
        if token == "," and depth == 0:
            yield text[start : match.start()]
            start = match.end()
    yield text[start:]
