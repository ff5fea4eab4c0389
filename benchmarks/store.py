"""What the store's operations cost with 10 to 10 000 results in it, and the slope of each.

    python benchmarks/store.py [--most 10000] [--folder DIR] [-o docs/figures]

Results of two small files each. `put` is the time of the results added since the last row, a result; the others are
whole commands over the store, in process. A slope of 1 is a cost in proportion to the number of results.
"""

import argparse
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from npred.cli import app
from npred.console import columns
from npred.errors import NpredError
from npred.stages import drawing
from npred.store import Question, Store, archive

REPEATS = 3
COMMANDS = {
    "ls": ("ls", "--json"),
    "verify": ("verify", "--json"),
    "gc, the plan": ("gc", "{p}", "--json"),
    "status": ("status", "{p}", "--json"),
}


def put(store: Store, first: int, last: int) -> float:
    """Seconds to make these results, each synced and renamed into place."""
    start = time.perf_counter()
    for number in range(first, last):
        asked = Question(stage="train", version=1, model="fno", config={"seed": number}, inputs={})
        with store.lock("train", asked.key), store.draft("train", asked.key) as draft:
            (draft / "data.bin").write_bytes(bytes(1024))
            (draft / "result.json").write_text("{}")
            store.commit(draft, asked, "store")
    return time.perf_counter() - start


def best(call: Callable[[], object]) -> float:
    """The shortest of some times."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def command(arguments: tuple[str, ...], store: Store, pipeline: Path) -> None:
    """A command of npred in this process."""
    words = [word.format(p=pipeline) for word in arguments]
    done = CliRunner().invoke(app, [*words, "--store", str(store.root), "-q"])
    if done.exit_code:
        raise NpredError(done.output)


def there_and_back(store: Store, folder: Path) -> None:
    """One result through a tar into another store."""
    archive.export(store.get("train", _key(0)) or store.artifacts()[0], folder / "a.tar")
    shutil.rmtree(folder / "other", ignore_errors=True)
    archive.load(Store(folder / "other"), folder / "a.tar")


def _key(number: int) -> str:
    return Question(stage="train", version=1, model="fno", config={"seed": number}, inputs={}).key


def measure(folder: Path, sizes: list[int]) -> dict[str, list[float]]:
    """Seconds by operation, one a size."""
    store, pipeline = Store(folder / "store"), folder / "p.toml"
    pipeline.write_text('plant = "scalar"\n[evaluate]\nX0 = [0.5]\n')
    times: dict[str, list[float]] = {"put, all of them": []}
    spent, before = 0.0, 0
    for size in sizes:
        spent += put(store, before, size)
        before = size
        times["put, all of them"].append(spent)
        for name, arguments in COMMANDS.items():
            times.setdefault(name, []).append(best(lambda words=arguments: command(words, store, pipeline)))
        times.setdefault("get one", []).append(best(lambda: store.get("train", _key(0))))
        times.setdefault("one as a tar and back", []).append(best(lambda: there_and_back(store, folder)))
    return times


def slope(sizes: list[int], times: list[float]) -> float:
    """Of the logarithms, over the larger sizes: below, what a command costs by itself is what counts."""
    last = slice(-2, None)
    return float(np.polyfit(np.log(sizes[last]), np.log(times[last]), 1)[0])


def draw(folder: Path, sizes: list[int], times: dict[str, list[float]]) -> None:
    """store.svg and store.png."""
    figure = drawing.figure(6.4, 4.4)
    axis = figure.subplots()
    for number, (name, seconds) in enumerate(times.items()):
        style = {"color": drawing.COLOURS[number], "marker": "o", "markersize": 3}
        axis.loglog(sizes, seconds, label=f"{name}: slope {slope(sizes, seconds):.2f}", **style)
    axis.set(xlabel="results in the store", ylabel="seconds")
    axis.legend(frameon=False, fontsize=8)
    drawing.save(figure, folder, "store")


def main() -> None:
    """The table; with -o the figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--most", type=int, default=10_000)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("-o", "--output", type=Path)
    asked = parser.parse_args()
    sizes = [size for size in (10, 100, 1000, 10_000, 100_000) if size <= asked.most]
    folder = Path(tempfile.mkdtemp(dir=asked.folder))
    try:
        times = measure(folder, sizes)
    finally:
        shutil.rmtree(folder)
    rows = [[name, *(f"{t:.4f}" for t in row), f"{slope(sizes, row):.2f}"] for name, row in times.items()]
    print(columns(["seconds with", *map(str, sizes), "slope"], rows))
    if asked.output:
        draw(asked.output, sizes, times)


if __name__ == "__main__":
    main()
