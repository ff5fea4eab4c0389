"""Tables of text: with any separator, lines before the header, a header or none, a row of units, comments by # or %,
and decimal commas. Columns without a name are called by their place: 1, 2, ...
"""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from npred.base.errors import ConfigError
from npred.identification import recordings
from npred.identification.recordings import UNITS, decoding, unstructured
from npred.identification.recordings.table import EMPTY, NamedColumns, kind_of, pd, time_name

BRACKETS = re.compile(r"[\[(](.*)[])]")
SEPARATORS = ("\t", ";", ",", "|", " ")
SAMPLE = 300  # lines by which a separator is found
LEAST = 0.2  # of their cells have to be numbers, stamps or empty
ABOVE = 20  # lines above the numbers in which names are sought


class Text(NamedColumns):
    """A table of text."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        lines = self.lines()
        with decoding(path, "a table of text"):
            if len(table := unstructured.columns(lines)):
                self.counted(dict(table.items()))
            else:
                self._read(lines)

    def lines(self) -> list[str]:
        """The lines of the file."""
        return re.split(r"\r\n?|\n", recordings.text_of(self.path, "a table of text"))

    def _read(self, lines: Sequence[str]) -> None:
        """Find the separator, then the first row, then the names above it."""
        full = {k: line for k, line in enumerate(lines, 1) if line.strip() and not re.match('"?sep=.', line)}
        data = {k: line for k, line in full.items() if line.lstrip()[0] not in "#%"}
        if not data:
            raise ConfigError(f"{self.path}: expected a table, got an empty file; check the path")
        sample = list(data.values())[len(data) // 2 :: 1 + len(data) // SAMPLE]
        separator = self.separator or max(SEPARATORS, key=lambda each: _layout(sample, each)[1])
        width, share, measured = _layout(sample, separator)
        rows = {k: _cells(line, separator) for k, line in data.items()}
        long = {k: [cells[j] for j in measured] for k, cells in rows.items() if len(cells) >= width}
        begin = next((k for k, cells in long.items() if not _words(cells[:1]) and 2 * _words(cells) < len(cells)), 0)
        if share < LEAST or not begin:
            got = next(iter(data.values())).strip()[:60]
            raise ConfigError(f"{self.path}: expected two columns of numbers or more, got {got!r}; check the file")
        above = [k for k in full if k < begin][-ABOVE:]
        heads = {k: names for k in above if (names := _names(full[k], separator, width))}
        head = max((k for k, names in heads.items() if not _is_units(names)), default=min(heads, default=0))
        units = next((heads[k] for k in heads if k > head), [])
        if skipped := sum(k < begin for k in rows.keys() - heads.keys()):
            self.notes.append(f"above the numbers, lines that are no header are skipped: {skipped}.")
        header, below = heads.get(head, [""] * width), {k: cells for k, cells in rows.items() if k >= begin}
        fits = {k: cells[:width] for k, cells in below.items() if len(cells) >= width and not any(cells[width:])}
        if lost := [k for k in below if k not in fits]:
            more = f", and {len(lost) - 1} more" if len(lost) > 1 else ""
            self.notes.append(f"lines without {width} cells are left out: line {lost[0]}{more}.")
        self.separator, self.place = separator, np.searchsorted(list(below), list(fits))  # a lost row took its time
        columns = [pd.Series(column, index=list(fits)) for column in zip(*fits.values(), strict=True)]
        used = [k for k, name in enumerate(header) if name or columns[k].any()]
        self.named([header[k] or str(k + 1) for k in used], [columns[k] for k in used])
        units = {name: (BRACKETS.fullmatch(unit) or ["", unit])[1] for name, unit in zip(header, units, strict=False)}
        self.units |= {name: unit for name, unit in units.items() if name in self.names and unit}


def _layout(lines: Sequence[str], separator: str) -> tuple[int, float, list[int]]:
    """The most frequent number of cells by a separator, how many of these are no words, and the columns of numbers."""
    rows = [_cells(line, separator) for line in lines]
    counts = Counter(map(len, rows))
    width = max(counts, key=lambda n: n * counts[n])
    fits = [row for row in rows if len(row) == width]
    measured = [k for k, column in enumerate(zip(*fits, strict=True)) if _measured(column) > _words(column)]
    good = sum(len(row) - _words(row) for row in fits)
    return width, good / sum(map(len, rows)) if width > 1 and measured else 0.0, measured


def _cells(line: str, separator: str) -> list[str]:
    """The cells of a line."""
    line = " ".join(line.split()) if separator == " " else line
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]


def _names(line: str, separator: str, width: int) -> list[str]:
    """The names in a line, none where it is no header. The column of row names, as R writes it, may lack one."""
    bare = line.lstrip("#% ") if line.lstrip()[0] in "#%" else line
    cells = _cells(bare, separator)
    if len(cells) not in (width, width - 1) and separator == " ":
        cells = re.split(r"\s{2,}", bare.strip())
    cells = cells[:width]
    if len(cells) == width - 1 > 1 and not _measured(cells):
        cells = ["", *cells]
    wrong = any(re.search(r"=|^[^\w%°]+$", cell) for cell in cells)
    return cells if len(cells) == width and _words(cells) >= max(1, _measured(cells)) and not wrong else []


def _measured(cells: Sequence[str]) -> int:
    return sum(kind_of(cell) != "words" for cell in cells)


def _words(cells: Sequence[str]) -> int:
    return sum(kind_of(cell) == "words" and cell.strip("-").lower() not in EMPTY for cell in cells)


def _is_units(names: Sequence[str]) -> bool:
    """Whether a row above the numbers holds units instead of names: some are alike, in brackets, or of time."""
    if any(time_name(name)[0] is not None and name.casefold() not in UNITS for name in names):
        return False
    alike = len(set(names)) < len(names)
    return alike or any(BRACKETS.fullmatch(name) or name.casefold() in UNITS for name in names)
