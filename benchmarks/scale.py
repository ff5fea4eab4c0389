"""What a sample costs, from 10^4 to 10^7 of them: seconds, processor seconds and memory of data and of one epoch.

    python benchmarks/scale.py [SAMPLES ...] [--folder DIR] [--figure docs/figures/scale]

Each size is made and trained on in a store of its own below DIR (6 GB for 10^7 samples), which is removed afterwards.
Memory is the largest sum, over all processes of a command, of resident bytes, taken five times a second; pages that two
processes share count twice. Exit 1 where it passes 4 GiB. Processor seconds are what another load leaves alone.
The exponent is of what comes on top of the start, the cost of 400 samples.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SIZES = (10_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000)
SHARE = 200  # samples a rollout
START = 2 * SHARE  # samples whose cost is that of starting the command
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

    def line(self) -> str:
        """As a row of Markdown."""
        seconds = f"{self.wall:.1f} | {self.processor:.1f} | {self.processor / self.samples * 1e6:.1f}"
        sizes = f"{self.resident / 2**30:.2f} | {self.stored / 1e9:.2f}"
        return f"| {self.samples:.0e} | {COMMANDS[self.command]} | {seconds} | {sizes} |"


def measure(samples: int, command: str, folder: Path, jobs: int) -> Cost:
    """Run one command of npred to its end."""
    sets = [f"generate.samples={samples}", f"generate.rollouts={samples // SHARE}", "train.deeponet.epochs=1"]
    words = [sys.executable, "-m", "npred", command, "scale.toml", "--store", "store", "--jobs", str(jobs), "-q"]
    before, start, most = os.times(), time.perf_counter(), 0
    running = subprocess.Popen(
        [*words, *(w for s in sets for w in ("--set", s))], cwd=folder, stdout=subprocess.DEVNULL
    )
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
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


def slope(costs: list[Cost]) -> float:
    """The exponent of the cost less that of the start, least squares over sizes of 10^5 and more."""
    start, *rest = costs
    some = [cost for cost in rest if cost.samples >= 100_000]
    logs = np.log([[cost.samples, cost.processor - start.processor] for cost in some])
    return float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0]) if len(some) > 1 else np.nan


def draw(costs: dict[str, list[Cost]], path: Path) -> None:
    """Write the figure: processor microseconds a sample, and memory, against the number of samples."""
    from npred.stages import drawing

    figure = drawing.figure(7.2, 2.8)
    left, right = figure.subplots(1, 2)
    for colour, (command, row) in zip(drawing.COLOURS, costs.items(), strict=False):
        (start, *rest), what = row, COMMANDS[command]
        sizes = [cost.samples for cost in rest]
        label, more = f"{what}, start and all", f"{what}, on top of the start: ~ N^{slope(row):.2f}"
        left.loglog(sizes, [c.processor / c.samples * 1e6 for c in rest], "o:", color=colour, label=label)
        above = [(c.processor - start.processor) / c.samples * 1e6 for c in rest]
        left.loglog(sizes, above, "s-", color=colour, label=more)
        right.semilogx(sizes, [c.resident / 2**30 for c in rest], "o-", color=colour)
    left.set(xlabel="samples N", ylabel="processor time a sample, µs")
    right.set(xlabel="samples N", ylabel="memory of all processes, GiB", ylim=(0, None))
    right.axhline(LIMIT / 2**30, color="black", linewidth=0.8, linestyle=":")
    left.legend(frameon=False, fontsize=7)
    drawing.save(figure, path.parent, path.name)


def main() -> None:
    """Print a line a command as it ends, then the slopes; draw; judge the memory."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("samples", nargs="*", type=lambda text: int(float(text)), default=SIZES)
    parser.add_argument("--folder", type=Path, default=None)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--figure", type=Path, default=Path("docs/figures/scale"))
    asked = parser.parse_args()
    header = ("samples", "what", "seconds", "processor seconds", "µs a sample", "memory, GiB", "stored, GB")
    print("| " + " | ".join(header) + " |\n|" + "---|" * len(header), flush=True)
    costs: dict[str, list[Cost]] = {command: [] for command in COMMANDS}
    for samples in (START, START, *asked.samples):  # the first compiles, and is not kept
        folder = Path(tempfile.mkdtemp(dir=asked.folder))
        (folder / "scale.toml").write_text(PIPELINE)
        try:
            for command in COMMANDS:
                costs[command].append(measure(samples, command, folder, asked.jobs))
                print(costs[command][-1].line(), flush=True)
        finally:
            shutil.rmtree(folder)
    costs = {command: row[1:] for command, row in costs.items()}
    for command, row in costs.items():
        print(f"{COMMANDS[command]}: processor seconds on top of the start grow as N^{slope(row):.3f}")
    draw(costs, asked.figure)
    most = max(cost.resident for row in costs.values() for cost in row)
    print(f"memory: {most / 2**30:.2f} GiB at most, of {LIMIT / 2**30:.0f}")
    sys.exit(most > LIMIT)


if __name__ == "__main__":
    main()
