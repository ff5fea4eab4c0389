"""The live view of a run on a terminal: each stage, how far it is, loss and error of a training, time left."""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

REFRESH = 8  # times a second
BAR = 24  # columns
MARKS = {"waiting": ("·", "dim"), "running": ("▸", "cyan"), "run": ("✓", "green"), "hit": ("✓", "dim")}
HEADS = ("", "stage", "", "", "left", "loss", "ε held out", "")
NUMBERS = ("left", "loss", "ε held out")


@dataclass
class Row:
    """A stage: its state (`waiting`, `running`, `run` or `hit`), progress, and what it said last."""

    title: str
    state: str = "waiting"
    total: int = 0
    unit: str = ""
    done: int = 0
    start: float = 0.0
    note: str = ""
    reached: dict[str, float] = field(default_factory=dict)


class Live:
    """A table of the stages that rewrites itself; safe to tell from several threads."""

    def __init__(self, heading: str, titles: Sequence[str], clock: Callable[[], float]) -> None:
        from rich.console import Console
        from rich.live import Live as Display

        self.heading, self.clock, self.lock = heading, clock, threading.Lock()
        self.rows = {title: Row(title) for title in titles}
        self.console = Console(stderr=True)
        self.display = Display(get_renderable=self.table, console=self.console, refresh_per_second=REFRESH,
                               redirect_stdout=False, redirect_stderr=False)  # fmt: skip

    @contextmanager
    def shown(self) -> Iterator[None]:
        """On the screen while the block runs; its last state stays there."""
        with self.display:
            yield

    @contextmanager
    def bar(self, title: str, total: int, unit: str, check: Callable[[], None]) -> Iterator["Task"]:
        """The progress of a stage, or of a part that gets a row of its own."""
        with self.lock:
            row = self.rows.setdefault(title, Row(title))
            row.state, row.total, row.unit, row.done, row.start = "running", total, unit, 0, self.clock()
        yield Task(self, row, check)

    def finish(self, title: str, action: str, seconds: float) -> None:
        """A stage has its result: `hit` or `run`."""
        with self.lock:
            row = self.rows.setdefault(title, Row(title))
            row.state, row.note = action, "from the store" if action == "hit" else f"{seconds:.1f} s"

    def measured(self, title: str, values: Mapping[str, float]) -> None:
        """What an epoch of a training reached."""
        with self.lock:
            self.rows.setdefault(title, Row(title)).reached = dict(values)

    def table(self) -> Any:
        """The rows as they stand."""
        from rich.table import Table

        table = Table(title=self.heading, title_justify="left", title_style="bold", box=None, pad_edge=False)
        for name in HEADS:
            table.add_column(name, header_style="dim", justify="right" if name in NUMBERS else "left")
        with self.lock:
            for row in self.rows.values():
                table.add_row(*self._cells(row))
        return table

    def _cells(self, row: Row) -> list[Any]:
        from rich.progress_bar import ProgressBar
        from rich.text import Text

        mark, style = MARKS[row.state]
        known = row.total and row.state == "running"
        bar = ProgressBar(row.total, min(row.done, row.total), BAR) if known else ""
        count = f"{row.done}/{row.total} {row.unit}" if known else ""
        losses = [f"{row.reached[key]:.2e}" if key in row.reached else "" for key in ("loss", "eps_sup")]
        return [Text(mark, style), Text(row.title, style if row.state == "waiting" else ""), bar, count,
                self._left(row) if known else "", *losses, Text(row.note, "dim")]  # fmt: skip

    def _left(self, row: Row) -> str:
        if not row.done:
            return "–"
        seconds = round((self.clock() - row.start) / row.done * (row.total - row.done))
        return f"{seconds // 60}:{seconds % 60:02d}"


@dataclass
class Task:
    """A bar of the live view."""

    live: Live
    row: Row
    check: Callable[[], None]

    def advance(self, n: int = 1, note: str = "") -> None:
        """n units more are done; a training's note is in columns of its own."""
        self.check()
        with self.live.lock:
            self.row.done += n
            self.row.note = "" if self.row.reached else note
