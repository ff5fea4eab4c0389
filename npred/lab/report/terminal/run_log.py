"""What a run writes for later: its log, a text file in the store's folder with its messages and each epoch of a
training, and on request the epochs as TensorBoard's event files.
"""

import json
import os
import re
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Self, TextIO

from npred.base.errors import required
from npred.lab.report.terminal.streams import printable

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

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
        with suppress(OSError):  # the oldest beyond KEPT go; a file with another name is not npred's
            for path in sorted(path for path in folder.iterdir() if _NAME.fullmatch(path.name))[:-KEPT]:
                path.unlink(missing_ok=True)
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
        """Everything to the disk."""
        for writer in self.writers.values():
            writer.close()
