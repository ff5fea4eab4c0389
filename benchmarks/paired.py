"""What became slower or faster since a commit: operations of both, interleaved in one run on one core each.

    python benchmarks/paired.py BASE [--rounds 15] [--only WORDS]

A worktree of the commit BASE is made beside this one, and each compiles into a cache of its own. Each is driven by its
own benchmarks/driver.py, which knows its names; a base without one by its own paired.py, which had the operations, and
without either by the driver of this tree. Operations are the same where they have the same name. Per round both trees
run each operation in turn, in an order that alternates; a row is the median time of each, the median of the ratios of
the rounds, and the range of their middle half. A ratio above 1.05 whose middle half is above 1 is marked. An operation
that a tree lacks prints "–", and stderr says why. Those that take a process (a cold start) run in few rounds. Run it
alone on the machine.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import harness
import numpy as np
from driver import operations

SLOWER = 1.05  # a ratio above it is marked
FEW, LONG = 5, 0.5  # rounds of an operation that takes longer, s


class Tree:
    """A process that works for one tree, with a separate cache."""

    def __init__(self, tree: Path, cache: Path) -> None:
        cache.mkdir()
        environment = os.environ | {"PYTHONPATH": str(tree), "NPRED_CACHE": str(cache), "OMP_NUM_THREADS": "1"}
        text = "import npred; print(npred.__file__)"
        found = subprocess.run(
            [sys.executable, "-c", text], cwd=cache, env=environment, stdout=subprocess.PIPE, text=True
        )
        assert Path(found.stdout).is_relative_to(tree), f"expected npred of {tree}, got {found.stdout}"
        own, former = tree / "benchmarks" / "driver.py", tree / "benchmarks" / "paired.py"
        words = [str(own)] if own.exists() else [str(former), "--work", str(tree)]
        if not own.exists() and not former.exists():
            words = [str(Path(__file__).with_name("driver.py"))]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self.process = subprocess.Popen([sys.executable, *words], cwd=cache, env=environment, text=True, **pipes)

    def seconds(self, name: str) -> float | None:
        """Those of one call."""
        assert self.process.stdin is not None and self.process.stdout is not None
        print(name, file=self.process.stdin, flush=True)
        return json.loads(self.process.stdout.readline() or sys.exit("a tree's driver ended"))


def rows(trees: list[Tree], rounds: int, only: str) -> Iterator[tuple[str, ...]]:
    """The rows of the table: base, here, the ratio and the range of its middle half."""
    for name in filter(lambda name: only in name, operations()):
        first = [tree.seconds(name) for tree in trees]
        if None in first:
            yield name, *("–" if s is None else f"{1e6 * s:.2f}" for s in first), "–", "–", ""
            continue
        takers = [partial(tree.seconds, name) for tree in trees]
        base, here = harness.in_turn(takers, FEW if max(first) > LONG else rounds)
        ratio, (low, high) = np.median(here / base), np.quantile(here / base, (0.25, 0.75))
        times = [f"{1e6 * np.median(times):.2f}" for times in (base, here)]
        yield name, *times, f"{ratio:.2f}", f"{low:.2f} to {high:.2f}", "slower" if ratio > SLOWER and low > 1 else ""


if __name__ == "__main__":
    asked = harness.options(__doc__, {"base": "HEAD~1"}, rounds=15, only="")
    with harness.worktree(asked.base) as base:
        trees = [Tree(tree, base.with_name(name)) for tree, name in ((base, "before"), (harness.ROOT, "now"))]
        harness.head("µs", asked.base, "here", "ratio", "its middle half", "")
        for cells in rows(trees, asked.rounds, asked.only):
            harness.row(*cells)
        for tree in trees:
            tree.process.kill()
