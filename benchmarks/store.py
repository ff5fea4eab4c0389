"""What the store's operations cost with 10 to 10 000 results in it, and the slope of each.

    python benchmarks/store.py [--most 10000] [--folder DIR] [--output docs/figures]

Results of two small files each; all but `put` and `get` are whole commands over the store, in
process. Processor seconds, so that what else the machine does is not measured; the wall clock of `put` is a row of its
own, for it waits for the disk. A slope of 1 is a cost in proportion to the number of results.
"""

import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import harness
import numpy as np

from npred.lab.report.figures.figure import Figure, LegendEntry, Panel, write
from npred.lab.report.figures.style import MEDIA, LineStyle, log
from npred.lab.report.terminal.console import columns
from npred.lab.store import Question, Store

REPEATS = 3
ROLE = ("ink", "muted", "blue", "orange", "green", "frozen", "sky")
COMMANDS = {
    "ls": ("ls", "--json"),
    "verify": ("verify", "--json"),
    "gc, the plan": ("gc", "{p}", "--json"),
    "status": ("status", "{p}", "--json"),
}


def put(store: Store, first: int, last: int) -> np.ndarray:
    """Processor and wall seconds to make these results, each synced and renamed into place."""
    start = _clocks()
    for number in range(first, last):
        asked = Question(stage="train", version=1, model="fno", config={"seed": number}, inputs={})
        with store.lock("train", asked.key), store.draft("train", asked.key) as draft:
            (draft / "data.bin").write_bytes(bytes(1024))
            (draft / "result.json").write_text("{}")
            store.commit(draft, asked, "store")
    return _clocks() - start


def _clocks() -> np.ndarray:
    return np.array([time.process_time(), time.perf_counter()])


def best(call: Callable[[], object]) -> float:
    """The shortest of some times."""
    return min(harness.seconds(call, time.process_time)[0] for _ in range(REPEATS))


def command(arguments: tuple[str, ...], store: Store, pipeline: Path) -> None:
    """A command of npred in this process."""
    words = [word.format(p=pipeline) for word in arguments]
    harness.command_line(*words, "--store", str(store.root), "-q")


def _key(number: int) -> str:
    return Question(stage="train", version=1, model="fno", config={"seed": number}, inputs={}).key


def measure(folder: Path, sizes: list[int]) -> dict[str, list[float]]:
    """Seconds by operation, one a size."""
    store, pipeline = Store(folder / "store"), folder / "p.toml"
    pipeline.write_text('plant = "scalar"\n[evaluate]\nX0 = [0.5]\n')
    times: dict[str, list[float]] = {"put all": [], "put all, wall clock": []}
    spent, before = np.zeros(2), 0
    for size in sizes:
        spent += put(store, before, size)
        before = size
        for name, seconds in zip(list(times)[:2], spent.tolist(), strict=True):
            times[name].append(seconds)
        for name, arguments in COMMANDS.items():
            times.setdefault(name, []).append(best(lambda words=arguments: command(words, store, pipeline)))
        times.setdefault("get one", []).append(best(lambda: [store.get("train", _key(0)) for _ in range(100)]) / 100)
    return times


def slope(sizes: list[int], times: list[float]) -> float:
    """Of the logarithms, over the larger sizes: below, what a command costs by itself is what counts."""
    last = slice(-2, None)
    return float(np.polyfit(np.log(sizes[last]), np.log(times[last]), 1)[0])


def draw(folder: Path, sizes: list[int], times: dict[str, list[float]]) -> None:
    """store.svg and store.png."""

    looks = [LineStyle(role, marker="o") for role in ROLE]

    def lines(axis: Any) -> None:
        for look, seconds in zip(looks, times.values(), strict=True):
            axis.plot(sizes, seconds, **look.line)
        axis.set_xlabel("results in the store")
        log(axis, "x", "y")

    panel = Panel(
        "seconds, and slopes", "Seconds by the number of results: straight lines of slope 1, or level.", lines
    )
    caption = "What the store's operations cost with ever more results in it."
    labels = [f"{name}: {slope(sizes, seconds):.2f}" for name, seconds in times.items()]
    keys = tuple(map(LegendEntry, labels, looks))
    write(Figure("store", "The store", caption, (panel,), keys), folder, MEDIA["page"])


if __name__ == "__main__":
    asked = harness.options(__doc__, most=10_000, folder=Path, output=Path)
    sizes = [size for size in (10, 100, 1000, 10_000, 100_000) if size <= asked.most]
    folder = Path(tempfile.mkdtemp(dir=asked.folder))
    try:
        times = measure(folder, sizes)
    finally:
        shutil.rmtree(folder)
    rows = [[name, *(f"{t:.3g}" for t in row), f"{slope(sizes, row):.2f}"] for name, row in times.items()]
    print(columns(["processor seconds with", *map(str, sizes), "slope"], rows))
    if asked.output:
        draw(asked.output, sizes, times)
