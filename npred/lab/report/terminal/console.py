"""The console: data on stdout, messages on stderr, no bars where stderr is no terminal; and the log that a run leaves.

That is a log, a text file in the store's folder with its messages and each epoch of a training, and on request the
epochs as TensorBoard's event files.
"""

import json
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self, TextIO

from npred.base.errors import required
from npred.base.json_files import escaped
from npred.base.progress import VARIABLE, counted
from npred.lab.report.terminal import interruption, streams

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

    from npred.lab.report.terminal.live_view import LiveView

EVERY = 10.0  # seconds between two lines of a bar
UNFOLDED = 10**6  # columns of a table for a file or a pipe
KEPT = 100  # logs of a store; older ones make room
LOG = re.compile(r"\d{4}-\d\d-\d\d-\d{6}-.*\.log")


class RunLog:
    """An open log. A line that cannot be written, on a full disk say, is left out: no run ends for its log."""

    def __init__(self, path: Path, file: TextIO) -> None:
        self.path, self.file = path, file

    @classmethod
    def open(cls, store: Path, name: str) -> Self | None:
        """The log of a run that begins now, logs/TIME-NAME.log in the store; None where none can be written."""
        folder = store / "logs"
        stamp = f"{time.strftime('%Y-%m-%d-%H%M%S')}-{name}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path = folder / f"{stamp}.log"
            if path.exists():  # two runs in a second
                path = folder / f"{stamp}-{os.getpid()}.log"
            log = cls(path, path.open("a", encoding="utf-8", errors="backslashreplace"))
        except OSError:
            return None
        with suppress(OSError):  # the oldest beyond KEPT go; a file with another name is not npred's
            for path in sorted(path for path in folder.iterdir() if LOG.fullmatch(path.name))[:-KEPT]:
                path.unlink(missing_ok=True)
        return log

    def write(self, text: str) -> None:
        """Lines, each with the time of day."""
        now = time.strftime("%H:%M:%S")
        with suppress(OSError, ValueError):  # ValueError: a thread still speaks after the end
            self.file.write("".join(f"{now}  {line}\n" for line in streams.printable(text).split("\n")))
            self.file.flush()

    def close(self) -> None:
        with suppress(OSError):
            self.file.close()


class Events:
    """Writes one folder per training: loss, held-out errors and learning rate by epoch.

    Event files hold times and host names, so they are no part of a result. Raises MissingError without TensorBoard.
    """

    def __init__(self, folder: Path) -> None:
        module = required("--tensorboard", "torch.utils.tensorboard", "tensorboard", "tensorboard")
        self.folder, self.open_writer, self.lock = folder, module.SummaryWriter, threading.Lock()
        self.writers: dict[str, SummaryWriter] = {}  # by training

    def write(self, title: str, values: Mapping[str, float]) -> None:
        """The values of one epoch, `epoch` among them."""
        with self.lock:  # two networks may be in training
            if title not in self.writers:
                self.writers[title] = self.open_writer(str(self.folder / title.replace(" ", "-")))
            writer = self.writers[title]
        for name, value in values.items():
            if name != "epoch":
                writer.add_scalar(name, value, values["epoch"])

    def replay(self, title: str, path: Path) -> None:
        """The epochs of a training that the store had, from its metrics.jsonl."""
        for line in path.read_text(encoding="utf-8").splitlines():
            self.write(title, json.loads(line))

    def close(self) -> None:
        for writer in self.writers.values():
            writer.close()


@dataclass
class Console:
    """quiet: warnings and errors only. verbose: more notes, tracebacks."""

    quiet: bool = False
    verbose: bool = False
    clock: Callable[[], float] = time.monotonic
    stopped: bool = False
    view: "LiveView | None" = None
    events: Events | None = None
    log: RunLog | None = None
    waited: set[str] = field(default_factory=set)
    answered: bool = False

    @property
    def still(self) -> bool:
        """True if it shows no progress: quiet, or NPRED_QUIET is set."""
        return self.quiet or bool(os.environ.get(VARIABLE))

    def stop(self) -> None:
        """End the work of all threads at its next report of progress, as Ctrl-C ends that of the main one."""
        self.stopped = True

    @property
    def width(self) -> int | None:
        """The columns of the screen that stdout is; None for a file or a pipe, where nothing is folded."""
        return streams.width(sys.stdout)

    def out(self, text: str) -> None:
        """Data for stdout, its lines folded to the screen. Raises NpredError where stdout is closed or full."""
        self.answered = True
        streams.answer(streams.folded(streams.printable(text), self.width))

    def json(self, document: object) -> None:
        """One JSON document on stdout, with escapes for bytes a terminal obeys. Raises NpredError as `out` does."""
        text = json.dumps(document, indent=2, ensure_ascii=not streams.is_utf8(sys.stdout), allow_nan=False)
        self.answered = True
        streams.answer("".join(c if c.isprintable() or c == "\n" else json.dumps(c)[1:-1] for c in text))

    def note(self, text: str) -> None:
        """A message, unless quiet."""
        self._line(text, shown=not self.quiet)

    def wait(self, text: str) -> None:
        """A message that work takes long, unless the live view is there, which shows that work goes on.

        What is to be expected "once per" something is said once in a run: many kernels are compiled for one plant.
        """
        often = text.rpartition(", ")[2]
        if often.startswith("once per"):
            if often in self.waited:
                return
            self.waited.add(often)
        self._line(text, shown=not self.still and not self.view)

    def detail(self, text: str) -> None:
        """A message for those who asked for more, and for the log."""
        self._line(text, shown=self.verbose)

    def warn(self, text: str) -> None:
        self._line(f"warning: {text}", "yellow")

    def error(self, text: str) -> None:
        """A failure, in one line."""
        self._line("error: " + " ".join(text.split("\n")), "red")

    def keep_log(self, store: Path, name: str) -> None:
        """From now on also write all messages, and each epoch of a training, to a file in the store's folder."""
        self.log = self.log or RunLog.open(store, name)
        self._logged(f"npred {' '.join(sys.argv[1:])}  (in {Path.cwd()})")

    def close(self) -> None:
        if self.log:
            self.log.close()
            self.log = None

    @contextmanager
    def watch(self, heading: str, titles: Sequence[str]) -> Iterator[None]:
        """On a terminal a live view of these stages while the block runs; elsewhere nothing but the lines of `bar`."""
        if self.still or not (streams.MESSAGES.isatty() and streams.is_utf8(streams.MESSAGES)):
            yield
            return
        from npred.lab.report.terminal.live_view import LiveView

        self.view = LiveView(heading, titles, self.clock)
        try:
            with interruption.below(self.view), self.view:
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
            self.view.finish(title, action)
        outcome = {"hit": "from the store", "run": "done"}.get(action, action)
        self._line(f"{title}: {outcome} after {seconds:.1f} s", shown=self.verbose and not self.view)

    def measured(self, title: str, values: Mapping[str, float]) -> None:
        """Take the metrics of an epoch of a training: for TensorBoard and for the log."""
        if self.events:
            self.events.write(title, values)
        self._logged(f"{title}: " + ", ".join(f"{name} {value:.4g}" for name, value in values.items()))

    @contextmanager
    def bar(self, title: str, total: int, unit: str, done: int = 0) -> Iterator["Bar"]:
        """The progress of `total` units, in the plural, `done` of them before: a bar, without a terminal lines."""
        with ExitStack() as stack:
            if not self.view:
                stack.enter_context(self.watch("", []))
            shown = stack.enter_context(self.view.bar(title, total, done)) if self.view else None
            line = self._logged if self.view or self.still else self._line
            yield Bar(self, title, total, unit, done, line, shown)

    def _logged(self, text: str) -> None:
        if self.log:
            self.log.write(text)

    def _line(self, text: str, style: str = "", shown: bool = True) -> None:
        self._logged(text)
        if not shown:
            return
        text = streams.folded(streams.printable(text), streams.width(streams.MESSAGES))
        if not self.view and not (style and streams.MESSAGES.isatty()):
            streams.MESSAGES.write(text + "\n")  # in one piece: networks that train side by side speak side by side
            streams.MESSAGES.flush()
            return
        from rich.console import Console as Rich

        screen = self.view.console if self.view else Rich(file=streams.MESSAGES)
        screen.print(text, style=style, markup=False, emoji=False, highlight=False, soft_wrap=True)


class Bar:
    """`total` units of work; `done` of them were there before, and took no time of this run.

    `line` gets a text every EVERY seconds and one at the end; `shown` the units of each advance, and words for them.
    """

    def __init__(
        self, console: Console, title: str, total: int, unit: str, done: int, line: Callable[[str], None],
        shown: Callable[[int, str], None] | None,
    ) -> None:  # fmt: skip
        self.console, self.title, self.total, self.unit = console, title, total, unit
        self.line, self.shown, self.lock = line, shown, threading.Lock()
        self.before, self.done, self.note = done, done, ""
        self.start = self.last = console.clock()

    def advance(self, n: int = 1, note: str = "") -> None:
        """n units more are done; the note (a loss, say) replaces the last one. Raises KeyboardInterrupt to end it."""
        interruption.check()
        if self.console.stopped:
            raise KeyboardInterrupt
        with self.lock:
            self.done, self.note, now = self.done + n, note or self.note, self.console.clock()
            count, noted = f"{self.done}/{counted(self.total, self.unit)}", self.note and f", {self.note}"
            if n and self.shown:
                self.shown(n, count + noted)
            here, finished = self.done - self.before, self.done >= self.total
            if (n > 0 and finished) or (here > 0 and now - self.last >= EVERY):
                self.last, elapsed = now, now - self.start
                left = "" if finished else f", {elapsed / here * (self.total - self.done):.0f} s left"
                self.line(f"{self.title}: {count} in {elapsed:.1f} s{left}{noted}")


def columns(
    header: Sequence[str], rows: Sequence[Sequence[str]], width: int | None = None, numbers: Collection[str] = ()
) -> str:
    """An aligned table that is never cut; the columns of `numbers` are aligned at their right.

    One row per line, so that grep and awk can read it, or, with a `width`, the widest columns folded until it fits.
    """
    from rich.console import Console as Rich
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="")
    room = (width or UNFOLDED) // max(len(header), 1) - 2  # room of each column, if all were alike
    for cells in zip(header, *rows, strict=True):
        justify: Literal["left", "right"] = "right" if cells[0] in numbers else "left"
        whole = max(map(len, cells)) <= room  # a column of keys is not broken for one of sentences
        table.add_column(Text(escaped(cells[0])), justify=justify, overflow="fold", no_wrap=whole)
    for row in rows:
        table.add_row(*(Text(escaped(cell)) for cell in row))
    page = StringIO()
    Rich(file=page, width=width or UNFOLDED, color_system=None, force_terminal=False, force_jupyter=False).print(table)
    return "\n".join(line.rstrip() for line in page.getvalue().splitlines())
