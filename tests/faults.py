"""Runs that are killed, disks that fill, processes that want the same: the store stays whole and nothing is done twice.

    python tests/faults.py [RUNS] [SEED]

Each run is `npred run` of a tiny pipeline with the real stages, a process forked from one that has imported all that
it needs. Killed (-9) at a random instant of a random stage, it must leave whole results and no lock, and the same
command must end with the digests of a run that nobody disturbed. A disk that fills: the store is on a tmpfs (which
takes the right to mount) of ever more bytes. Exit 1 where one of these fails.
"""

import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import matplotlib.figure
import torch

from npred.cli import main as npred
from npred.lab.stages.bench import bench
from npred.lab.stages.evaluate import evaluate
from npred.lab.stages.generate import generate
from npred.lab.stages.train import train
from npred.lab.store import Artifact, Store

WARM = (h5py, matplotlib, torch, bench, evaluate, generate, train)
SIZES = (40, 100, 200, 300, 400, 500, 700)  # KiB of the disks that are too small
PROCESSES = 8
TIMED = ("bench", "report")
CHAIN = 4  # runs of one store that are killed one after the other
PIPELINE = """
plant = "scalar"
[generate]
samples = 200
rollouts = 10
t_end = 4.0
dt = 0.01
nx = 21
bounds = [0.05, 4.0]
[train.deeponet]
epochs = 12
batch = 64
width = 8
depth = 1
basis = 4
checkpoint_every = 2
[train.fno]
epochs = 8
batch = 64
width = 4
modes = 3
layers = 1
checkpoint_every = 2
[evaluate]
X0 = [0.5]
t_end = 2.0
case_t_end = 3.0
dt = 0.01
nx = 21
case_states = 2
case_D_hat = [0.8, 1.2]
[bench]
dx = [0.1]
calls = 12
batches = [1]
runtimes = ["torch"]
"""


class Run:
    """`npred run` in a folder, as a process of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        descriptor, name = tempfile.mkstemp(dir=folder.parent)
        self.told, self.answer = Path(name), Path(name + ".json")
        sys.stdout.flush()
        self.pid = os.fork()
        if not self.pid:
            self._be(descriptor)
        os.close(descriptor)

    def _be(self, descriptor: int) -> None:
        os.setpgid(0, 0)
        os.chdir(self.folder.parent)
        os.dup2(os.open(self.answer, os.O_CREAT | os.O_WRONLY), 1)
        os.dup2(descriptor, 2)
        sys.argv = ["npred", "run", "p.toml", "--json", "--jobs", "1", "--store", str(self.folder)]
        code = 70
        try:
            npred()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        finally:
            with contextlib.suppress(BaseException):
                sys.stdout.flush()
            os._exit(code)

    def wait(self) -> int:
        """The exit code; minus the signal that ended it."""
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])

    def ended(self) -> bool:
        """Whether it ended by itself."""
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None

    def kill(self) -> int:
        """-9 now."""
        os.kill(self.pid, signal.SIGKILL)
        return self.wait()

    def reaches(self, title: str) -> bool:
        """Wait until a stage is under way; False where the run ended before."""
        while not self.ended():
            if f"{title}: running" in self.told.read_text():
                return True
            time.sleep(0.001)
        return False

    @property
    def stages(self) -> list[dict[str, Any]]:
        """The rows of its answer."""
        return json.loads(self.answer.read_text())["stages"]


def digests(store: Store) -> dict[str, str]:
    """What the results hold, each verified; those of bench are times, which differ, and so does what tells of them."""
    whole = [artifact.verify().manifest for artifact in store.artifacts()]
    names = {m.key: " ".join(filter(None, (m.question.stage, m.question.model))) for m in whole}
    return {names[m.key]: "" if m.question.stage in TIMED else f"{m.key} {m.digest}" for m in whole}


def faults(store: Store) -> list[str]:
    """What a run that was killed must not leave: half a result, or a lock that somebody holds."""
    found = [f"half a result: {folder}" for folder in store.survey()[1]]
    for path in (store.root / ".locks").glob("*.lock"):
        stage, _, key = path.stem.partition("-")
        with contextlib.suppress(Exception), store.lock(stage, key):
            continue
        found.append(f"orphaned lock: {path}")
    return found + [str(error) for artifact in store.artifacts() if (error := unsound(artifact))]


def unsound(artifact: Artifact) -> Exception | None:
    """What is wrong with a result."""
    try:
        artifact.verify()
    except Exception as error:
        return error
    return None


def continued(store: Store, wanted: dict[str, str]) -> list[str]:
    """What is wrong after the same command ran again."""
    run = Run(store.root)
    if (code := run.wait()) != 0:
        return [f"exit {code}: {run.told.read_text().splitlines()[-1:]}"]
    found = [] if digests(store) == wanted else ["other digests"]
    found += [f"left: {path}" for path in store.leftovers()]
    return found + [f"left: {path}" for path in (store.root / ".locks").glob("*.holder")]


def killed(root: Path, runs: int, seed: int, wanted: dict[str, str], times: dict[str, float]) -> list[str]:
    """The campaign; prints how many runs were killed in which stage and continued to the same digests.

    A run that goes on after one that was killed may be killed as well, in a stage that was not finished, up to CHAIN in
    a row; the last goes on to the end.
    """
    rng, wrong, hit = random.Random(seed), [], Counter[str]()
    while hit.total() < runs:
        with folder(root) as path:
            before, found = hit.total(), []
            for _ in range(min(CHAIN, runs - before)):
                title = rng.choice(left(Store(path), times))
                if not interrupted(path, title, rng.uniform(0, 1.1 * times[title])):
                    break
                hit[title] += 1
                found += [f"killed in {title}: {what}" for what in faults(Store(path))]
            found += continued(Store(path), wanted)
            wrong += [found[0]] * (hit.total() - before) if found else []  # none of this chain counts
    where = ", ".join(f"{count} in {title}" for title, count in sorted(hit.items()))
    print(f"killed -9: {hit.total() - len(wrong)} of {hit.total()} continued to the same digests ({where})")
    return wrong


def interrupted(path: Path, title: str, seconds: float) -> bool:
    """Kill a run so long after it began a stage; False where it was faster."""
    run = Run(path)
    reached = run.reaches(title)
    time.sleep(seconds)
    if not reached or run.ended():
        run.wait()
        return False
    run.kill()
    return True


def left(store: Store, times: dict[str, float]) -> list[str]:
    """The stages, by title, that have no result yet; all of them where every one has."""
    asked = [artifact.manifest.question for artifact in store.artifacts()]
    done = {" ".join(filter(None, (question.stage, question.model))) for question in asked}
    return [title for title in times if title not in done] or list(times)


def filled(root: Path, wanted: dict[str, str], sizes: tuple[int, ...]) -> list[str]:
    """Disks that are too small: exit 1, one line that says so, whole results; with room the same command goes on."""
    wrong, told = [], Counter[str]()
    for size in sizes:
        with folder(root) as path:
            path.mkdir()
            if not mounted(path, size):
                print("a disk that fills: not tried, mounting takes more rights")
                return []
            try:
                run = Run(path)
                code, last = run.wait(), run.told.read_text().splitlines()[-1]
                told[f"exit {code}"] += 1
                if code != 1 or "got a full disk" not in last:
                    wrong.append(f"a disk of {size} KiB: exit {code}: {last}")
                wrong += [f"a disk of {size} KiB: {what}" for what in faults(Store(path))]
                subprocess.run(["mount", "-o", "remount,size=64m", path], check=True)
                wrong += [f"a disk of {size} KiB, then more: {what}" for what in continued(Store(path), wanted)]
            finally:
                subprocess.run(["umount", path], check=True)
    print(
        f"a disk that fills: {dict(told)} for {sizes} KiB; {len(sizes) - len(wrong)} of {len(sizes)} went on with room"
    )
    return wrong


def mounted(path: Path, size: int) -> bool:
    """A tmpfs of so many KiB."""
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", path]
    return subprocess.run(command, capture_output=True).returncode == 0


def at_once(root: Path, wanted: dict[str, str]) -> list[str]:
    """Processes that want the same results: each is made once."""
    with folder(root) as path:
        runs = [Run(path) for _ in range(PROCESSES)]
        codes = [run.wait() for run in runs]
        if any(codes):
            return [f"at once: exit codes {codes}"]
        made = Counter(row["key"] for run in runs for row in run.stages if row["action"] == "run")
        print(f"{PROCESSES} processes, one store: {made.total()} stages run for {len(made)} results")
        wrong = [f"made {count} times: {key}" for key, count in made.items() if count != 1]
        return wrong + faults(Store(path)) + ([] if digests(Store(path)) == wanted else ["at once: other digests"])


@contextlib.contextmanager
def folder(root: Path) -> Iterator[Path]:
    """A place for a store beside the pipeline, emptied afterwards."""
    place = Path(tempfile.mkdtemp(dir=root))
    (place / "p.toml").write_text(PIPELINE)
    try:
        yield place / "store"
    finally:
        shutil.rmtree(place)


def undisturbed(root: Path) -> tuple[dict[str, str], dict[str, float]]:
    """The digests of a run that nobody disturbs, and the seconds of its stages; the second such run, compiled."""
    with folder(root) as path:
        Run(path).wait()
    with folder(root) as path:
        run = Run(path)
        if run.wait() != 0:
            sys.exit(run.told.read_text())
        times = {" ".join(filter(None, (row["stage"], row.get("model")))): row["seconds"] for row in run.stages}
        return digests(Store(path)), times


def main(runs: int = 200, seed: int = 0, quick: bool = False) -> int:
    """All three, or with one disk and no crowd; 1 where something went wrong."""
    root = Path(tempfile.mkdtemp())
    try:
        wanted, times = undisturbed(root)
        print(f"undisturbed: {len(wanted)} results in {sum(times.values()):.1f} s", flush=True)
        wrong = filled(root, wanted, SIZES[3:4] if quick else SIZES)
        wrong += [] if quick else at_once(root, wanted)
        wrong += killed(root, runs, seed, wanted, times)
    finally:
        shutil.rmtree(root)
    print(*wrong[:20], sep="\n", file=sys.stderr)
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
