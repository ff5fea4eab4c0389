"""Files of messages by topic. A name is a topic and a field: /joint_states.position[0].

The time of a message is the stamp of its header, else the time at which it was logged.
"""

import re
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from npred.base.errors import ConfigError
from npred.identification.recordings import Contents, TimeSeries, TimeSource, decoding, unknown

LOG = "log"  # as `time`: the times of the log, also for messages with a stamp
STEP = re.compile(r"\.?([^.\[\]]+)|\[(\d+)\]")
STAMPS = (("header", "stamp"), ("timestamp",))
PARTS = (("sec", "secs"), ("nanosec", "nsec", "nsecs"))
ONE_CLOCK = 60 * 10**9  # ns; stamps that are further from the log are of another clock, as that of a simulation
ELEMENTS = 32  # elements of an array that are listed
Steps = tuple[str | int, ...]
Columns = Sequence[Sequence[Any]]  # one topic: times of the log in ns, moments, then its fields


class Bag(NamedTuple):
    """Topics, the first time in ns, and messages of topics: (topic, time of the log in ns, what was decoded)."""

    topics: Collection[str]
    start: int
    messages: Callable[[Collection[str]], Iterable[tuple[str, int, Any]]]


class Topics(ABC):
    """A file of messages; `what` is its format for people."""

    what: str

    def __init__(self, path: Path) -> None:
        self.path = path

    @abstractmethod
    def bag(self) -> AbstractContextManager[Bag]:
        """The opened file."""

    def columns(self) -> list[str]:
        """Topic and field of every number in the first message of each topic."""
        with self._opened() as bag:
            return list(self._names(bag))

    def contents(self, names: Sequence[str], source: TimeSource) -> Contents:
        """The fields as they are; NaN where a message lacks one. Times are from the first message of the file on.

        With a field of each message as `source.time` they are what this has. The topic of a name is the longest that
        fits.
        """
        time, by_stamp = source.time, source.time in (None, LOG)
        scale, unit = source.scale(self.path, "s" if by_stamp else source.time_unit)
        moment = _stamp if by_stamp else partial(_field, steps=_steps(time or ""))
        series, fields = {}, defaultdict(dict)
        with self._opened() as bag:
            for name in names:
                topics = [each for each in bag.topics if name == each or name.startswith((f"{each}.", f"{each}["))]
                if not topics:
                    raise unknown(self.path, name, self._names(bag))
                topic = max(topics, key=len)
                fields[topic][name] = _steps(name[len(topic) :])
            rows: dict[str, list[list]] = {topic: [] for topic in fields}
            for topic, logged, message in bag.messages(fields.keys()):
                values = [_field(message, steps) for steps in fields[topic].values()]
                rows[topic].append([logged, moment(message), *values])
            table: dict[str, Columns] = {
                topic: list(zip(*rows[topic], strict=True)) or [()] * (2 + len(fields[topic])) for topic in rows
            }
            times = self._seconds(bag.start, table, time == LOG) if by_stamp else {}
            for topic, (_, moments, *columns) in table.items():
                if not by_stamp:  # NaN where none has the field
                    numbers = _numbers(moments)
                    lost = np.full(len(moments), np.nan)
                    times[topic] = lost if numbers is None else numbers
                for name, column in zip(fields[topic], columns, strict=True):
                    if (values := _numbers(column)) is None:
                        raise unknown(self.path, name, self._names(bag))
                    series[name] = TimeSeries(scale * times[topic], values, np.arange(1, len(values) + 1))
        stamps = "the log" if time == LOG else "the stamps of the messages, else of the log"
        how = stamps if by_stamp else f"the field {time}{unit}"
        count = sum(len(each) for each in rows.values())
        return Contents(series, [f"{self.path.name}: {count} messages; times from {how}, in {source.unit}."])

    @contextmanager
    def _opened(self) -> Iterator[Bag]:
        with decoding(self.path, self.what), self.bag() as bag:
            yield bag

    def _names(self, bag: Bag) -> Iterator[str]:
        for topic in sorted(bag.topics):
            with suppress(ConfigError):  # messages of an encoding that is not read
                for _, _, message in islice(bag.messages([topic]), 1):
                    yield from _named(message, topic)

    def _seconds(self, start: int, table: Mapping[str, Columns], logged: bool) -> dict[str, np.ndarray]:
        """The times of each topic by one clock, in seconds. Raises ConfigError where there are two."""
        ns = {topic: np.array(columns[:2], dtype=np.int64) for topic, columns in table.items()}
        stamped = [topic for topic, (_, stamps) in ns.items() if stamps.all() and stamps.size and not logged]
        away = {topic: abs(np.median(ns[topic][1] - ns[topic][0])) for topic in stamped}
        other = [topic for topic in stamped if away[topic] > ONE_CLOCK]
        if other and len(other) < len(ns):
            got = f"stamps of {other[0]} that are {away[other[0]] * 1e-9:.3g} s from the times of the log"
            raise ConfigError(f"{self.path}: expected times of one clock, got {got}; give --time {LOG}")
        times = {topic: pair[int(topic in stamped)] for topic, pair in ns.items()}
        begin = min(times[topic].min() for topic in other) if other else start
        return {topic: (t - begin) * 1e-9 for topic, t in times.items()}


def _steps(name: str) -> Steps:
    return tuple(key or int(index) for key, index in STEP.findall(name))


def _field(message: Any, steps: Steps) -> Any:
    """The value that a message has there, else None."""
    try:
        for step in steps:
            inside = isinstance(step, int) or isinstance(message, Mapping)
            message = message[step] if inside else getattr(message, str(step))
    except (KeyError, IndexError, TypeError, AttributeError):
        return None
    return message


def _numbers(values: Sequence[Any]) -> np.ndarray | None:
    """Numbers, NaN for None; None where they are no numbers, or none at all."""
    if values and all(value is None for value in values):
        return None
    try:
        column = np.array(values, dtype=float)
    except (TypeError, ValueError):
        return None
    return column if column.ndim == 1 else None


def _stamp(message: Any) -> int:
    """The stamp of a message in ns; 0 where it has none."""
    for steps in STAMPS:
        moment = _field(message, steps)
        s, ns = (next((p for key in keys if (p := _field(moment, (key,))) is not None), None) for keys in PARTS)
        if s is not None and ns is not None:
            return int(s) * 10**9 + int(ns)
    return 0


def _named(message: Any, name: str) -> Iterator[str]:
    """The names of the numbers in a message."""
    if isinstance(message, bool | int | float | np.number | np.bool_):
        yield name
    elif isinstance(message, Mapping):
        for key, value in message.items():
            yield from _named(value, f"{name}.{key}")
    elif hasattr(message, "__len__") and not isinstance(message, str | bytes):
        for k, value in enumerate(message[:ELEMENTS]):
            yield from _named(value, f"{name}[{k}]")
    else:
        for key in getattr(message, "__slots__", None) or getattr(message, "__dict__", ()):
            yield from _named(getattr(message, key), f"{name}.{key}")
