"""The live view of a run on a terminal: each stage, what it does, for how long and how far, and a training's errors."""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from npred.json_files import escaped
from npred.terminal.progress_bars import counted
from npred.terminal.streams import MESSAGES, columns_of

REFRESH = 8  # times a second
BAR = 24  # columns of a bar at most …
LEAST = 4  # … and at least; where there are not so many, there is none
GAP = 2
MANY = 10_000  # units of which a share says more than a count
MARKS = {
    "waiting": ("·", "dim"), "running": ("▸", "cyan"), "run": ("✓", "green"), "hit": ("✓", "dim"),
    "stopped": ("✗", "red"),
}  # fmt: skip
HEADS = ("", "stage", "", "elapsed", "left", "loss", "ε sup")
PROGRESS = 2  # the column of HEADS with the bar before it
NUMBERS = ("elapsed", "left", "loss", "ε sup")
WORDS = {"hit": "from the store", "stopped": "stopped"}


@dataclass
class Row:
    """A stage: its state (`waiting`, `running`, `run`, `hit` or `stopped`), since when it runs and what it does.

    Of a bar: `done` of `total`, `before` of them by an earlier run, and when it began.
    """

    title: str
    state: str = "waiting"
    since: float = 0.0
    seconds: float = 0.0
    doing: str = ""
    total: int = 0
    unit: str = ""
    done: int = 0
    before: int = 0
    begun: float = 0.0
    reached: dict[str, float] = field(default_factory=dict)

    def begin(self, now: float) -> None:
        """Run, from now on if it did not before."""
        if self.state != "running":
            self.state, self.since = "running", now

    def end(self, state: str, seconds: float) -> None:
        """Have run."""
        self.state, self.seconds, self.total, self.doing = state, seconds, 0, ""


class Live:
    """A table of the stages that rewrites itself; safe to tell from several threads."""

    def __init__(self, heading: str, titles: Sequence[str], clock: Callable[[], float]) -> None:
        from rich.console import Console
        from rich.live import Live as Display

        self.heading, self.clock, self.lock = heading, clock, threading.Lock()
        self.rows = {title: Row(title) for title in titles}
        self.console = Console(file=MESSAGES)
        self.display = Display(get_renderable=self.table, console=self.console, refresh_per_second=REFRESH,
                               redirect_stdout=False, redirect_stderr=False)  # fmt: skip

    @contextmanager
    def shown(self) -> Iterator[None]:
        """On the screen while the block runs; its last state stays there."""
        with self.display:
            try:
                yield
            finally:
                self._stop()

    def doing(self, title: str, what: str) -> None:
        """A stage begins, or does something else now."""
        with self.lock:
            row = self.rows.setdefault(title, Row(title))
            row.begin(self.clock())
            row.doing = what

    @contextmanager
    def bar(self, title: str, total: int, unit: str, done: int = 0) -> Iterator["Task"]:
        """The progress of a stage, or of a part that gets a row of its own; `done` units were there before."""
        with self.lock:
            own = title not in self.rows
            row, now = self.rows.setdefault(title, Row(title)), self.clock()
            row.begin(now)
            row.total, row.unit, row.done, row.before, row.begun = total, unit, done, done, now
        yield Task(self, row)
        with self.lock:
            if own:
                row.end("run", self.clock() - row.since)
                row.doing = counted(row.done, unit)
            row.total = 0

    def finish(self, title: str, action: str, seconds: float) -> None:
        """A stage has its result: `hit` or `run`."""
        with self.lock:
            self.rows.setdefault(title, Row(title)).end(action, seconds)

    def measured(self, title: str, values: Mapping[str, float]) -> None:
        """What an epoch of a training reached."""
        with self.lock:
            self.rows.setdefault(title, Row(title)).reached = dict(values)

    def table(self) -> Any:
        """The rows as they stand: no wider than the screen, for a row that wraps cannot be rewritten."""
        from rich.table import Table

        with self.lock:
            rows, now = list(self.rows.values()), self.clock()
            cells = [self._cells(row, now) for row in rows]
        table = Table(title=self._heading(), title_justify="left", box=None, padding=(0, GAP, 0, 0), pad_edge=False)
        for name in HEADS:
            shown = name if name in ("", "stage", "elapsed") or any(row[HEADS.index(name)] for row in cells) else ""
            justify = "right" if name in NUMBERS else "left"
            table.add_column(shown, header_style="dim", justify=justify, no_wrap=True, overflow="crop")
        room = self._room(cells, [row.total > 0 for row in rows])
        for row, line in zip(rows, cells, strict=True):
            table.add_row(*self._drawn(row, line, room))
        return table

    def _heading(self) -> Any:
        from rich.text import Text

        return Text(escaped(self.heading), "bold") if self.heading else None

    def _cells(self, row: Row, now: float) -> list[str]:
        mark, _ = MARKS[row.state]
        known = row.state == "running" and row.total > 0
        elapsed = {"running": now - row.since, "waiting": None}.get(row.state, row.seconds)
        losses = [f"{row.reached[key]:.1e}" if key in row.reached else "" for key in ("loss", "eps_sup")]
        what = _count(row) if known and row.done > row.before else row.doing or (_count(row) if known else "")
        return [mark, escaped(row.title), WORDS.get(row.state, what), _clock(elapsed),
                _clock(_left(row, now)) if known else "", *losses]  # fmt: skip

    def _room(self, cells: list[list[str]], barred: list[bool]) -> int:
        """The columns left for a bar in the rows that have one, beside its count."""
        others = [max(columns_of(row[i]) for row in [list(HEADS), *cells]) for i in range(len(HEADS)) if i != PROGRESS]
        count = max((columns_of(row[PROGRESS]) for row, has in zip(cells, barred, strict=True) if has), default=0)
        return min(BAR, self.console.width - sum(others) - GAP * len(others) - GAP - count - GAP)

    def _drawn(self, row: Row, cells: list[str], room: int) -> list[Any]:
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        _, style = MARKS[row.state]
        title = Text(cells[1], style if row.state == "waiting" else "")
        progress: Any = Text(cells[PROGRESS], "" if row.total else "dim")
        if row.state == "running" and row.total and room >= LEAST:
            line = Table.grid(padding=(0, GAP, 0, 0))
            line.add_row(ProgressBar(row.total, min(row.done, row.total), room), progress)
            progress = line
        return [Text(cells[0], style), title, progress, *map(Text, cells[PROGRESS + 1 :])]

    def _stop(self) -> None:
        """What still runs at the end was stopped, or failed."""
        with self.lock:
            for row in self.rows.values():
                if row.state == "running":
                    row.end("stopped", self.clock() - row.since)


def _count(row: Row) -> str:
    if row.total >= MANY:
        return f"{min(row.done, row.total) / row.total:.0%}"
    return f"{row.done}/{counted(row.total, row.unit)}"


def _left(row: Row, now: float) -> float | None:
    """Seconds, from the rate of this run: what an earlier one did took no time of it."""
    if row.done <= row.before:
        return None
    return (now - row.begun) / (row.done - row.before) * (row.total - row.done)


def _clock(seconds: float | None) -> str:
    if seconds is None:
        return ""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


@dataclass
class Task:
    """A bar of the live view."""

    live: Live
    row: Row

    def advance(self, n: int = 1, note: str = "") -> None:
        """n units more are done; a training's note is in columns of its own, another one stays out of the view."""
        with self.live.lock:
            self.row.done += n
