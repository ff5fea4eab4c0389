"""Tables of text: a header line with names, then rows of numbers, separated by commas, semicolons or tabs.

Lines that begin with # are comments. A cell may be empty. With semicolons or tabs a number may have a decimal comma.
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from npred.base import json_files
from npred.base.errors import ConfigError
from npred.identification.recordings import UNITS, TimeSeries, unknown

TIMES = ("t", "time", "Time", "timestamp", "Timestamp", "stamp")
WORDS = dict.fromkeys(("", "na", "n/a", "null", "none"), np.nan) | {"true": 1.0, "false": 0.0}
QUOTED = re.compile(r'"[^"]*"')
UNIT = re.compile(r"(.*\S)\s*(?:\[(?!\d+])([^][]*)]|\((?!\d+\))([^()]*)\))")  # q[0] is a name


class Csv:
    """A table; `names` are those of its columns, `units` the texts in brackets behind some of them."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            content = json_files.regular(path).read_bytes()
        except OSError as error:
            raise ConfigError(f"{path}: expected a table of text, got: {error.strerror}; check the path") from None
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")
        lines = list(io.StringIO(text, newline=""))
        begin, separator, self.cells = self._header(lines)
        self.comma = separator != ","
        units = [UNIT.fullmatch(cell) for cell in self.cells]
        short = [unit[1] if unit else cell for unit, cell in zip(units, self.cells, strict=True)]
        often = Counter(short)  # a unit stays in a name that would not be unique without it
        self.names = [name if often[name] == 1 else cell for name, cell in zip(short, self.cells, strict=True)]
        self.units = {unit[1]: unit[2] or unit[3] or "" for unit in units if unit and often[unit[1]] == 1}
        body = ("" if line.lstrip().startswith("#") else line for line in lines[begin:])
        reader = csv.reader(body, delimiter=separator, skipinitialspace=True)
        self.numbers, rows, width = list[int](), list[list[str]](), len(self.cells)  # numbers of lines, and their cells
        try:
            for row in reader:
                if any(row):
                    self.numbers.append(begin + reader.line_num)
                    rows.append(row)
                    if len(row) < width or any(row[width:]):
                        raise self._fault(self.numbers[-1], f"{width} cells as in the header", len(row))
        except csv.Error as error:
            raise self._fault(begin + reader.line_num, "a row of a table", error) from None
        self.table = list(zip(*rows, strict=False)) or [()] * len(self.names)

    def columns(self) -> list[str]:
        """The names of the columns, without their units."""
        return [name for name in self.names if name]

    def series(self, names: Sequence[str], time: str | None, unit: str | None) -> dict[str, TimeSeries]:
        """The columns as they are; an empty cell is NaN."""
        t = self._times(time, unit)
        return {name: TimeSeries(t, self._numbers(self._place(name))) for name in names}

    def _header(self, lines: Sequence[str]) -> tuple[int, str, list[str]]:
        """The place of the first row, the separator and the names: the first line that is no comment.

        Where that has only numbers, it is the comment above, as np.savetxt writes it.
        """
        comment = ""
        for k, line in enumerate(lines):
            if line.lstrip().startswith("#"):
                comment = line.lstrip("# \t")
            elif line.strip():
                separator = next((s for s in "\t;" if s in QUOTED.sub("", line.strip())), ",")
                cells, above = _cells(line, separator), _cells(comment, separator)
                if len(cells) == 1:
                    raise self._fault(k + 1, "names between commas, semicolons or tabs", cells[0])
                if not all(map(_is_number, cells)):
                    return k + 1, separator, cells
                if len(above) == len(cells) and not all(map(_is_number, above)):
                    return k, separator, above
                raise self._fault(k + 1, "a header line with the names of the columns", line.strip())
        raise ConfigError(f"{self.path}: expected a header line and rows, got an empty file; check the path")

    def _place(self, name: str) -> int:
        """The column of a name, with or without its unit."""
        places = [k for k, names in enumerate(zip(self.names, self.cells, strict=True)) if name in names and name]
        if not places:
            raise unknown(self.path, name, self.columns())
        if len(places) > 1:
            raise ConfigError(f"{self.path}: expected one column {name}, got {len(places)}; rename them in the header")
        return places[0]

    def _times(self, time: str | None, unit: str | None) -> np.ndarray:
        """Times in seconds; stamps from the first row on."""
        name = time or next((name for name in TIMES if name in self.names), None)
        if name is None:
            usual, got = ", ".join(TIMES), ", ".join(self.columns())
            raise ConfigError(f"{self.path}: expected a column of times ({usual}), got {got}; name it by --time")
        place = self._place(name)
        first = next((cell.strip() for cell in self.table[place] if cell.strip()), "")
        try:
            start = None if _is_number(first) else datetime.fromisoformat(first)
        except ValueError:
            start = None
        if start is not None:

            def since(cell: str) -> float:  # TypeError where one of both has a zone
                return (datetime.fromisoformat(cell.strip()) - start).total_seconds() if cell.strip() else np.nan

            return self._parsed(place, since, "a stamp as 2024-05-01T12:00:00.5, all alike,")
        unit = unit or self.units.get(self.names[place], "s")
        if unit not in UNITS:
            expected = f"a unit of time in the header, one of {', '.join(UNITS)}"
            raise ConfigError(f"{self.path}: expected {expected}, got {unit!r}; name it by --time-unit")
        return self._numbers(place, "a number or an ISO 8601 stamp") * UNITS[unit]

    def _numbers(self, place: int, expected: str = "a number") -> np.ndarray:
        try:
            return np.array(list(map(float, self.table[place])))
        except ValueError:  # slower: an empty cell, a decimal comma, a word
            return self._parsed(place, lambda cell: _number(cell, self.comma), expected)

    def _parsed(self, place: int, parse: Callable[[str], float], expected: str) -> np.ndarray:
        values = np.empty(len(self.table[place]))
        for k, cell in enumerate(self.table[place]):
            try:
                values[k] = parse(cell)
            except (ValueError, TypeError):
                raise self._fault(self.numbers[k], f"{expected} in column {self.names[place]}", cell) from None
        return values

    def _fault(self, line: int, expected: str, got: object) -> ConfigError:
        return ConfigError(f"{self.path}:{line}: expected {expected}, got {str(got)[:60]!r}; edit that line")


def _cells(line: str, separator: str) -> list[str]:
    """The cells of a header, without empty ones at its end."""
    cells = [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]
    while len(cells) > 1 and not cells[-1]:
        cells.pop()
    return cells


def _is_number(cell: str) -> bool:
    try:
        _number(cell, True)
    except ValueError:
        return False
    return True


def _number(cell: str, comma: bool) -> float:
    word = cell.strip().casefold()
    return WORDS[word] if word in WORDS else float(cell.replace(",", ".") if comma else cell)
