"""The kinds of files that benchmarks/fuzz.py mutates: sound ones, how they are changed, and what loads them."""

import json
import random
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from npred import plants
from npred.base.errors import NpredError, StoreError
from npred.lab import config
from npred.lab.config import FNO, DeepONet
from npred.lab.scheduler.plan import STAGES, Planner, nodes
from npred.lab.store import Artifact, Question, Store
from npred.lab.store.manifest import sha256
from npred.lab.training import operators
from npred.lab.training.data.dataset import MEANING, Dataset
from npred.networks.weights import read

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
