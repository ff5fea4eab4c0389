"""The log of a rig, a table of text that `npred identify` reads, and what it says of the loop.

A row is a call of the controller, or a sample that arrived, at the time when it was taken; cells that do not belong to
it are empty. The last line is a comment that says why the log ends.
"""

import csv
from pathlib import Path
from typing import Any, Self

import numpy as np

from npred.errors import ConfigError
from npred.loop import metrics
from npred.loop.controller import Controller
from npred.loop.status import Status
from npred.plants import Plant
from npred.rig.link import Packet

OVER = "the time is over"
END = "# end: "
#: of a call: D_hat and its spread, how old the used sample is, 1 where a new one came, was refused, where the watchdog
#: has U; how late the call was, how long it took
CALL = ("rig.D_hat", "rig.D_hat_spread", "rig.age", "rig.new", "rig.refused", "rig.handed_over", "rig.late", "rig.took")
#: of a sample: its number, its arrival, the means so far of the commands' delay and of the acting command's age
SAMPLE = ("rig.number", "rig.arrival", "rig.delay", "rig.acting")


class LogFile:
    """A log that is written: whole lines at once, so that a process that is killed leaves whole ones."""

    def __init__(self, path: Path, controller: Controller) -> None:
        plant = controller.plant
        self.file = path.open("w", encoding="utf-8", buffering=1)
        self.m, self.n = plant.m, len(controller.outputs)
        self._line(["t", *plant.inputs, *controller.outputs, *CALL, *SAMPLE])

    def call(self, t: float, U: np.ndarray, status: Status, new: bool, refused: bool, late: float, took: float) -> None:
        """Write a call; times in seconds."""
        flags = (int(new), int(refused), int(status.handed_over))
        values = (status.D_hat, status.D_hat_spread, status.age, *flags, late, took)
        self._line([t, *U, *[np.nan] * self.n, *values, *[np.nan] * len(SAMPLE)])

    def sample(self, packet: Packet) -> None:
        """Write a sample."""
        Y, means = packet.values[: self.n], packet.values[self.n :]
        before = [np.nan] * self.m
        self._line([packet.sent_at, *before, *Y, *[np.nan] * len(CALL), packet.number, packet.arrival, *means])

    def end(self, why: str) -> None:
        """Write why it ends."""
        self.file.write(f"{END}{why}\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.file.close()

    def _line(self, cells: list[Any]) -> None:
        written = [cell if isinstance(cell, str) else "" if np.isnan(cell) else f"{cell:.12g}" for cell in cells]
        self.file.write(",".join(written) + "\n")


class RigLog:
    """A log that is read: `calls` and `samples`, each a dictionary of columns, and why it ends, empty where it was
    cut. Raises ConfigError for a file that is none."""

    def __init__(self, path: Path, plant: Plant) -> None:
        lines = path.read_text(encoding="utf-8").splitlines()
        self.plant, self.path = plant, path
        self.why = lines[-1].removeprefix(END) if lines and lines[-1].startswith(END) else ""
        names, *rows = csv.reader(line for line in lines if not line.startswith("#"))
        if not set(CALL) <= set(names):
            raise ConfigError(f"{path}: expected the log of a rig, got other columns; write one with npred rig")
        table = np.array([[float(cell or "nan") for cell in row] for row in rows]).reshape(-1, len(names))
        columns = dict(zip(names, table.T, strict=True))
        called, sampled = np.isfinite(columns["rig.late"]), np.isfinite(columns["rig.number"])
        self.calls = {name: column[called] for name, column in columns.items()}
        self.samples = {name: column[sampled] for name, column in columns.items()}

    def X(self) -> np.ndarray:
        """The samples (N, n) of the states. Raises ConfigError where others were measured."""
        return np.stack([self.samples[name] for name in self.plant.states], axis=-1)

    def distance(self) -> np.ndarray:
        """|X - X*| of each sample."""
        return np.linalg.norm(self.X() - self.plant.target(self.samples["t"]), axis=-1)

    def summary(self, dt: float) -> dict[str, Any]:
        """What it says of a loop with that control step; times in seconds where no name says µs."""
        calls, samples = self.calls, self.samples
        number, waits = samples["rig.number"], samples["rig.arrival"] - samples["t"]
        far, late, took = self.distance(), calls["rig.late"], calls["rig.took"]
        spaces = np.round(np.diff(calls["t"] - late) / dt)
        return {
            "seconds": float(calls["t"][-1]), "calls": len(late), "end": self.why,
            "D_hat": float(calls["rig.D_hat"][-1]), "D_hat_spread": _number(calls["rig.D_hat_spread"][-1]),
            "delay": _number(samples["rig.delay"][-1]), "acting": _number(samples["rig.acting"][-1] - dt / 2),
            "without_sample": float(1 - calls["rig.new"].mean()), "refused": int(calls["rig.refused"].sum()),
            "handed_over": float(calls["rig.handed_over"].mean()),
            "samples": len(number), "samples_late": float(waits.mean()),
            "samples_lost": int(number.max() + 1 - len(number)),
            "samples_reordered": int((number < np.maximum.accumulate(number)).sum()),
            "late_p999_us": 1e6 * float(np.quantile(late, 0.999)), "late_max_us": 1e6 * float(late.max()),
            "took_median_us": 1e6 * float(np.median(took)), "took_p999_us": 1e6 * float(np.quantile(took, 0.999)),
            "took_max_us": 1e6 * float(took.max()), "skipped": int((spaces - 1).sum()),
            "radius": float(far[samples["t"] >= (1 - metrics.TAIL) * samples["t"].max()].max()),
        }  # fmt: skip


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
