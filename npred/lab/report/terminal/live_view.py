"""The live view of a run, which a terminal rewrites: each stage, its work, for how long and how far."""

import math
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Literal

from rich.console import Console as RichConsole
from rich.console import ConsoleOptions, RenderableType, RenderResult
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Column
from rich.text import Text

from npred.base.json_files import escaped
from npred.lab.report.terminal.streams import MESSAGES, is_terminal

MARKS = {"waiting": "[dim]·", "running": "[cyan]▸", "run": "[green]✓", "hit": "[dim]✓", "stopped": "[red]✗"}
ECHO = 4  # columns left free at its right: a terminal's ^C must not begin a line that the view does not know
BAR = 24  # columns of a bar
BESIDE = 90  # columns that a training's name, words and times take: on a narrow screen the bar gives way first


class RunningBar(BarColumn):
    """The bar of a stage that counts its units, and of no other."""

    def render(self, task: Task) -> RenderableType:  # type: ignore[override]
        return super().render(task) if task.total else Text("")


class Words(ProgressColumn):
    """The description of a stage, or what it does: of all columns these are cut where the screen is narrow."""

    def __init__(self, what: Literal["description", "doing"]) -> None:
        super().__init__(Column())  # one that may wrap is made narrower, unlike the times
        self.what = what

    def render(self, task: Task) -> Text:
        words = task.description if self.what == "description" else task.fields["doing"]
        return Text(words, no_wrap=True, overflow="ellipsis")


@dataclass
class Narrower:
    """Rows that leave ECHO columns free."""

    rows: RenderableType

    def __rich_console__(self, console: RichConsole, options: ConsoleOptions) -> RenderResult:
        yield from console.render(self.rows, options.update_width(options.max_width - ECHO))


class LiveView(Progress):
    """A table of the stages that rewrites itself; safe to call from several threads."""

    def __init__(
        self, heading: str, titles: Sequence[str], clock: Callable[[], float], width: int | None = None
    ) -> None:
        self.heading, self.stages, self.adding = heading, dict[str, Task](), threading.Lock()
        console = RichConsole(file=MESSAGES, width=width)
        bar = RunningBar(bar_width=min(BAR, max(4, console.width - BESIDE)))
        columns = [TextColumn("{task.fields[mark]}"), Words("description"), bar, Words("doing")]
        times = [kind(table_column=Column(min_width=7)) for kind in (TimeElapsedColumn, TimeRemainingColumn)]
        # What others write, a library's warning say, would move the rows that the view is about to erase: it goes above
        # them. Not so stdout where that is another file.
        super().__init__(
            *columns, *times, console=console, get_time=clock,
            speed_estimate_period=math.inf, redirect_stdout=is_terminal(sys.stdout), redirect_stderr=True,
        )  # fmt: skip
        for title in titles:
            self._task(title)

    def doing(self, title: str, what: str) -> None:
        """A stage begins, or does something else now."""
        self.update(self._running(title).id, doing=escaped(what))

    @contextmanager
    def bar(self, title: str, total: int, done: int = 0) -> Iterator[Callable[[int, str], None]]:
        """The progress of a stage, or of a part, which gets a row; yields a function of units done and of words."""
        is_part = title not in self.stages
        task = self._running(title)
        with self._lock:  # rich would count what was there before as done now
            task.total, task.completed = total, done
            task._reset()
        yield lambda n, words: self.update(task.id, advance=n, doing=escaped(words))
        with self._lock:
            task.total = task.finished_time = None
        if is_part:
            self.finish(title, "run", task.fields["doing"])

    def finish(self, title: str, state: str, doing: str = "") -> None:
        """A stage has its result, `hit` or `run`, or none: `stopped`."""
        task = self._task(title)
        words = {"hit": "from the store", "stopped": "stopped"}.get(state, doing)
        with self._lock:
            task.total = task.finished_time = None
        self.stop_task(task.id)
        self.update(task.id, mark=MARKS[state], doing=words)

    def stop(self) -> None:
        """The end: the last state stays on the screen."""
        self.end()
        for stream in (sys.stdout, sys.stderr):  # a line of others that has not ended
            with suppress(OSError, ValueError, AttributeError):  # closed
                stream.flush()
        super().stop()

    def end(self) -> None:
        """Nothing follows: work that still runs was stopped, or failed."""
        for title, task in list(self.stages.items()):  # a thread may still add one
            if task.fields["mark"] == MARKS["running"]:
                self.finish(title, "stopped")

    def get_renderables(self) -> Iterable[RenderableType]:
        if self.heading:
            yield Text(escaped(self.heading), "bold", no_wrap=True, overflow="ellipsis")
        yield Narrower(self.make_tasks_table(self.tasks))

    def _task(self, title: str) -> Task:
        with self.adding:  # not rich's lock, which drawing takes: adding a task draws
            if title not in self.stages:
                added = self.add_task(escaped(title), start=False, total=None, mark=MARKS["waiting"], doing="")
                self.stages[title] = self._tasks[added]
            return self.stages[title]

    def _running(self, title: str) -> Task:
        """The task of that title, which runs from now on if it did not before."""
        task = self._task(title)
        if task.fields["mark"] != MARKS["running"]:
            with self._lock:
                task.start_time, task.stop_time = self.get_time(), None
            self.update(task.id, mark=MARKS["running"])
        return task
