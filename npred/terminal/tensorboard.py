"""The epochs of trainings as TensorBoard's event files."""

import json
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from npred.errors import required


class Events:
    """Writes one folder per training: loss, held-out errors and learning rate by epoch.

    Event files hold times and host names, so they are no part of a result. Raises MissingError without TensorBoard.
    """

    def __init__(self, folder: Path) -> None:
        module = required("--tensorboard", "torch.utils.tensorboard", "tensorboard", "tensorboard")
        self.folder, self.writer, self.open, self.lock = folder, module.SummaryWriter, {}, threading.Lock()

    def write(self, title: str, values: Mapping[str, float]) -> None:
        """The values of one epoch, `epoch` among them."""
        with self.lock:  # two networks may be in training
            writer: Any = self.open.get(title) or self.writer(str(self.folder / title.replace(" ", "-")))
            self.open[title] = writer
        for name, value in values.items():
            if name != "epoch":
                writer.add_scalar(name, value, values["epoch"])

    def replay(self, title: str, path: Path) -> None:
        """The epochs of a training that the store had, from its metrics.jsonl."""
        for line in path.read_text(encoding="utf-8").splitlines():
            self.write(title, json.loads(line))

    def close(self) -> None:
        """Everything to the disk."""
        for writer in self.open.values():
            writer.close()
