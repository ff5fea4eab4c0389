"""What a sample costs, from 10^4 to 10^7 of them: seconds, processor seconds and memory of data and of one epoch.

    python benchmarks/scale.py [SAMPLES ...] [--folder DIR] [--figures docs/figures]

Each size is made and trained on in a store of its own below DIR (6 GB for 10^7 samples), which is removed afterwards.
Memory is the largest sum, over all processes of a command, of resident bytes, taken five times a second; pages that two
processes share count twice. Exit 1 where it passes 4 GiB. Processor seconds are what another load leaves alone.
A straight line, start + slope N, is fitted to them from 10^5 samples on; the misfit says how straight they are.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import harness
import numpy as np

from npred.lab.report.figures.figure import Figure, LegendEntry, Panel, write
from npred.lab.report.figures.style import MEDIA, LineStyle, log

SIZES = (10_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000)
SHARE = 200  # samples a rollout
FIRST = 100_000  # samples from which on both processes have work, so that the cost may be a straight line
LIMIT = 4 * 2**30
PIPELINE = """
name = "scale"
plant = "activator_repressor"
[generate]
nx = 21
t_end = 20.0
dt = 0.01
[train]
models = ["deeponet"]
"""
COMMANDS = {"generate": "data", "train": "one epoch"}  # the second reads and verifies what the first made


@dataclass(frozen=True)
class Cost:
    """Of one command: wall and processor seconds, the most resident bytes, the bytes that it left in the store."""

    samples: int
    command: str
    wall: float
    processor: float
    resident: int
    stored: int

    def cells(self) -> list[str]:
        """Of a table."""
        seconds = f"{self.wall:.1f}", f"{self.processor:.1f}", f"{self.processor / self.samples * 1e6:.1f}"
        sizes = f"{self.resident / 2**30:.2f}", f"{self.stored / 1e9:.2f}"
        return [f"{self.samples:.0e}", COMMANDS[self.command], *seconds, *sizes]


def measure(samples: int, command: str, folder: Path, jobs: int) -> Cost:
    """Run one command of npred to its end."""
    sets = [f"generate.samples={samples}", f"generate.rollouts={samples // SHARE}", "train.deeponet.epochs=1"]
    words = [sys.executable, "-m", "npred", command, "scale.toml", "--store", "store", "--jobs", str(jobs), "-q"]
    words += [word for one in sets for word in ("--set", one)]
    before, start, most = os.times(), time.perf_counter(), 0
    running = subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL)
    while running.poll() is None:
        most = max(most, sum(map(resident, family(running.pid))))
        time.sleep(0.2)
    if running.returncode:
        sys.exit(f"npred {command} of {samples} samples ended with {running.returncode}")
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    stored = sum(path.stat().st_size for path in (folder / "store" / command).rglob("*") if path.is_file())
    return Cost(samples, command, time.perf_counter() - start, spent, most, stored)


def family(pid: int) -> list[int]:
    """A process and all that come from it."""
    found = [pid]
    for parent in found:
        for path in Path(f"/proc/{parent}/task").glob("*/children"):
            try:
                found += map(int, path.read_text().split())
            except OSError:  # it has just ended
                continue
    return found


def resident(pid: int) -> int:
    """The resident bytes of a process, 0 where it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text(encoding="utf-8").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


def line(costs: list[Cost]) -> tuple[float, float, float]:
    """Start in seconds and slope in seconds a sample, by least squares of relative errors; the largest of those."""
    N, seconds = np.array([(c.samples, c.processor) for c in costs if c.samples >= FIRST], dtype=float).T
    start, slope = np.linalg.lstsq(np.stack([1 / seconds, N / seconds], 1), np.ones(len(N)), rcond=None)[0]
    return start, slope, float(np.abs((start + slope * N) / seconds - 1).max())


def draw(costs: dict[str, list[Cost]], folder: Path) -> None:
    """Write scale.svg and scale.png: processor time a sample with the straight lines, and memory, against N."""
    looks = {command: LineStyle(role, marker="o") for command, role in zip(COMMANDS, ("blue", "orange"), strict=True)}

    def times(axis: Any) -> None:
        for command, row in costs.items():
            sizes, (start, slope, _) = np.array([cost.samples for cost in row]), line(row)
            fitted = sizes[sizes >= FIRST]
            axis.plot(sizes, [c.processor / c.samples * 1e6 for c in row], "o", color=looks[command].colour)
            axis.plot(fitted, (start / fitted + slope) * 1e6, color=looks[command].colour)
        axis.set_xlabel("samples")
        log(axis, "x", "y")

    def memory(axis: Any) -> None:
        for command, row in costs.items():
            axis.plot([c.samples for c in row], [c.resident / 2**30 for c in row], **looks[command].line)
        axis.set(xlabel="samples", ylim=(0, None))
        log(axis, "x")

    title = "Processor time a sample, µs; the lines are straight in N"
    panels = (
        Panel(title, "Processor microseconds a sample against samples.", times),
        Panel("Memory of all processes, GiB", "Gibibytes against samples.", memory),
    )
    keys = tuple(LegendEntry(COMMANDS[command], look) for command, look in looks.items())
    style = MEDIA["page"]
    write(Figure("scale", "What a sample costs", "From 10⁴ to 10⁷ samples.", panels, keys), folder, style)


if __name__ == "__main__":
    places = {"samples": [float(size) for size in SIZES]}
    asked = harness.options(__doc__, places, folder=Path, jobs=2, figures=Path("docs/figures"))
    if sum(samples >= FIRST for samples in asked.samples) < 3:
        sys.exit(f"expected at least three sizes from {FIRST:.0e} on, for the straight line")
    seconds = "seconds", "processor seconds", "µs a sample"
    harness.head("samples", "what", *seconds, "memory, GiB", "stored, GB")
    costs: dict[str, list[Cost]] = {command: [] for command in COMMANDS}
    for samples in map(int, (asked.samples[0], *asked.samples)):  # the first compiles, and is not kept
        folder = Path(tempfile.mkdtemp(dir=asked.folder))
        (folder / "scale.toml").write_text(PIPELINE)
        try:
            for command in COMMANDS:
                costs[command].append(measure(samples, command, folder, asked.jobs))
                harness.row(*costs[command][-1].cells())
        finally:
            shutil.rmtree(folder)
    costs = {command: row[1:] for command, row in costs.items()}
    for command, row in costs.items():
        start, slope, misfit = line(row)
        print(f"{COMMANDS[command]}: {start:.1f} s + {slope * 1e6:.2f} µs N, within {misfit:.0%} from {FIRST:.0e} on")
    draw(costs, asked.figures)
    most = max(cost.resident for row in costs.values() for cost in row)
    print(f"memory: {most / 2**30:.2f} GiB at most, of {LIMIT / 2**30:.0f}")
    sys.exit(most > LIMIT)
