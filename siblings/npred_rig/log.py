"""The log of a rig, a table of text that `npred identify` reads, its words about the loop, and a figure of it.

A row is a call of the controller, or a sample that arrived, at the time when it was taken; cells that do not belong to
it are empty. The last line is a comment that says why the log ends.
"""

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from npred.lab.report.figures.figure import Figure, LegendEntry, Panel, curves
from npred.lab.report.figures.style import LineStyle
from npred.loop import metrics
from npred.loop.controller import Controller
from npred.loop.settable import Piece, targets
from npred.plants import Plant
from npred.plants.notation import quantity, timed

OVER = "the time is over"
END = "# end: "
TAIL = 4096  # bytes of the log's end that the live view reads
#: columns of a call: D_hat and its spread, how old the used sample is, samples refused so far, 1 where the watchdog has
#: U; how late the call was, how long it took
CALL = ("rig.D_hat", "rig.D_hat_spread", "rig.age", "rig.refused", "rig.handed_over", "rig.late", "rig.took")
#: columns of a sample: its number, its arrival, and the delay by the stamps of the commands, its mean so far
SAMPLE = ("rig.number", "rig.arrival", "rig.delay")


def truth(plant: Plant) -> tuple[str, ...]:
    """The columns of the simulated plant's states when a sample was taken, which the controller does not get."""
    return tuple(f"rig.X.{name}" for name in plant.states)


class LogFile:
    """A log that is written: whole lines at once, so that a process that is killed leaves whole ones."""

    def __init__(self, path: Path, controller: Controller) -> None:
        self.file = path.open("w", encoding="utf-8", buffering=1)
        self.names = ("t", *controller.plant.inputs, *controller.outputs, *CALL, *SAMPLE, *truth(controller.plant))
        self.file.write(",".join(self.names) + "\n")

    def row(self, t: float, names: Sequence[str], values: Sequence[float] | np.ndarray) -> None:
        """Write the columns of these names, in seconds and the plant's units; NaN as an empty cell."""
        cells = dict(zip(names, values, strict=True), t=t)
        text = ("" if np.isnan(x := cells.get(name, np.nan)) else f"{x:.12g}" for name in self.names)
        self.file.write(",".join(text) + "\n")

    def end(self, why: str) -> None:
        """Write why it ends."""
        self.file.write(f"{END}{why}\n")


class RigLog(NamedTuple):
    """A log that is read: columns by name, of the calls and of the samples; why it ends, empty where it was cut."""

    calls: dict[str, np.ndarray]
    samples: dict[str, np.ndarray]
    why: str


def read(path: Path) -> RigLog:
    """The log in a file."""
    with path.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
    (last,) = deque(path.open(encoding="utf-8"), maxlen=1)
    table = np.loadtxt(path, delimiter=",", skiprows=1, converters=lambda cell: float(cell or "nan"), ndmin=2)
    columns = dict(zip(names, table.T, strict=True))
    called, why = np.isfinite(columns["rig.late"]), last.removeprefix(END).strip() if last.startswith(END) else ""
    calls, samples = ({name: column[rows] for name, column in columns.items()} for rows in (called, ~called))
    return RigLog(calls, samples, why)


def distance(plant: Plant, course: list[Piece], samples: dict[str, np.ndarray]) -> np.ndarray:
    """|X - X*| of the plant at each sample, X* of the set-point of its time; infinity if a state is not finite."""
    order, goals = np.argsort(samples["t"]), np.empty((len(samples["t"]), plant.n))
    goals[order] = targets(plant, course, samples["t"][order])[0]
    gap = np.stack([samples[name] for name in truth(plant)], axis=-1) - goals
    return np.nan_to_num(np.linalg.norm(gap, axis=-1), nan=np.inf, posinf=np.inf)


def summary(plant: Plant, course: list[Piece], log: RigLog, dt: float) -> dict[str, Any]:
    """The numbers of a loop with that control step; times in seconds where no name says µs."""
    calls, samples = log.calls, log.samples
    number, late, far = samples["rig.number"], calls["rig.late"], distance(plant, course, samples)
    slots = np.round((calls["t"] - late) / dt)
    return {
        "D_hat": _number(calls["rig.D_hat"][-1]), "D_hat_spread": _number(calls["rig.D_hat_spread"][-1]),
        "delay": _number(samples["rig.delay"][-1]),
        "seconds": float(calls["t"][-1]), "calls": len(late), "skipped": int((np.diff(slots) - 1).sum()),
        "without_sample": float(np.mean(np.diff(calls["t"] - calls["rig.age"]) < dt / 1000)),
        "refused": int(calls["rig.refused"][-1]), "handed_over": float(calls["rig.handed_over"].mean()),
        "samples": len(number), "samples_lost": int(number.max() + 1 - len(number)),
        "samples_late": float((samples["rig.arrival"] - samples["t"]).mean()),
        "samples_reordered": int((number < np.maximum.accumulate(number)).sum()),
        "radius": _number(far[samples["t"] >= (1 - metrics.TAIL) * samples["t"].max()].max()),
        **micro("late", late), **micro("took", calls["rig.took"]),
    }  # fmt: skip


def last_row(path: Path) -> str:
    """The last call in a log that grows, in a line; empty before there is one."""
    if not path.exists():
        return ""
    with path.open("rb") as file:
        names = file.readline().decode().strip().split(",")
        file.seek(max(file.tell(), file.seek(0, 2) - TAIL))
        rows = [dict(zip(names, line.split(","), strict=False)) for line in file.read().decode().split("\n")[:-1]]
    last = next((row for row in reversed(rows) if row.get("rig.late")), {})
    return ", ".join(f"{name.removeprefix('rig.')} {float(cell):.4g}" for name, cell in last.items() if cell)


def figure(plant: Plant, name: str, log: RigLog) -> Figure:
    """Samples, commands, the delay estimate and how old the samples are; `name` is that of its file."""
    calls, order = log.calls, np.argsort(log.samples["t"])
    samples = {column: values[order] for column, values in log.samples.items()}
    t, time, line, stamps = calls["t"], timed(plant, "t"), LineStyle("blue", width=1.0), LineStyle("ink", (4, 2))
    panels = []
    for x in dict.fromkeys([*plant.outputs, *plant.states]):
        if x in samples:
            drawn = curves([(line, samples["t"], samples[x])], time)
            panels.append(Panel(quantity(plant, x), f"{x} as measured.", drawn))
    for U in plant.inputs:
        panels.append(Panel(quantity(plant, U), f"The commands {U}.", curves([(line, t, calls[U])], time)))
    estimate, delay, age = calls["rig.D_hat"], samples["rig.delay"], calls["rig.age"]
    alt = f"D_hat ends at {estimate[-1]:.4g}, the stamps say {delay[-1]:.4g}."
    both = curves([(LineStyle("blue"), t, estimate), (stamps, samples["t"], delay)], time)
    panels.append(Panel(f"delay estimate {quantity(plant, 'D_hat')}", alt, both))
    alt = f"In the middle {np.median(age):.3g}, at most {age.max():.3g}."
    panels.append(Panel(timed(plant, "age of the sample"), alt, curves([(line, t, age)], time)))
    caption = "A loop on a real clock: the samples that arrived, the commands, D̂ and the delay that the stamps say."
    keys = [
        LegendEntry("D̂ of the controller", LineStyle("blue")),
        LegendEntry("delay by the stamps, its mean so far", stamps),
    ]
    return Figure(name, "The rig", caption, panels, keys)


def micro(name: str, seconds: np.ndarray) -> dict[str, float]:
    """Median, 99.9 % quantile and the largest one, in µs."""
    quantiles = 1e6 * np.quantile(seconds, (0.5, 0.999, 1))
    return {f"{name}_{of}_us": float(value) for of, value in zip(("median", "p999", "max"), quantiles, strict=True)}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
