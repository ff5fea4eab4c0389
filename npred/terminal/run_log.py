"""The log of a run, a text file in the store's folder: its messages with times, and each epoch of a training."""

import os
import re
import time
from contextlib import suppress
from pathlib import Path
from typing import Self, TextIO

from npred.terminal.streams import printable

FOLDER = "logs"
KEPT = 100  # logs of a store; older ones make room
_NAME = re.compile(r"\d{4}-\d\d-\d\d-\d{6}-.*\.log")


class RunLog:
    """An open log. What cannot be written, on a full disk say, is left out: no run ends for its log."""

    def __init__(self, path: Path, file: TextIO) -> None:
        self.path, self.file = path, file

    @classmethod
    def open(cls, store: Path, name: str) -> Self | None:
        """The log of a run that begins now, logs/TIME-NAME.log in the store; None where none can be written."""
        folder = store / FOLDER
        stamp = f"{time.strftime('%Y-%m-%d-%H%M%S')}-{name}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path = folder / f"{stamp}.log"
            if path.exists():  # two runs in a second
                path = folder / f"{stamp}-{os.getpid()}.log"
            log = cls(path, path.open("a", encoding="utf-8", errors="backslashreplace"))
        except OSError:
            return None
        _make_room(folder)
        return log

    def write(self, text: str) -> None:
        """Lines, each with the time of day."""
        now = time.strftime("%H:%M:%S")
        with suppress(OSError, ValueError):  # ValueError: a thread still speaks after the end
            self.file.write("".join(f"{now}  {line}\n" for line in printable(text).split("\n")))
            self.file.flush()

    def close(self) -> None:
        """Nothing follows."""
        with suppress(OSError):
            self.file.close()


def _make_room(folder: Path) -> None:
    """Remove the oldest logs beyond KEPT; whatever has another name is not npred's."""
    with suppress(OSError):
        for path in sorted(path for path in folder.iterdir() if _NAME.fullmatch(path.name))[:-KEPT]:
            path.unlink(missing_ok=True)
