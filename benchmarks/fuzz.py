"""Mutated pipelines, manifests, HDF5 and safetensors files: each is refused in one line, or it is as good as new.

    python benchmarks/fuzz.py [--cases 10000] [--seed 0]

A case is wrong if its loader raises anything but NpredError, takes over 10 s, ends the process (a crash of a C library,
or memory beyond 1 GiB), or takes what it must refuse: bytes that their digest does not cover. Exit 1 with any of those.
"""

import argparse
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import traceback
from collections import Counter
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

from fuzz_kinds import Target, Wrong, targets

from npred.base.errors import NpredError
from npred.lab.report.terminal.console import columns

SECONDS = 10
MEMORY = 2**30
BATCH = 100
FINE = ("refused", "sound", "taken")
BAD = ("traceback", "hang", "wrong", "crash")


@dataclass
class Batch:
    """Some cases of one kind, each with a seed of its own."""

    name: str
    target: Target
    seed: int
    first: int
    last: int

    def run(self, pipe: Connection) -> None:
        """In a process of its own: the number of each case before it begins, and what became of it."""
        signal.signal(signal.SIGALRM, _late)
        resource.setrlimit(resource.RLIMIT_AS, (_memory() + MEMORY, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        for number in range(self.first, self.last):
            pipe.send((number, None, ""))
            pipe.send((number, *self.case(number)))

    def content(self, number: int) -> tuple[bytes, bytes]:
        """A sound file, and what was made of it."""
        rng = random.Random(f"{self.seed} {self.name} {number}")
        sound = rng.choice(self.target.files)
        return sound, self.target.change(rng, sound)

    def case(self, number: int) -> tuple[str, str]:
        """The outcome in a word, and what was told."""
        sound, changed = self.content(number)
        folder = Path(tempfile.mkdtemp(dir="/dev/shm" if os.path.isdir("/dev/shm") else None))
        signal.alarm(SECONDS)
        try:
            same = self.target.load(folder, changed)
            return ("taken" if changed == sound or same else "sound"), ""
        except NpredError as error:
            return ("refused", "") if "\n" not in str(error) else ("traceback", f"two lines: {error}")
        except Late:
            return "hang", ""
        except Wrong as error:
            return "wrong", str(error)
        except BaseException as error:
            last = traceback.extract_tb(error.__traceback__)[-3:]
            where = " < ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in reversed(last))
            return "traceback", f"{type(error).__name__}: {error}"[:200] + f" at {where}"
        finally:
            signal.alarm(0)
            shutil.rmtree(folder, ignore_errors=True)


class Late(BaseException):
    """Time is up; no OSError, as TimeoutError is, for a loader may catch those."""


def _late(number: int, frame: object) -> None:
    raise Late


def _memory() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0]) * os.sysconf("SC_PAGE_SIZE")


def campaign(name: str, target: Target, seed: int, cases: int) -> tuple[Counter[str], list[str]]:
    """What became of the cases, and what those said that were wrong."""
    counts, told, context = Counter[str](), list[str](), get_context("fork")
    first = 0
    while first < cases:
        ours, theirs = context.Pipe(duplex=False)
        batch = Batch(name, target, seed, first, min(first + BATCH, cases))
        process = context.Process(target=batch.run, args=(theirs,))
        process.start()
        theirs.close()
        first = _drain(ours, batch, counts, told)
        process.join()
    return counts, told


def _drain(pipe: Connection, batch: Batch, counts: Counter[str], told: list[str]) -> int:
    """The next case to run: the one after a crash, where there was one."""
    number, outcome = batch.first - 1, "begun"
    while number < batch.last - 1 or outcome is None:
        try:
            number, outcome, words = pipe.recv()
        except EOFError:
            outcome, words = "crash", "the process ended"
        if outcome is not None:
            counts[outcome] += 1
            told += [f"{batch.name} {number}: {outcome}: {words}"] if outcome not in FINE else []
        if outcome == "crash":
            break
    return number + 1


def main() -> None:
    """The table of all kinds."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    kinds, rows, total, told = targets(), [], Counter[str](), []
    for name, target in kinds.items():
        counts, words = campaign(name, target, asked.seed, -(-asked.cases // len(kinds)))
        rows.append([name, *(str(counts[key]) for key in ("refused", "sound", "taken", *BAD))])
        total += counts
        told += words
    rows.append(["all", *(str(total[key]) for key in ("refused", "sound", "taken", *BAD))])
    print(columns(["files", "refused", "still sound", "unchanged", *BAD], rows))
    print(*told[:40], sep="\n", file=sys.stderr)
    sys.exit(bool(sum(total[key] for key in BAD)))


if __name__ == "__main__":
    main()
