"""What people and programs see: data on stdout, messages on stderr, no bars where stderr is no terminal."""

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from tqdm import tqdm

    from npred.events import Events
    from npred.live import Live

EVERY = 10.0  # seconds between two plain progress lines
WIDE = 240  # columns of what rich prints where there is no screen


class Bar(Protocol):
    """A task under way."""

    def advance(self, n: int = 1, note: str = "") -> None:
        """n units more are done; the note (a loss, say) replaces the last one."""


@dataclass
class Console:
    """quiet: warnings and errors only. verbose: more notes, tracebacks. rich is imported on terminals only."""

    quiet: bool = False
    verbose: bool = False
    clock: Callable[[], float] = time.monotonic
    stopped: bool = False
    live: "Live | None" = None
    events: "Events | None" = None

    def stop(self) -> None:
        """End the work of all threads at its next word of progress, as Ctrl-C ends that of the main one."""
        self.stopped = True

    def _check(self) -> None:
        if self.stopped:
            raise KeyboardInterrupt

    def out(self, data: Any) -> None:
        """Data for stdout: text as it is, anything else as rich prints it."""
        if isinstance(data, str):
            print(data, flush=True)
        else:
            from rich.console import Console as Rich

            # Into a file or a pipe nothing is cut to the width of a screen.
            Rich(width=None if sys.stdout.isatty() else WIDE).print(data)

    def json(self, document: Any) -> None:
        """One JSON document on stdout."""
        print(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False), flush=True)

    def note(self, text: str) -> None:
        """A message, unless quiet."""
        if not self.quiet:
            self._line(text)

    def detail(self, text: str) -> None:
        """A message for those who asked for more."""
        if self.verbose:
            self._line(text)

    def warn(self, text: str) -> None:
        """A warning."""
        self._line(f"warning: {text}", "yellow")

    def error(self, text: str) -> None:
        """A failure, in one line."""
        self._line("error: " + " ".join(text.split("\n")), "red")

    @contextmanager
    def watch(self, heading: str, titles: Sequence[str]) -> Iterator[None]:
        """On a terminal a live view of these stages while the block runs; elsewhere nothing but the lines of `bar`."""
        if self.quiet or not sys.stderr.isatty():
            yield
            return
        from npred.live import Live

        self.live = Live(heading, titles, self.clock)
        try:
            with self.live.shown():
                yield
        finally:
            self.live = None

    def finish(self, title: str, action: str, seconds: float) -> None:
        """A stage has its result: `hit` or `run`."""
        if self.live:
            self.live.finish(title, action, seconds)

    def measured(self, title: str, values: Mapping[str, float]) -> None:
        """What an epoch of a training reached: for the live view and for TensorBoard."""
        if self.live:
            self.live.measured(title, values)
        if self.events:
            self.events.write(title, values)

    @contextmanager
    def bar(self, title: str, total: int, unit: str) -> Iterator[Bar]:
        """The progress of `total` units: a bar with rate and time left on a terminal, else a line now and then."""
        if self.quiet:
            yield _Silent(self._check)
        elif self.live:
            with self.live.bar(title, total, unit, self._check) as row:
                yield row
        elif sys.stderr.isatty():
            from tqdm import tqdm

            with tqdm(total=total, desc=title, unit=f" {unit}", unit_scale=total >= 10_000, dynamic_ncols=True) as bar:
                yield _Task(bar, self._check)
        else:
            yield _Lines(self._line, self.clock, title, total, unit, self._check)

    def _line(self, text: str, style: str = "") -> None:
        if self.live:
            self.live.console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)
        elif sys.stderr.isatty():
            from tqdm import tqdm

            with tqdm.external_write_mode(file=sys.stderr):  # above the bars, if there are any
                self._rich.print(text, style=style, markup=False, highlight=False, soft_wrap=True)
        else:
            sys.stderr.write(text + "\n")  # at once: networks that train side by side speak side by side
            sys.stderr.flush()

    @cached_property
    def _rich(self) -> Any:
        from rich.console import Console as Rich

        return Rich(stderr=True)


class _Silent:
    def __init__(self, check: Callable[[], None]) -> None:
        self.check = check

    def advance(self, n: int = 1, note: str = "") -> None:
        self.check()


class _Task:
    def __init__(self, bar: "tqdm[Any]", check: Callable[[], None]) -> None:
        self.bar, self.check = bar, check

    def advance(self, n: int = 1, note: str = "") -> None:
        self.check()
        if note:
            self.bar.set_postfix_str(note, refresh=False)
        self.bar.update(n)


class _Lines:
    def __init__(
        self, line: Callable[[str], None], clock: Callable[[], float], title: str, total: int, unit: str,
        check: Callable[[], None],
    ):  # fmt: skip
        self.line, self.clock, self.title, self.total, self.unit, self.check = line, clock, title, total, unit, check
        self.start, self.done = clock(), 0
        self.last = self.start

    def advance(self, n: int = 1, note: str = "") -> None:
        self.check()
        self.done += n
        now = self.clock()
        if self.done >= self.total or (self.done and now - self.last >= EVERY):
            self.last = now
            self.line(self._text(now - self.start, note))

    def _text(self, elapsed: float, note: str) -> str:
        done = self.done >= self.total
        left = "" if done else f", {elapsed / self.done * (self.total - self.done):.0f} s left"
        progress = f"{self.title}: {self.done}/{self.total} {self.unit} in {elapsed:.1f} s{left}"
        return f"{progress}, {note}" if note else progress


def columns(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """An aligned table that is never cut, however wide: one row a line, so that grep and awk can read it."""
    table = [header, *rows]
    widths = [max(len(row[i]) for row in table) for i in range(len(header))]
    padded = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in table]
    return "\n".join(line.rstrip() for line in padded)
