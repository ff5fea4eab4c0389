"""Mutated pipelines, manifests, HDF5 and safetensors files: each is refused in one line, or it is as good as new.

    python tests/fuzz.py [CASES] [SEED]

A case is wrong if its loader raises anything but NpredError, takes over 10 s, ends the process (a crash of a C library,
or memory beyond 1 GiB), or takes what it must refuse: bytes that their digest does not cover. Exit 1 with any of those.
"""

import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from npred import plants
from npred.base.errors import NpredError, StoreError
from npred.lab import config
from npred.lab.config import FNO, DeepONet
from npred.lab.report.terminal.console import columns
from npred.lab.scheduler.plan import STAGES, Planner, nodes
from npred.lab.store import Artifact, Question, Store
from npred.lab.store.manifest import sha256
from npred.lab.training import operators
from npred.lab.training.data.dataset import MEANING, Dataset
from npred.networks.weights import read

SECONDS = 10
MEMORY = 2**30
BATCH = 100
FINE = ("refused", "sound", "taken")
BAD = ("traceback", "hang", "wrong", "crash")
PAYLOAD = b"payload" * 99
TOKENS = (
    "-1", "0", "1e999", "NaN", "null", "true", "[]", "{}", '"../../x"', '"x.py:X"', "9" * 30, "9" * 5000, "[" * 3000,
    '"\\ud800"', "1e-320", "-0.0", '"\\u0000"', "[[1, 2], [3]]", "{a = {a = 1}}", "1979-05-27", "\ufeff", "inf", "''",
)  # fmt: skip


class Target(NamedTuple):
    """A kind of file: the sound ones, how to change one, and what loads one; `load` says whether it was the same."""

    files: list[bytes]
    change: Callable[[random.Random, bytes], bytes]
    load: Callable[[Path, bytes], bool]


class Wrong(Exception):
    """A loader took what it should have refused."""


def flipped(rng: random.Random, content: bytes) -> bytes:
    """Some bytes changed, dropped, doubled, put in, or the rest cut off."""
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 5, 20))):
        at, length = rng.randrange(len(changed) + 1), rng.choice((1, 1, 2, 4, 8, 8, 64))
        new = rng.choice((rng.randbytes(length), b"\xff" * length, b"\0" * length, changed[at : at + length] * 2, b""))
        changed[at : at + rng.choice((length, length, len(new), 0))] = new
    return bytes(changed[: rng.randrange(len(changed) + 1)]) if rng.random() < 0.1 else bytes(changed)


def reworded(rng: random.Random, content: bytes) -> bytes:
    """A text with some of its words replaced; at times with its bytes changed instead."""
    if rng.random() < 0.3:
        return flipped(rng, content)
    words = content.decode().split(" ")
    for _ in range(rng.choice((1, 1, 2, 6))):
        words[rng.randrange(len(words))] = rng.choice((*TOKENS, rng.choice(words), ""))
    return " ".join(words).encode("utf-8", "surrogatepass")


def load_pipeline(folder: Path, content: bytes) -> bool:
    (folder / "p.toml").write_bytes(content)
    pipeline = config.load(folder / "p.toml")
    Planner(pipeline, Store(folder / "store"), "cpu").plan(nodes(pipeline, STAGES))
    return False


def artifact(folder: Path) -> Artifact:
    """A small sound result in a store of its own."""
    store, asked = Store(folder), Question(stage="train", version=1, model="fno", config={"a": [1, 2.5]}, inputs={})
    with store.draft("train", asked.key) as draft:
        (draft / "data.bin").write_bytes(PAYLOAD)
        (draft / "result.json").write_text('{"mse": 0.5, "deep": {"er": [1, 2]}}')
        return store.commit(draft, asked, "fuzz")


def load_manifest(folder: Path, content: bytes) -> bool:
    """As it is, and signed anew: a checksum is no secret."""
    sound = artifact(folder / "store")
    path = sound.folder / "manifest.json"
    same = _untimed(content) == _untimed(path.read_bytes())
    signed = _signed(content)
    path.write_bytes(content)
    if _verified(sound.folder) and not same:
        raise Wrong("a changed manifest was taken")
    if signed is not None:
        place = sound.folder.with_name(str(signed["key"])[:64].replace("/", "_").replace("\0", "_") or "_")
        sound.folder.rename(place)
        (place / "manifest.json").write_text(json.dumps(signed), encoding="utf-8", errors="surrogatepass")
        found = _verified(place)
        if found and {n: p.size for n, p in found.manifest.files.items()} != {"data.bin": 693, "result.json": 36}:
            raise Wrong("a manifest of other files was taken")
    if not same:
        raise StoreError("refused")
    return True


def json_or_none(content: bytes) -> Any:
    """The value, or None."""
    try:
        return json.loads(content)
    except (ValueError, RecursionError):
        return None


def _untimed(content: bytes) -> Any:
    """The value without when it was made, and the checksum that covers that."""
    value = json_or_none(content)
    if not isinstance(value, dict) or not isinstance(value.get("provenance"), dict):
        return value
    provenance = {name: item for name, item in value["provenance"].items() if name not in ("made", "seconds")}
    return {name: item for name, item in value.items() if name != "checksum"} | {"provenance": provenance}


def _verified(folder: Path) -> Artifact | None:
    try:
        return Artifact.read(folder).verify()
    except NpredError:
        return None


def _signed(content: bytes) -> dict[str, Any] | None:
    """A changed manifest with key, digest and checksum as they should be, where that can be done."""
    fields = json_or_none(content)
    try:
        fields.pop("checksum", None)
        fields["key"] = Question.model_validate(fields["question"]).key
        fields["digest"] = sha256(fields["files"])
        return fields | {"checksum": sha256(fields)}
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        return None


def load_payload(folder: Path, content: bytes) -> bool:
    """Bytes under a digest."""
    sound = artifact(folder / "store")
    (sound.folder / "data.bin").write_bytes(content)
    sound.verify()
    if content != PAYLOAD:
        raise Wrong("a changed payload was taken")
    return True


def load_hdf5(folder: Path, content: bytes) -> bool:
    (folder / "data.h5").write_bytes(content)
    data = Dataset.read(folder / "data.h5")
    if {len(getattr(data, name)) for name in MEANING} != {len(data)}:
        raise Wrong("arrays of different lengths were taken")
    return False


def load_weights(folder: Path, content: bytes) -> bool:
    """Both files of a model in one, the table first."""
    table, _, weights = content.partition(b"\n\0\n")
    (folder / "model.json").write_bytes(table)
    (folder / "model.safetensors").write_bytes(weights)
    found = read(folder, plants.resolve("scalar"))
    if sum(array.size for array in found.arrays.values()) * 4 > len(weights):
        raise Wrong("more weights than bytes")
    return False


def targets() -> dict[str, Target]:
    """Every kind with sound files of it."""
    folder = Path(tempfile.mkdtemp())
    here = Path(__file__).parent.parent / "pipeline"
    pipelines = [path.read_bytes() for path in sorted(here.glob("*.toml"))]
    sound = artifact(folder / "store")
    manifest = (sound.folder / "manifest.json").read_bytes()
    weights = [_model(folder / name, table) for name, table in _tables().items()]
    return {
        "pipelines": Target(pipelines, reworded, load_pipeline),
        "manifests": Target([manifest], reworded, load_manifest),
        "payloads": Target([PAYLOAD], flipped, load_payload),
        "hdf5": Target([_data(folder)], flipped, load_hdf5),
        "safetensors": Target(weights, _either, load_weights),
    }


def _tables() -> dict[str, DeepONet | FNO]:
    return {"d": DeepONet(width=4, depth=1, basis=3, trunk=4, moments=2), "f": FNO(width=3, modes=2, layers=1)}


def _either(rng: random.Random, content: bytes) -> bytes:
    table, mark, weights = content.partition(b"\n\0\n")
    return reworded(rng, table) + mark + weights if rng.random() < 0.5 else table + mark + flipped(rng, weights)


def _data(folder: Path) -> bytes:
    rng, shapes = np.random.default_rng(0), {"X": (6, 1), "u": (6, 5, 1), "P": (6, 5, 1)}
    arrays = {name: rng.normal(size=shapes.get(name, (6,))) for name in MEANING}
    arrays |= {"rollout": np.arange(6, dtype=np.int32), "test": (np.arange(6) > 3).astype(np.uint8)}
    Dataset(**arrays).write(folder / "data.h5", {"plant": "scalar"})
    return (folder / "data.h5").read_bytes()


def _model(folder: Path, table: DeepONet | FNO) -> bytes:
    folder.mkdir()
    plant = plants.resolve("scalar")
    torch.manual_seed(0)
    operators.save(folder, operators.build(table, plant, operators.Scaling(1, 1)), table)
    return (folder / "model.json").read_bytes() + b"\n\0\n" + (folder / "model.safetensors").read_bytes()


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


def main(cases: int = 10_000, seed: int = 0) -> int:
    """Print the table of all kinds; 1 where a case is wrong."""
    kinds, rows, total, told = targets(), [], Counter[str](), []
    for name, target in kinds.items():
        counts, words = campaign(name, target, seed, -(-cases // len(kinds)))
        rows.append([name, *(str(counts[key]) for key in ("refused", "sound", "taken", *BAD))])
        total += counts
        told += words
    rows.append(["all", *(str(total[key]) for key in ("refused", "sound", "taken", *BAD))])
    print(columns(["files", "refused", "still sound", "unchanged", *BAD], rows))
    print(*told[:40], sep="\n", file=sys.stderr)
    return int(bool(sum(total[key] for key in BAD)))


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
