"""What is said of work that keeps a user waiting: how far it is, or one line before it has lasted half a second.

Of work without a bar, only such as takes longer says anything. A line says what is done, about how long it takes and
how often it is to be expected. A command line shows it as it shows its other messages (`heard`), a notebook below
its cell, once.
NPRED_QUIET=1 in the environment, or `quiet()` around a call, keeps it silent.
"""

import os
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from npred.terminal.streams import MESSAGES, printable

VARIABLE = "NPRED_QUIET"
EVERY = 10.0  # seconds between two lines of a bar
MEMORY = 0.25  # of the time of a bar, after which what was measured counts half
PATIENCE = 0.4  # s without a word
SHORT = 1.0  # s: work that is counted to end before needs no word, unless it lasts longer
_listeners: list[Callable[[str], None]] = []
_said: ContextVar[bool] = ContextVar("said", default=False)  # what runs within work that was announced adds no line


class Pace:
    """The time that a unit of one kind takes: what was done lately counts more, for work side by side ends."""

    def __init__(self, left: int) -> None:
        self.left, self.units, self.seconds, self.since = left, 0.0, 0.0, 0.0

    def add(self, n: int, seconds: float, memory: float) -> None:
        """n units more, after so many seconds of a thread; what is `memory` seconds older counts half."""
        self.left -= n
        self.since += seconds
        if n:
            fade = 0.5 ** (self.since / memory) if memory else 1.0
            self.units, self.seconds, self.since = fade * self.units + n, fade * self.seconds + self.since, 0.0


class Bar:
    """`total` units of work, named in the plural; `done` of them were there before, and took no time of this run.

    Units of several kinds, of which one may take a hundred times longer than another, are a `total` by kind.
    An advance calls `moved` with its units and the seconds that are left, None before they can be known; `line` gets a
    text every EVERY seconds and one at the end.
    """

    def __init__(
        self, title: str, total: int | Mapping[Any, int], unit: str, done: int, clock: Callable[[], float],
        moved: Callable[[int, float | None], None], line: Callable[[str], None],
    ) -> None:  # fmt: skip
        totals = {"": total} if isinstance(total, int) else total
        self.title, self.total, self.unit, self.before, self.done = title, sum(totals.values()), unit, done, done
        self.paces = {kind: Pace(total - done) for kind, total in totals.items()}
        self.clock, self.moved, self.line, self.lock = clock, moved, line, threading.Lock()
        self.note, self.start = "", clock()
        self.last, self.heard = self.start, dict[int, float]()  # the last advance of each thread

    def expect(self, kind: Hashable, seconds: float) -> None:
        """What a unit of a kind takes, as far as one knows before it has begun."""
        self.paces[kind].units, self.paces[kind].seconds = 1.0, seconds

    def advance(self, n: int = 1, note: str = "", kind: Hashable = "") -> None:
        """n units more are done; the note (a loss, say) replaces the last one. Raises what `moved` raises."""
        with self.lock:
            now, thread = self.clock(), threading.get_ident()
            self.paces[kind].add(n, now - self.heard.get(thread, self.start), MEMORY * (now - self.start))
            self.heard[thread] = now
            self.done += n
            self.note, left = note or self.note, self.left
        self.moved(n, left)
        with self.lock:
            finished = n > 0 and self.done >= self.total
            if finished or (self.done > self.before and now - self.last >= EVERY):
                self.last = now
                self.line(self._line(now - self.start))

    @property
    def left(self) -> float | None:
        """The seconds that the rest takes as many threads as there are; kinds not begun as long as the others."""
        begun = [pace for pace in self.paces.values() if pace.units]
        if not begun:
            return None
        usual = sum(pace.seconds for pace in begun) / sum(pace.units for pace in begun)
        times = [(p.seconds + p.since) / p.units if p.units else usual for p in self.paces.values()]
        rest = sum(p.left * time for p, time in zip(self.paces.values(), times, strict=True))
        return rest / len(self.heard)

    def _line(self, elapsed: float) -> str:
        left = f", {self.left:.0f} s left" if self.done < self.total else ""
        progress = f"{self.title}: {self.done}/{counted(self.total, self.unit)} in {elapsed:.1f} s{left}"
        return f"{progress}, {self.note}" if self.note else progress


def counted(count: int, unit: str) -> str:
    """`8 rollouts`, `1 rollout`: units are named in the plural."""
    return f"{count} {unit.removesuffix('s') if count == 1 else unit}"


class Wait:
    """Work under way: `done` of `total` units, where it can count them; the time that it takes follows from both.

    What comes before the first units, such as a compilation, is not multiplied: `advance(0)` says that they begin.
    """

    def __init__(self, what: str, seconds: float | None, often: str, total: int) -> None:
        self.what, self.seconds, self.often, self.total, self.done = what, seconds, often, total, 0
        self.start = self.began = self.latest = time.perf_counter()

    def advance(self, n: int) -> None:
        """n units more are done."""
        self.latest = time.perf_counter()
        if not self.done and n == 0:
            self.began = self.latest
        self.done += n

    @property
    def expected(self) -> float | None:
        """The seconds that the work takes in all, as far as one knows."""
        if self.total and self.done:
            return self.began - self.start + (self.latest - self.began) * self.total / self.done
        return self.seconds

    @property
    def line(self) -> str:
        """The sentence: `compiling 5 kernels of plant scalar: about 3 s, once per plant`."""
        expected = self.expected
        words = [f"about {duration(expected)}" if expected else "", self.often]
        ending = ", ".join(filter(None, words))
        return f"{self.what}: {ending}" if ending else self.what


@contextmanager
def said(what: str, seconds: float | None = None, often: str = "", total: int = 0) -> Iterator[Wait]:
    """In the block, work that a line is written of once it has lasted PATIENCE, or SHORT where it will end before that.

    `seconds` is a guess of how long it takes, which a slow machine makes wrong: it delays no line. `often` is how often
    it does. With a `total` of units the time follows from `advance`. Within work of which a line may come, other work
    adds none.
    """
    work = Wait(what, seconds, often, total)
    if _said.get() or os.environ.get(VARIABLE):
        yield work
        return
    over = threading.Event()
    watcher = threading.Thread(target=_watch, args=(work, over, _listeners[-1] if _listeners else _write), daemon=True)
    token = _said.set(True)
    watcher.start()
    try:
        yield work
    finally:
        over.set()
        _said.reset(token)
        watcher.join()  # or its line could come after what follows


@contextmanager
def quiet() -> Iterator[None]:
    """In the block nothing is said."""
    token = _said.set(True)
    try:
        yield
    finally:
        _said.reset(token)


@contextmanager
def heard(listener: Callable[[str], None]) -> Iterator[None]:
    """In the block lines go to this function instead of to stderr."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


def duration(seconds: float) -> str:
    """`3 s`, `2 min`, `5 h`, rounded up."""
    for unit, size in (("h", 3600), ("min", 60)):
        if seconds > 1.5 * size:
            return f"{round(seconds / size)} {unit}"
    return f"{max(round(seconds), 1)} s"


def _write(text: str) -> None:
    MESSAGES.write(f"npred: {printable(text)}\n")
    MESSAGES.flush()


def _watch(work: Wait, over: threading.Event, sink: Callable[[str], None]) -> None:
    """Wait, then write the line, unless the work is over."""
    if over.wait(PATIENCE):
        return
    if work.done and (work.expected or 0.0) < SHORT and over.wait(SHORT - PATIENCE):
        return
    sink(work.line)
