"""Tables: columns by name, one of which may hold the times, as numbers or as stamps that pandas reads."""

import re
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from npred.base.errors import ConfigError
from npred.identification.recordings import LISTED, UNITS, USUAL, Contents, TimeSeries, TimeSource, unknown

pd: Any = pandas  # a checker cannot tell which of its many types comes
UNIT = re.compile(r"(.*\S)\s*(?:\[(?!\d+])([^][]*)]|\((?!\d+\))([^()]*)\))")  # q[0] is a name
TIMES = (  # names of times, without case, blanks and unit, the likeliest first; T alone is a temperature
    *("time", "times", "timestamp", "stamp", "datetime", "dateandtime", "timeutc", "utctime", "utc", "localtime"),
    *("elapsed", "elapsedtime", "timeelapsed", "seconds", "secs", "sec", "milliseconds", "millis", "microseconds"),
    *("micros", "minutes", "hours", "xvalue", "xaxis", "timestring", "date", "zeit", "zeitstempel", "datum", "uhrzeit"),
)
KINDS = {  # the first that a cell matches
    "number": re.compile(r"[-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?"),
    "clock": re.compile(r"(?:\d+ days? )?\d{1,4}:\d\d(?::\d\d)?(?:[.,]\d+)?(?: ?[AaPp][Mm])?"),
    "date": re.compile(r"\d{1,4}[-/. ](?:\d{1,2}|[A-Za-z]{3,9})[-/. ]\d{1,4}"),
    "stamp": re.compile(r"[^,;|\t]*\d:\d\d(?::\d\d)?(?:[.,]\d+)?[^,;|\t]*|\d{8}T\d{4}[^,;|\t]*"),
}
ANGLE = re.compile(r"[\W_](deg|degrees?|rad|radians?)$", re.IGNORECASE)
COMMA = r"[-+]?(?:\d{1,3}(?:\.\d{3})+|\d*),\d+(?:[eE][-+]?\d+)?"
EMPTY = ("", "nan", "na", "n/a", "null", "none", "nat", "inf", "-inf")
SWITCHES = {"true": 1.0, "false": 0.0, "on": 1.0, "off": 0.0}
UNIX = {"s": 1e9, "ms": 1e12, "us": 1e15, "ns": 1e18}  # since 1970, from the year 2001 on


NAMES = {  # of columns of a long table, which has a row for each value: what a value is of, and the value
    "name": (
        "topic",
        "varname",
        "_field",
        "field",
        "entity_id",
        "tag",
        "tagname",
        "variable",
        "signal",
        "channel",
        "name",
    ),
    "value": ("value", "_value", "varvalue", "state", "val", "tagvalue"),
}
SHARE = 0.3  # topics of a long table are fewer than this share of its rows
WINCC = 86.4e-3  # s: there Time_ms is the time since 1899 in millionths of a day


class NamedColumns:
    """Columns `data` by `names`, which are the texts `cells` without their `units`.

    The index of a column counts its rows or lines, and `place`, where not None, is that of each row in its run, from 0.
    """

    separator: str | None = None  # of text; a comma there may be no decimal one
    place: np.ndarray | None = None

    def __init__(self, path: Path) -> None:
        self.path, self.notes = path, list[str]()

    def named(self, cells: Sequence[str], data: list[Any]) -> None:
        """Take columns with these names; a unit stays in a name that would not be unique without it."""
        units = [UNIT.fullmatch(cell) for cell in cells]
        short = [unit[1] if unit else cell for unit, cell in zip(units, cells, strict=True)]
        often, self.cells, self.data = Counter(short), list(cells), data
        self.names = [name if often[name] == 1 else cell for name, cell in zip(short, cells, strict=True)]
        self.units = {unit[1]: unit[2] or unit[3] or "" for unit in units if unit and often[unit[1]] == 1}
        lower = {name.casefold(): k for k, name in enumerate(self.names)}
        places = [next((lower[name] for name in words if name in lower), None) for words in NAMES.values()]
        name, value = places
        self.long = (name, value) if name is not None and value is not None and len({*map(len, data)}) == 1 else None
        if self.long and {"varname", "time_ms"} <= lower.keys():
            k = lower["time_ms"]
            numbers = self.data[k].astype(str).str.replace(",", ".")
            self.data[k], self.units[self.names[k]] = pd.to_numeric(numbers, errors="coerce") * WINCC, "s"

    def counted(self, columns: Mapping[str, Any]) -> None:
        """Take columns by name; their rows are counted from 1."""
        self.named(list(columns), [column.set_axis(range(1, len(column) + 1)) for column in columns.values()])

    def columns(self) -> list[str]:
        """The names of the columns, without their units; of a long table its topics, too."""
        return [*self._topics(), *self.names]

    def contents(self, names: Sequence[str], source: TimeSource) -> Contents:
        """The columns as they are; NaN where a cell holds no number. Of a topic of a long table its rows."""
        topics = {} if set(names) <= {*self.names, *self.cells} else self._topics()
        if topics and self.long:
            value, wide = self.names[self.long[1]], [name for name in names if name not in topics]
            every = self.contents([value, *wide], source)
            series = {name: TimeSeries(*(each[topics[name]] for each in every.series[value])) if name in topics
                      else every.series[name] for name in names}  # fmt: skip
            return every._replace(series=series)
        series, times, units = {}, {}, {}
        for name in names:
            k = self._find(name)
            group = len(self.data[k]), self.names[k].rpartition(".")[0]
            if group not in times:
                times[group] = self._times(k, source)
            series[name] = TimeSeries(times[group][0], self._numbers(k), self.data[k].index.to_numpy())
            if unit := self.units.get(self.names[k]) or next(iter(ANGLE.findall(name)), ""):
                units[name] = unit
        sources = ", and ".join(dict.fromkeys(f"{len(t)} rows; {how}" for t, how in times.values()))
        return Contents(series, [f"{self.path.name}: {sources}.", *dict.fromkeys(self.notes)], units)

    def _topics(self) -> dict[str, np.ndarray]:
        """The rows (N,) of each topic of a long table, as True; none of another one."""
        if not self.long:
            return {}
        codes, topics = pd.factorize(_texts(self.data[self.long[0]]))
        return {topic: codes == k for k, topic in enumerate(topics)} if len(topics) < SHARE * len(codes) else {}

    def _find(self, name: str) -> int:
        """The column of a name, with or without its unit."""
        places = [k for k, names in enumerate(zip(self.names, self.cells, strict=True)) if name in names]
        if not places:
            raise unknown(self.path, name, self.names)
        if len(places) > 1:
            raise ConfigError(f"{self.path}: expected one column {name}, got {len(places)}; rename them in the header")
        return places[0]

    def _numbers(self, k: int) -> np.ndarray:
        """The numbers of column k, NaN for other cells, which a note names."""
        if pd.api.types.is_numeric_dtype(self.data[k]):
            return self.data[k].to_numpy(float, na_value=np.nan)
        text, name = _texts(self.data[k]), self.names[k]
        values = pd.to_numeric(text, errors="coerce").astype(float)
        rest = text[values.isna()].dropna()
        commas = rest[rest.str.fullmatch(COMMA)]
        values[commas.index] = pd.to_numeric(commas.str.replace(".", "").str.replace(",", "."))
        if len(commas) and self.separator == ",":
            self.notes.append(f"column {name}: the comma in {commas.iloc[0]!r} is taken for a decimal comma.")
        values = values.fillna(text.str.lower().map(SWITCHES))
        words = rest[values[rest.index].isna()]
        if len(words) and values.isna().all():
            got = f"{name!r} with words as {words.iloc[0][:40]!r}"
            raise ConfigError(f"{self.path}: expected the name of a column with numbers, got {got}; name another")
        self._left_out(name, words, "number", "left out")
        return values.to_numpy()

    def _left_out(self, name: str, bad: Any, what: str, end: str) -> None:
        """A note on cells of a column, if there are any."""
        if len(bad):
            as_in = f"{len(bad)}, as {bad.iloc[0][:40]!r} in line {bad.index[0]}"
            self.notes.append(f"column {name}: cells that hold no {what} are {end}: {as_in}.")

    def _times(self, like: int, source: TimeSource) -> tuple[np.ndarray, str]:
        """Times of the rows of the column `like` in the plant's unit, and where they come from, in words."""
        size = len(self.data[like])
        if source.period is not None:
            place = np.arange(size) if self.place is None else self.place
            row = "row k of each run" if (np.diff(place) < 0).any() else "row k"
            return source.period * place, f"{row} is at k times {source.period:g} {source.unit} (period)"
        k = self._find(source.time) if source.time else self._clock(like)
        name, kind = self.names[k], _kind(self.data[k])
        if len(self.data[k]) != size:
            got = f"{self.names[like]} with {size}, {name} with {len(self.data[k])}"
            raise ConfigError(f"{self.path}: expected columns with as many rows as their times, got {got}; name others")
        if kind != "number":
            return self._stamps(k, kind, source)
        t, unit = self._numbers(k), source.time_unit or self.units.get(name) or time_name(name)[1]
        if unit is None:
            for since, low in UNIX.items():
                if since != source.unit and len(t) and (t >= low).all() and (t < 2.5 * low).all():
                    self.notes.append(f"column {name} may be {since} since 1970: if so, add --time-unit {since}.")
            return t, f"times from column {name}, in {source.unit}, the plant's unit: the file names none"
        if unit.casefold() not in UNITS and unit != source.unit:
            expected = f"a unit of time in the header, one of {', '.join(USUAL)}"
            raise ConfigError(f"{self.path}: expected {expected}, got {unit!r}; name it by --time-unit")
        how = f"times from column {name} in {unit} ({'time_unit' if source.time_unit else 'its header'})"
        if source.unit not in UNITS:
            return t, f"{how}, taken as {source.unit}, the plant's unit"
        return t * source.per(self.path, unit.casefold()), f"{how}, in {source.unit}"

    def _clock(self, like: int) -> int:
        """The column of the times: one with such a name, nearest to the column `like`, else the only one of stamps."""
        same = [k for k, column in enumerate(self.data) if len(column) == len(self.data[like])]
        group = [name.rpartition(".")[0] for name in self.names]
        ranks = {k: rank for k in same if (rank := time_name(self.names[k])[0]) is not None}
        if ranks:
            return min(ranks, key=lambda k: (group[k] != group[like], ranks[k], k))
        stamps = {k: kind for k in same if (kind := _kind(self.data[k])) in ("stamp", "date", "clock")}
        if len(stamps) == 1 or sorted(stamps.values()) == ["clock", "date"]:
            return next(iter(stamps))
        got = ", ".join(self.names[:LISTED]) + (", ..." if len(self.names) > LISTED else "")
        cure = "name it by --time, or give the time between two rows by --period"
        raise ConfigError(f"{self.path}: expected a column of times (t, time, date, ...), got {got}; {cure}")

    def _stamps(self, k: int, kind: str, source: TimeSource) -> tuple[np.ndarray, str]:
        """Times since the first row, of dates, of times of the day, or of both from two columns."""
        text, name = _texts(self.data[k]), f"column {self.names[k]}"
        pairs = [j for j, column in enumerate(self.data) if {kind, _kind(column)} == {"clock", "date"}]
        if pairs and len(self.data[pairs[0]]) == len(text):
            other = _texts(self.data[pairs[0]])
            text = text + " " + other if kind == "date" else other + " " + text
            name, kind = f"columns {self.names[k]} and {self.names[pairs[0]]}", "stamp"
        seconds = _seconds(text.str.replace(",", "."), kind)
        bad = text[seconds.isna()].dropna()
        if seconds.isna().all():
            expected, got = f"numbers, or stamps as 2024-05-01T12:00:00.5, in {name}", repr(bad.iloc[0][:40])
            raise ConfigError(f"{self.path}: expected {expected}, got {got}; name another by --time, or write them so")
        self._left_out(self.names[k], bad, "stamp", "left out with the row")
        seconds = (seconds - seconds[seconds.first_valid_index()]).to_numpy(float)
        return seconds * source.per(self.path, "s"), f"times from the stamps in {name}, in {source.unit}"


def expanded(frame: Any) -> dict[str, Any]:
    """The columns of a frame by name; one whose cells hold vectors of one length as name[0], name[1], ..."""
    columns: dict[str, Any] = {}
    for name, column in frame.items():
        cells = column.dropna() if column.dtype == object else column[:0]
        lengths = {len(cell) if isinstance(cell, list | np.ndarray) else 0 for cell in cells}
        if len(lengths) == 1 and lengths != {0}:
            values = pd.DataFrame(np.stack(cells).reshape(len(cells), -1), cells.index).reindex(column.index)
            columns |= {f"{name}[{k}]": values[k] for k in values}
        else:
            columns[str(name)] = column
    return columns


def _texts(column: Any) -> Any:
    """The cells as texts, missing where they are empty or a word for that."""
    text = column.astype(str).str.strip()
    return text.mask(text.str.lower().isin(EMPTY))


def kind_of(cell: str) -> str:
    """The one of KINDS that a cell is, else words."""
    return next((kind for kind, pattern in KINDS.items() if pattern.fullmatch(cell)), "words")


def _kind(column: Any) -> str:
    """The kind of most of the first cells."""
    kinds = Counter(map(kind_of, _texts(column.head(50)).dropna()))
    return kinds.most_common(1)[0][0] if kinds else "number"


def time_name(name: str) -> tuple[int | None, str | None]:
    """The rank of a name among those of times, None for other names, and the unit that it ends in."""
    words = [word for word in re.split(r"[\W_]+", name.rpartition(".")[2]) if word not in ("", "in")]
    unit = words.pop().casefold() if len(words) > 1 and words[-1].casefold() in UNITS else None
    if words == ["t"]:
        return -1, unit
    key = "".join(words).casefold()
    if glued := re.fullmatch(r"(time|timestamp)(us|ms|ns|sec)", key):
        key, unit = glued.groups()
    return (TIMES.index(key), unit or (key if key in UNITS else None)) if key in TIMES else (None, None)


def _seconds(text: Any, kind: str) -> Any:
    """Seconds of times of the day and durations (h:mm or h:mm:ss), or of dates in UTC, missing where it is neither.

    Where day and month may be exchanged it is the reading with the fewest gaps, then the shortest span.
    """
    if kind == "clock" and not text.str.contains("m$", case=False).any():
        full = text.where(text.str.count(":") > 1, text + ":00")
        return pd.to_timedelta(full, errors="coerce").dt.total_seconds()
    readings = [pd.to_datetime(text, format="ISO8601", errors="coerce", utc=True)]
    if readings[0].isna().sum() > text.isna().sum():
        for day_first in (True, False):
            options = {"dayfirst": day_first, "errors": "coerce", "utc": True}
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # stamps that are guessed to be of another order
                passed = pd.to_datetime(text, **options)  # by the form of the first one
                rest = passed.isna() & text.notna()
                readings.append(passed.fillna(pd.to_datetime(text[rest], format="mixed", **options)))
    best = min(readings, key=lambda passed: (passed.isna().sum(), passed.max() - passed.min()))
    return (best - best.min()).dt.total_seconds()
