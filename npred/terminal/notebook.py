"""The live view in a notebook: one output below the cell, which is updated in place and stays as it ends."""

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import StringIO
from typing import Any

from npred.terminal.console import Console
from npred.terminal.streams import MESSAGES, printable

SECONDS = 0.5  # between two updates
WIDTH = 110  # columns
FORMAT = '<pre style="margin: 0; line-height: 1.3; font-family: monospace">{code}</pre>'


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

        from npred.terminal.live_view import LiveView

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
    from rich.console import Console as Rich

    page = Rich(file=StringIO(), record=True, width=WIDTH, force_jupyter=False, force_terminal=True)
    page.print(view.make_tasks_table(view.tasks))
    text = page.export_text(clear=False)
    return {"text/plain": text.rstrip(), "text/html": page.export_html(code_format=FORMAT, inline_styles=True)}
