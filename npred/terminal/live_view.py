"""The live view of a run: each stage, what it does, for how long and how far, and a training's errors.

A terminal rewrites it; in a notebook it is one output below the cell, which is updated in place and stays as it ends.
"""

import math
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import StringIO
from typing import Any

from rich.console import Console as RichConsole
from rich.console import JustifyMethod, RenderableType
from rich.progress import Progress, Task
from rich.progress_bar import ProgressBar
from rich.table import Column, Table
from rich.text import Text

from npred.json_files import escaped
from npred.terminal.console import Console
from npred.terminal.streams import MESSAGES, printable
from npred.terminal.waiting import counted

REFRESH = 8  # times per second
BAR = 24  # columns of a bar at most
GAP = 2
MANY = 10_000  # units of which a share says more than a count
MARKS = {
    "waiting": ("·", "dim"), "running": ("▸", "cyan"), "run": ("✓", "green"), "hit": ("✓", "dim"),
    "stopped": ("✗", "red"),
}  # fmt: skip
SECONDS = 0.5  # between two updates in a notebook
WIDTH = 110  # columns there
FORMAT = '<pre style="margin: 0; line-height: 1.3; font-family: monospace">{code}</pre>'
WORDS = {"hit": "from the store", "stopped": "stopped"}
Shown = Callable[[int, float | None], None]


class LiveView(Progress):
    """A table of the stages that rewrites itself; safe to call from several threads.

    The fields of a task: `state`, one of MARKS; `doing`, in words; `seconds`, of one that has ended; of a bar its
    `unit`, the units `before` it, of an earlier run, and the seconds `left`; of a training `loss` and `eps_sup`.
    """

    def __init__(self, heading: str, titles: Sequence[str], clock: Callable[[], float]) -> None:
        self.heading = heading  # rich draws at once
        self.lock = threading.Lock()  # not rich's, which drawing takes: adding a task draws
        super().__init__(console=RichConsole(file=MESSAGES), refresh_per_second=REFRESH, speed_estimate_period=math.inf,
                         redirect_stdout=False, redirect_stderr=False, get_time=clock)  # fmt: skip
        self.stages: dict[str, Task] = {}
        for title in titles:
            self._task(title)

    def doing(self, title: str, what: str) -> None:
        """A stage begins, or does something else now."""
        self._running(title).fields["doing"] = escaped(what)

    @contextmanager
    def bar(self, title: str, total: int, unit: str, done: int = 0) -> Iterator[Shown]:
        """The progress of a stage, or of a part, which gets a separate row; what it yields takes the units that are
        done, and the seconds that are left.
        """
        is_part = title not in self.stages
        task = self._running(title)
        self.update(task.id, total=total, completed=done, unit=escaped(unit), before=done, left=None)
        yield lambda n, left: self.update(task.id, advance=n, left=left) if n else None
        with self._lock:  # or it would change amid a drawing
            task.total = None
        if is_part:
            self.finish(title, "run", task.elapsed or 0.0)
            self.update(task.id, doing=counted(int(task.completed), escaped(unit)))

    def finish(self, title: str, state: str, seconds: float) -> None:
        """A stage has its result, `hit` or `run`, or none: `stopped`."""
        self.update(self._task(title).id, state=state, seconds=seconds, doing=WORDS.get(state, ""))

    def measured(self, title: str, values: Mapping[str, float]) -> None:
        """Take the metrics of an epoch of a training."""
        errors = {name: f"{values[name]:.1e}" for name in ("loss", "eps_sup") if name in values}
        self._task(title).fields.update(errors)

    def stop(self) -> None:
        """The end: the last state stays on the screen."""
        self.end()
        super().stop()

    def end(self) -> None:
        """Nothing follows: what still runs was stopped, or failed."""
        for title, task in list(self.stages.items()):  # a thread may still add one
            if task.fields["state"] == "running":
                self.finish(title, "stopped", task.elapsed or 0.0)

    def make_tasks_table(self, tasks: Iterable[Task]) -> Table:
        """The rows as they stand, without columns whose cells are all empty.

        No wider than the screen, where the bar yields: a row that wraps cannot be rewritten.
        """
        rows = [_cells(task) for task in tasks]
        shown = [index for index in range(len(COLUMNS)) if any(row[index] for row in rows)]
        table = Table(*(COLUMNS[index].copy() for index in shown), box=None, padding=(0, GAP, 0, 0), pad_edge=False)
        for row in rows:
            table.add_row(*(row[index] for index in shown))
        if self.heading:
            table.title, table.title_justify = Text(escaped(self.heading), "bold"), "left"
        return table

    def _task(self, title: str) -> Task:
        with self.lock:
            if title not in self.stages:
                fields = {"state": "waiting", "doing": "", "seconds": None, "loss": "", "eps_sup": ""}
                self.stages[title] = self._tasks[self.add_task(escaped(title), start=False, total=None, **fields)]
            return self.stages[title]

    def _running(self, title: str) -> Task:
        """The task of that title, which runs from now on if it did not before."""
        task = self._task(title)
        if task.fields["state"] != "running":
            task.start_time = self.get_time()
            self.update(task.id, state="running")
        return task


def _column(head: str, justify: JustifyMethod = "right", flexible: bool = False) -> Column:
    return Column(head, header_style="dim", justify=justify, no_wrap=not flexible, overflow="crop")


COLUMNS = (
    _column("", "left"), _column("stage", "left"), _column("", "left", flexible=True), _column("elapsed"),
    _column("left"), _column("loss"), _column("ε sup"),
)  # fmt: skip


def _cells(task: Task) -> list[RenderableType]:
    """The cells of a task's row, one for each of COLUMNS."""
    state, runs = task.fields["state"], _runs(task)
    elapsed = task.elapsed if runs else task.fields["seconds"]
    left = task.fields["left"] if runs and task.total else None
    name = Text(task.description, "dim" if state == "waiting" else "")
    errors = [Text(task.fields[error]) for error in ("loss", "eps_sup")]
    return [Text(*MARKS[state]), name, _progress(task), _clock(elapsed), _clock(left), *errors]


def _progress(task: Task) -> RenderableType:
    """The bar and its count, or what the stage does."""
    doing = task.fields["doing"]
    if not _runs(task) or not task.total:
        return Text(doing, "dim", no_wrap=True, overflow="crop")
    line = Table.grid(Column(max_width=BAR), Column(no_wrap=True, overflow="crop"), padding=(0, GAP, 0, 0))
    count = f"{task.completed:.0f}/{counted(int(task.total), task.fields['unit'])}"
    done = f"{task.percentage:.0f}%" if task.total >= MANY else count
    text = done if task.completed > task.fields["before"] or not doing else doing
    line.add_row(ProgressBar(task.total, min(task.completed, task.total)), Text(text))
    return line


def _clock(seconds: float | None) -> Text:
    if seconds is None:
        return Text("")
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return Text(f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}")


def _runs(task: Task) -> bool:
    return task.fields["state"] == "running"


def is_notebook() -> bool:
    """True where the code runs in a notebook's kernel."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    return getattr(shell, "kernel", None) is not None


class NotebookConsole(Console):
    """A console whose live view is an output of a notebook. Its notes are what the view shows; warnings stand below."""

    @contextmanager
    def watch(self, heading: str, titles: Sequence[str]) -> Iterator[None]:
        """A live view of these stages while the block runs, its last state after it."""
        from IPython.display import display  # pyright: ignore[reportMissingImports]

        view = self.view = LiveView(heading, titles, self.clock)
        shown: Any = display(_bundle(view), raw=True, display_id=True)
        over = threading.Event()
        painter = threading.Thread(target=_paint, args=(view, shown.update, over), daemon=True)
        painter.start()
        try:
            yield
        finally:
            over.set()
            painter.join()
            view.end()
            shown.update(_bundle(view), raw=True)
            self.view = None

    def _line(self, text: str, style: str = "", shown: bool = True) -> None:
        self._logged(text)
        if style:
            MESSAGES.write(printable(text) + "\n")
            MESSAGES.flush()


def _paint(view: Any, update: Callable[..., None], over: threading.Event) -> None:
    while not over.wait(SECONDS):
        update(_bundle(view), raw=True)


def _bundle(view: Any) -> dict[str, str]:
    """The view as HTML and as text, as a notebook's file keeps it."""
    page = RichConsole(file=StringIO(), record=True, width=WIDTH, force_jupyter=False, force_terminal=True)
    page.print(view.make_tasks_table(view.tasks))
    text = page.export_text(clear=False)
    return {"text/plain": text.rstrip(), "text/html": page.export_html(code_format=FORMAT, inline_styles=True)}
