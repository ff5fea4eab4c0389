"""The progress of a piece of work: what stages call, and the lines of a terminal that is no screen."""

import threading
from collections.abc import Callable

EVERY = 10.0  # seconds between two lines


class Bar:
    """`total` units of work, named in the plural; `done` of them were there before, and took no time of this run.

    An advance calls `moved` with its units; `line` gets a text every EVERY seconds and one at the end.
    """

    def __init__(
        self, title: str, total: int, unit: str, done: int, clock: Callable[[], float],
        moved: Callable[[int], None], line: Callable[[str], None],
    ) -> None:  # fmt: skip
        self.title, self.total, self.unit, self.before, self.done = title, total, unit, done, done
        self.clock, self.moved, self.line, self.lock = clock, moved, line, threading.Lock()
        self.note, self.start = "", clock()
        self.last = self.start

    def advance(self, n: int = 1, note: str = "") -> None:
        """n units more are done; the note (a loss, say) replaces the last one. Raises what `moved` raises."""
        self.moved(n)
        with self.lock:
            self.done += n
            self.note = note or self.note
            now = self.clock()
            finished = n > 0 and self.done >= self.total
            if finished or (self.done > self.before and now - self.last >= EVERY):
                self.last = now
                self.line(self._line(now - self.start))

    def _line(self, elapsed: float) -> str:
        left = ""
        if self.done < self.total:
            left = f", {elapsed / (self.done - self.before) * (self.total - self.done):.0f} s left"
        progress = f"{self.title}: {self.done}/{counted(self.total, self.unit)} in {elapsed:.1f} s{left}"
        return f"{progress}, {self.note}" if self.note else progress


def counted(count: int, unit: str) -> str:
    """`8 rollouts`, `1 rollout`: units are named in the plural."""
    return f"{count} {unit.removesuffix('s') if count == 1 else unit}"
