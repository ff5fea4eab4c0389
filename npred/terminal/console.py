"""The console: data on stdout, messages on stderr, no bars where stderr is no terminal."""

import json
import sys
import textwrap
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from npred.json_files import escaped
from npred.terminal import interruption, streams
from npred.terminal.run_log import Events, RunLog
from npred.terminal.waiting import Bar

if TYPE_CHECKING:
    from npred.terminal.live_view import LiveView, Shown

GAP = 2  # columns between two of a table
NARROW = 12  # a column is not folded to less …
WORD = 40  # … and words of up to so many columns are broken last


@dataclass
class Console:
    """quiet: warnings and errors only. verbose: more notes, tracebacks. rich is imported on terminals only."""

    quiet: bool = False
    verbose: bool = False
    clock: Callable[[], float] = time.monotonic
    stopped: bool = False
    view: "LiveView | None" = None
    events: Events | None = None
    log: RunLog | None = None

    def stop(self) -> None:
        """End the work of all threads at its next report of progress, as Ctrl-C ends that of the main one."""
        self.stopped = True

    @property
    def width(self) -> int | None:
        """The columns of the screen that stdout is; None for a file or a pipe, where nothing is folded."""
        return streams.width(sys.stdout)

    def out(self, text: str) -> None:
        """Data for stdout, its lines folded to the screen. Raises NpredError where stdout is closed or full."""
        streams.answer(streams.wrapped(streams.printable(text), self.width))

    def json(self, document: object) -> None:
        """One JSON document on stdout, with escapes for what a terminal obeys. Raises NpredError as `out` does."""
        text = json.dumps(document, indent=2, ensure_ascii=not streams.is_utf8(sys.stdout), allow_nan=False)
        streams.answer("".join(c if c.isprintable() or c == "\n" else json.dumps(c)[1:-1] for c in text))

    def note(self, text: str) -> None:
        """A message, unless quiet."""
        self._line(text, shown=not self.quiet)

    def wait(self, text: str) -> None:
        """What keeps the user waiting: a message, unless the live view is there, which shows that work goes on."""
        self._line(text, shown=not self.quiet and not self.view)

    def detail(self, text: str) -> None:
        """A message for those who asked for more, and for the log."""
        self._line(text, shown=self.verbose)

    def warn(self, text: str) -> None:
        """A warning."""
        self._line(f"warning: {text}", "yellow")

    def error(self, text: str) -> None:
        """A failure, in one line."""
        self._line("error: " + " ".join(text.split("\n")), "red")

    def keep_log(self, store: Path, name: str) -> None:
        """From now on also write all messages, and each epoch of a training, to a file in the store's folder."""
        self.log = self.log or RunLog.open(store, name)
        self._logged(f"npred {' '.join(sys.argv[1:])}  (in {Path.cwd()})")

    def close(self) -> None:
        """The end of the log."""
        if self.log:
            self.log.close()
            self.log = None

    @contextmanager
    def watch(self, heading: str, titles: Sequence[str]) -> Iterator[None]:
        """On a terminal a live view of these stages while the block runs; elsewhere nothing but the lines of `bar`."""
        if self.quiet or not (streams.MESSAGES.isatty() and streams.is_utf8(streams.MESSAGES)):
            yield
            return
        from npred.terminal.live_view import LiveView

        self.view = LiveView(heading, titles, self.clock)
        try:
            with self.view:
                yield
        finally:
            self.view = None

    def head(self, heading: str) -> None:
        """Another heading for the live view."""
        if self.view:
            self.view.heading = heading

    def doing(self, title: str, what: str) -> None:
        """A stage begins, or does something else now: importing, compiling, drawing."""
        if self.view:
            self.view.doing(title, what)
            self._logged(f"{title}: {what}")
        else:
            self.detail(f"{title}: {what}")

    def finish(self, title: str, action: str, seconds: float) -> None:
        """A stage has its result, `hit` or `run`, or none: `stopped`."""
        if self.view:
            self.view.finish(title, action, seconds)
        outcome = {"hit": "from the store", "run": "done"}.get(action, action)
        self._line(f"{title}: {outcome} after {seconds:.1f} s", shown=self.verbose and not self.view)

    def measured(self, title: str, values: Mapping[str, float]) -> None:
        """Take the metrics of an epoch of a training: for the live view, for TensorBoard and for the log."""
        if self.view:
            self.view.measured(title, values)
        if self.events:
            self.events.write(title, values)
        self._logged(f"{title}: " + ", ".join(f"{name} {value:.4g}" for name, value in values.items()))

    @contextmanager
    def bar(self, title: str, total: int | Mapping[Any, int], unit: str, done: int = 0) -> Iterator[Bar]:
        """The progress of `total` units, named in the plural, or of such by kind: a bar with the time left on a
        terminal, else a line now and then. `done` of them were there before.
        """
        with ExitStack() as stack:
            if not self.view:
                stack.enter_context(self.watch("", []))
            count = total if isinstance(total, int) else sum(total.values())
            shown = stack.enter_context(self.view.bar(title, count, unit, done)) if self.view else None
            line = self._logged if self.view or self.quiet else self._line
            yield Bar(title, total, unit, done, self.clock, partial(self._moved, shown), line)

    def _moved(self, shown: "Shown | None", n: int, left: float | None) -> None:
        interruption.check()
        if self.stopped:
            raise KeyboardInterrupt
        if shown:
            shown(n, left)

    def _logged(self, text: str) -> None:
        if self.log:
            self.log.write(text)

    def _line(self, text: str, style: str = "", shown: bool = True) -> None:
        self._logged(text)
        if not shown:
            return
        text = streams.wrapped(streams.printable(text), streams.width(streams.MESSAGES))
        if not self.view and not (style and streams.MESSAGES.isatty()):
            streams.MESSAGES.write(text + "\n")  # in one piece: networks that train side by side speak side by side
            streams.MESSAGES.flush()
            return
        from rich.console import Console as Rich

        screen = self.view.console if self.view else Rich(file=streams.MESSAGES)
        screen.print(text, style=style, markup=False, emoji=False, highlight=False, soft_wrap=True)


def columns(
    header: Sequence[str], rows: Sequence[Sequence[str]], width: int | None = None, numbers: Collection[str] = ()
) -> str:
    """An aligned table that is never cut; the columns of `numbers` are aligned at their right.

    One row per line, so that grep and awk can read it, or, with a `width`, the widest columns folded until it fits.
    """
    table = [[escaped(cell) for cell in row] for row in (header, *rows)]
    widths = [max(map(streams.columns_of, cells)) for cells in zip(*table, strict=True)]
    if width is not None:
        words = [min(WORD, max(map(_longest, cells))) for cells in zip(*table, strict=True)]
        widths = _fitted(_fitted(widths, width, words), width, [NARROW] * len(widths))
    right = [name in numbers for name in header]
    lines: list[str] = []
    for row in table:
        folded = [_folded(cell, room) for cell, room in zip(row, widths, strict=True)]
        for line in zip_longest(*folded, fillvalue=""):
            padded = [_padded(*cell) for cell in zip(line, widths, right, strict=True)]
            lines.append((" " * GAP).join(padded).rstrip())
    return "\n".join(lines)


def _fitted(widths: list[int], width: int, least: list[int]) -> list[int]:
    """The widths, the largest made smaller until they fit, but none less than its least."""
    fitted = list(widths)
    while sum(fitted) + GAP * (len(fitted) - 1) > width:
        foldable = [i for i in range(len(fitted)) if fitted[i] > least[i]]
        if not foldable:
            break
        fitted[max(foldable, key=fitted.__getitem__)] -= 1
    return fitted


def _longest(cell: str) -> int:
    return max(map(streams.columns_of, cell.split()), default=0)


def _folded(cell: str, room: int) -> list[str]:
    return [cell] if streams.columns_of(cell) <= room else textwrap.wrap(cell, room, break_on_hyphens=False)


def _padded(cell: str, room: int, right: bool) -> str:
    blanks = " " * (room - streams.columns_of(cell))
    return blanks + cell if right else cell + blanks
