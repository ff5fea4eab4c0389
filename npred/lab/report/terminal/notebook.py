"""The live view in a notebook: one output below the cell, which is updated in place and stays as it ends."""

import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import StringIO
from typing import Any

from rich.console import Console as RichConsole

from npred.lab.report.terminal.console import Console
from npred.lab.report.terminal.live_view import LiveView
from npred.lab.report.terminal.streams import MESSAGES, printable

SECONDS = 0.5  # between two updates
WIDTH = 110  # columns
FORMAT = '<pre style="margin: 0; line-height: 1.3; font-family: monospace">{code}</pre>'


def is_notebook() -> bool:
    """True where the code runs in a notebook's kernel."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    return getattr(shell, "kernel", None) is not None


class NotebookConsole(Console):
    """A console whose live view is an output of a notebook. The view shows its notes; warnings stand below."""

    @contextmanager
    def watch(self, heading: str, titles: Sequence[str]) -> Iterator[None]:
        """A live view of these stages while the block runs, its last state after it."""
        from IPython.display import display  # pyright: ignore[reportMissingImports]

        view = self.view = LiveView(heading, titles, self.clock, WIDTH)
        output: Any = display(_bundle(view), raw=True, display_id=True)
        over = threading.Event()

        def paint() -> None:
            while not over.wait(SECONDS):
                output.update(_bundle(view), raw=True)

        painter = threading.Thread(target=paint, daemon=True)
        painter.start()
        try:
            yield
        finally:
            over.set()
            painter.join()
            view.end()
            output.update(_bundle(view), raw=True)
            self.view = None

    def _line(self, text: str, style: str = "", shown: bool = True) -> None:
        self._logged(text)
        if style:
            MESSAGES.write(printable(text) + "\n")
            MESSAGES.flush()


def _bundle(view: LiveView) -> dict[str, str]:
    """The view as HTML and as text, as a notebook's file keeps it."""
    page = RichConsole(file=StringIO(), record=True, width=WIDTH, force_jupyter=False, force_terminal=True)
    page.print(view.get_renderable())
    text = page.export_text(clear=False)
    return {"text/plain": text.rstrip(), "text/html": page.export_html(code_format=FORMAT, inline_styles=True)}
