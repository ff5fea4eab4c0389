"""Recordings of a plant: the columns of a table, or the fields of messages, each as a series with its times.

A format is a class in a file of this folder, with a line in npred.base.registry.RECORDINGS, where its suffix finds it.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from npred.base.errors import ConfigError, NpredError, first_line, similar, unlisted
from npred.base.registry import RECORDINGS

UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
LISTED = 12  # names in a message


class TimeSeries(NamedTuple):
    """Values (N,) at their times t (N,) in seconds."""

    t: np.ndarray
    values: np.ndarray


class Recording(Protocol):
    """A file that is read. A format is made from the path; it raises ConfigError for a file that it cannot read."""

    def columns(self) -> list[str]:
        """The names that the file has."""
        ...

    def series(self, names: Sequence[str], time: str | None, unit: str | None) -> Mapping[str, TimeSeries]:
        """The series of these names as they are, also where not finite: see `read`."""
        ...


def read(
    path: Path, names: Sequence[str], time: str | None = None, time_unit: str | None = None
) -> dict[str, TimeSeries]:
    """The series of the columns or fields `names`, finite values only.

    Times are in the order of the file. `time` names their column, or the field of each message that has them; by
    default it is found. `time_unit` is one of UNITS; by default the one that the header of a table gives, else s.
    Raises ConfigError for a file, a name, a time or a number that cannot be read, MissingError without the package
    of a format.
    """
    if time_unit is not None and time_unit not in UNITS:
        raise ConfigError(unlisted("time_unit", time_unit, UNITS))
    kept, every = {}, opened(path).series(names, time, time_unit)
    for name in names:
        t, values = every[name]
        number = np.isfinite(values)
        rows = number & np.isfinite(t)
        if not rows.any():
            got = "numbers without a time" if number.any() else "empty cells or NaN alone" if len(t) else "no rows"
            raise ConfigError(f"{path}: expected numbers in {name}, got {got}; name another column or check the file")
        kept[name] = TimeSeries(t[rows], values[rows])
    return kept


def columns(path: Path) -> list[str]:
    """The names that a file has. Raises ConfigError and MissingError as `read` does."""
    return opened(path).columns()


def opened(path: Path) -> Recording:
    """The recording in a file, by its suffix; a folder is a ROS 2 bag. Raises ConfigError and MissingError."""
    if not path.exists():
        raise ConfigError(f"{path}: expected a recording, found no file; check the path")
    form, forms = "db3" if path.is_dir() else path.suffix[1:].lower(), RECORDINGS.names()
    if form not in forms:
        raise ConfigError(unlisted(str(path), form, forms, "a file that ends in", "convert it"))
    return RECORDINGS.load("recording", form)(path)


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
