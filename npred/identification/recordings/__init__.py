"""Recordings of a plant: the columns of a table, or the fields of messages, each as a series with its times.

A format is a class in a file of this folder, with a line in npred.base.registry.RECORDINGS, where its suffix finds it.
A file of another suffix is read as a table of text.
"""

import bz2
import codecs
import gzip
import lzma
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from npred.base import json_files
from npred.base.errors import ConfigError, NpredError, bytes_text, first_line, similar, unlisted
from npred.base.registry import RECORDINGS
from npred.plants.notation import UNITS

USUAL = ("s", "ms", "us", "µs", "ns", "min", "h", "d")  # those that a message lists
LISTED = 12  # names in a message
UNPACKERS = {"gz": gzip.open, "bz2": bz2.open, "xz": lzma.open}  # of text, by the last suffix
BINARY = b"PK\x03\x04", b"\x1f\x8b", b"SQLite", b"PAR1"  # how files begin that need not have a 0
LARGEST = 2**32  # bytes of text
FOLDERS = {"metadata.yaml": "db3", "**/*.parquet": "parquet"}  # formats of folders by what these hold
NEXT = {  # formats that are not read, and what to do
    **dict.fromkeys(("zip", "7z", "rar", "tar", "tgz", "zst"), "unpack it, and name the file in it"),
    **dict.fromkeys(("pkl", "pickle", "joblib"), "it may run code when it is read; save it as Parquet or CSV"),
    **dict.fromkeys(("mf4", "mdf", "blf", "dbc"), "export its signals as .mat or CSV, by asammdf for example"),
    **dict.fromkeys(("tdms",), "export its channels as CSV, by nptdms for example"),
    **dict.fromkeys(("feather", "arrow", "orc"), "save it as Parquet"),
    **dict.fromkeys(("sqlite", "db"), "export the table as CSV"),
    **dict.fromkeys(("mp4", "avi", "mkv", "mov"), "name the file with the numbers"),
}


class TimeSeries(NamedTuple):
    """Values (N,) at times t (N,), each from the line, row or message `rows` (N,), which are counted from 1."""

    t: np.ndarray
    values: np.ndarray
    rows: np.ndarray


class Contents(NamedTuple):
    """Series by name; sentences for people, the first of which says where the times come from; units, where known."""

    series: dict[str, TimeSeries]
    notes: list[str]
    units: dict[str, str] = {}


class TimeSource(NamedTuple):
    """The times of a recording: the name of their column and their unit, or the time between two rows of a table.

    All times come out in `unit`, that of the plant, which need not be one of UNITS.
    """

    time: str | None = None
    time_unit: str | None = None
    period: float | None = None
    unit: str = "s"

    def scale(self, path: Path, unit: str | None) -> tuple[float, str]:
        """How much of the plant's unit one of a file's unit is, which None leaves open, and the latter in words.

        Raises ConfigError as `per` does, and for a period: this is of messages, which have their times.
        """
        if self.period is not None:
            expected = f"period: expected none for {path}, whose messages have times"
            raise ConfigError(f"{expected}, got {self.period:g}; drop it")
        return (1.0, " (without a unit, so in the plant's)") if unit is None else (self.per(path, unit), f" in {unit}")

    def per(self, path: Path, unit: str) -> float:
        """How much of the plant's unit one of UNITS is. Raises ConfigError where the plant's is none of them."""
        if unit == self.unit:
            return 1.0
        if self.unit not in UNITS:
            expected = f"a plant with a time_unit that times in {unit} can be brought to, one of {', '.join(USUAL)}"
            raise ConfigError(f"{path}: expected {expected}, got {self.unit!r}; change it in the plant")
        return UNITS[unit] / UNITS[self.unit]


class Recording(Protocol):
    """A file that is read. A format is made from the path; it raises ConfigError for a file that it cannot read."""

    def columns(self) -> list[str]:
        """The names that the file has."""
        ...

    def contents(self, names: Sequence[str], source: TimeSource) -> Contents:
        """The series of these names as they are, also where not finite: see `read`."""
        ...


def read(
    path: Path, names: Sequence[str], time: str | None = None, time_unit: str | None = None,
    *, period: float | None = None, unit: str = "s", file: Recording | None = None,
) -> Contents:  # fmt: skip
    """The series of the columns or fields `names`, finite values only, with times in the plant's `unit`.

    Times are in the order of the file, also where its clock goes back. `time` names their column, or the field of each
    message that has them; by default it is found. `time_unit`, one of UNITS, is that of times which are numbers; by
    default the one that a table names, else `unit`. `period`, in `unit`, is the time between two rows of a table that
    has no times; `file` is what was opened already. Raises ConfigError for a file, a name, a time or a number that
    cannot be read, MissingError without the package of a format.
    """
    if time_unit is not None and time_unit not in (*UNITS, unit):
        raise ConfigError(unlisted("time_unit", time_unit, USUAL))
    if period is not None and not (math.isfinite(period) and period > 0):
        raise ConfigError(f"period: expected a time above 0 in {unit}, got {period!r}; give that between two rows")
    if period is not None and time is not None:
        raise ConfigError(f"period: expected either the times of {time!r} or a period, got both; drop one")
    every = (file or opened(path)).contents(list(dict.fromkeys(names)), TimeSource(time, time_unit, period, unit))
    kept = {}
    for name in names:
        t, values, rows = every.series[name]
        number = np.isfinite(values)
        timed = number & np.isfinite(t)
        if not timed.any():
            got = "numbers without a time" if number.any() else "empty cells or NaN alone" if len(t) else "no rows"
            raise ConfigError(f"{path}: expected numbers in {name}, got {got}; name another column or check the file")
        kept[name] = TimeSeries(t[timed], values[timed], rows[timed])
    return every._replace(series=kept)


def opened(path: Path) -> Recording:
    """The recording in a file, by its suffix, or in a folder, by what it holds. Raises ConfigError and MissingError."""
    if not path.exists():
        raise ConfigError(f"{path}: expected a recording, found no file; check the path")
    if path.is_dir():
        form = next((form for pattern, form in FOLDERS.items() if any(path.glob(pattern))), "")
        if not form:
            expected = "a folder with metadata.yaml, as a bag of ROS 2, or with .parquet files, as a data set"
            raise ConfigError(f"{path}: expected {expected}, got another; name a file in it")
    else:
        suffixes = [suffix[1:].lower() for suffix in path.suffixes]
        form = next((suffix for suffix in reversed(suffixes) if suffix not in UNPACKERS), "csv")
    return RECORDINGS.load("recording", form if form in RECORDINGS.names() else "csv")(path)


def text_of(path: Path, what: str) -> str:
    """The text of a file in UTF-8, UTF-16 with its mark, or Latin-1, without what fills a file that was cut.

    It is unpacked by its last suffix. Raises ConfigError for bytes that are no text.
    """
    form = path.suffix[1:].lower()
    with decoding(path, what), UNPACKERS.get(form, open)(json_files.regular(path), "rb") as file:
        content = file.read(LARGEST + 1)
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        read = content.decode("utf-16" if wide else "utf-8-sig").rstrip("\0")
    except UnicodeDecodeError:
        read = content.decode("latin-1").rstrip("\0")
    if len(content) > LARGEST:
        raise ConfigError(f"{path}: expected at most {bytes_text(LARGEST)} of text, got more; save a part of it")
    if "\0" in read or content.startswith(BINARY):
        got = "bytes of another kind"
        raise ConfigError(f"{path}: expected {what}, got {got}; {NEXT.get(form, 'save it as CSV')}")
    return read


def unknown(path: Path, name: str, names: Iterable[str]) -> ConfigError:
    """The failure of a name that a file does not have, with the names that come closest, or the first ones."""
    names = list(names)
    more = ", ..." if len(names) > LISTED else ""
    near = similar(name, names) or f"; choose one of {', '.join(names[:LISTED])}{more}"
    return ConfigError(f"{path}: expected the name of a column with numbers, got {name!r}{near}")


@contextmanager
def decoding(path: Path, what: str) -> Iterator[None]:
    """Every failure of a foreign decoder in one line: it is not known in which ways they fail."""
    try:
        yield
    except NpredError:
        raise
    except Exception as error:
        raise ConfigError(f"{path}: expected {what}, got: {first_line(error)}; check the file") from None
