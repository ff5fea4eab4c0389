"""The progress of a task where there is no screen: nothing, or a line now and then."""

from collections.abc import Callable
from typing import Protocol

EVERY = 10.0  # seconds between two lines


class Bar(Protocol):
    """A task under way."""

    def advance(self, n: int = 1, note: str = "") -> None:
        """n units more are done; the note (a loss, say) replaces the last one."""


class Checked:
    """Several bars of one task; `check` ends it where its run has been stopped."""

    def __init__(self, check: Callable[[], None], *bars: Bar) -> None:
        self.check, self.bars = check, bars

    def advance(self, n: int = 1, note: str = "") -> None:
        """n units more are done. Raises what `check` raises."""
        self.check()
        for bar in self.bars:
            bar.advance(n, note)


class Lines:
    """A line every EVERY seconds and one at the end; `done` units were there before, and took no time of this run."""

    def __init__(
        self, line: Callable[[str], None], clock: Callable[[], float], title: str, total: int, unit: str, done: int = 0
    ) -> None:
        self.line, self.clock, self.title, self.total, self.unit = line, clock, title, total, unit
        self.before, self.done, self.note, self.start = done, done, "", clock()
        self.last = self.start

    def advance(self, n: int = 1, note: str = "") -> None:
        """n units more are done."""
        self.done += n
        self.note = note or self.note
        now = self.clock()
        finished = n > 0 and self.done >= self.total
        if finished or (self.done > self.before and now - self.last >= EVERY):
            self.last = now
            self.line(self._text(now - self.start))

    def _text(self, elapsed: float) -> str:
        left = ""
        if self.done < self.total:
            left = f", {elapsed / (self.done - self.before) * (self.total - self.done):.0f} s left"
        progress = f"{self.title}: {self.done}/{counted(self.total, self.unit)} in {elapsed:.1f} s{left}"
        return f"{progress}, {self.note}" if self.note else progress


def counted(count: int, unit: str) -> str:
    """`8 rollouts`, `1 rollout`: units are named in the plural."""
    return f"{count} {unit.removesuffix('s') if count == 1 else unit}"
