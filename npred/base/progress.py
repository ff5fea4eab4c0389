"""Slow work prints one line, before it has lasted half a second.

The line says what is done, about how long it takes and how often it happens. In a script it goes to stderr; an
application takes the lines by `listener`. NPRED_QUIET=1 in the environment, or `quiet()` around a call, suppresses it;
NPRED_QUIET silences bars and the live view of the application, too.
"""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar

from npred.base.json_files import escaped

VARIABLE = "NPRED_QUIET"
PATIENCE = 0.4  # s without a line
SHORT = 1.0  # s: counted work that will end before this prints no line, unless it lasts longer
_listeners: list[Callable[[str], None]] = []
_announced: ContextVar[bool] = ContextVar("announced", default=False)  # nested work prints nothing


def counted(count: int, unit: str) -> str:
    """`8 rollouts`, `1 rollout`: units are named in the plural."""
    return f"{count} {unit.removesuffix('s') if count == 1 else unit}"


def duration(seconds: float) -> str:
    """`3 s`, `2 min`, `5 h`, rounded up."""
    for unit, size in (("h", 3600), ("min", 60)):
        if seconds > 1.5 * size:
            return f"{round(seconds / size)} {unit}"
    return f"{max(round(seconds), 1)} s"


class Pending:
    """Work under way: `done` of `total` units, where it can count them; the time that it takes follows from both.

    Work before the first units, such as a compilation, is not multiplied: `advance(0)` says that they begin.
    """

    def __init__(self, what: str, seconds: float | None, often: str, total: int) -> None:
        self.what, self.seconds, self.often, self.total, self.done = what, seconds, often, total, 0
        self.start = self.began = self.latest = time.perf_counter()

    def advance(self, n: int) -> None:
        self.latest = time.perf_counter()
        if not self.done and n == 0:
            self.began = self.latest
        self.done += n

    @property
    def expected(self) -> float | None:
        """The seconds that the whole work takes, as far as known."""
        if self.total and self.done:
            return self.began - self.start + (self.latest - self.began) * self.total / self.done
        return self.seconds

    @property
    def line(self) -> str:
        """The sentence: `compiling 5 kernels: about 3 s, once per plant`."""
        expected = self.expected
        ending = ", ".join(filter(None, [f"about {duration(expected)}" if expected else "", self.often]))
        return f"{self.what}: {ending}" if ending else self.what


@contextmanager
def announce(what: str, seconds: float | None = None, often: str = "", total: int = 0) -> Iterator[Pending]:
    """Print one line about the work in the block once it has lasted PATIENCE, or SHORT if it will end before that.

    `seconds` is a guess of how long it takes; it may be wrong on a slow machine, so it delays no line. `often` says how
    often the work happens. With a `total` of units the time follows from `advance`. Nested work prints nothing.
    """
    work = Pending(what, seconds, often, total)
    if _announced.get() or os.environ.get(VARIABLE):
        yield work
        return
    over, say = threading.Event(), _listeners[-1] if _listeners else _write

    def watch() -> None:
        if over.wait(PATIENCE):
            return
        if not (work.done and (work.expected or 0.0) < SHORT and over.wait(SHORT - PATIENCE)):
            say(work.line)

    watcher = threading.Thread(target=watch, daemon=True)
    token = _announced.set(True)
    watcher.start()
    try:
        yield work
    finally:
        over.set()
        _announced.reset(token)
        watcher.join()  # or its line could come after what follows


_said: set[str] = set()


def say(text: str) -> None:
    """Say a line once, where nothing has to be quiet: a doubt about what is asked for."""
    if text not in _said and not (_announced.get() or os.environ.get(VARIABLE)):
        _said.add(text)
        (_listeners[-1] if _listeners else _write)(text)


@contextmanager
def quiet() -> Iterator[None]:
    """In the block nothing is said."""
    token = _announced.set(True)
    try:
        yield
    finally:
        _announced.reset(token)


@contextmanager
def listener(listen: Callable[[str], None]) -> Iterator[None]:
    """In the block lines go to this function instead of to stderr."""
    _listeners.append(listen)
    try:
        yield
    finally:
        _listeners.remove(listen)


def _write(text: str) -> None:
    with suppress(OSError, ValueError, AttributeError):  # a stderr that is closed or full loses words, and no work
        sys.stderr.write(f"npred: {escaped(text)}\n")
        sys.stderr.flush()
