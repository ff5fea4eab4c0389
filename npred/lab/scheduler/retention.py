"""Retention: gc keeps the results in a store that pipelines need, also where parts of it are missing or corrupt.

`<store>/.pipelines/<name>.json` holds the path of a pipeline file that results were made for, and the keys that its
last runs asked for. It is kept beside the results and not in them: what an artifact from elsewhere says must not make
this machine read files or run code.
"""

import hashlib
import json
import os
import stat
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from npred.base import json_files
from npred.base.errors import StoreError
from npred.lab.scheduler.plan import Node, Resolver, anywhere
from npred.lab.store import Artifact, Store

FOLDER = ".pipelines"
LIMIT = 2**20  # bytes of an entry


class GcRoot(NamedTuple):
    """A pipeline file that exists, the keys it asked for, and whether this user ran it: then it may be read again."""

    file: Path
    keys: frozenset[str]
    by_this_user: bool


def remember(store: Store, pipeline: Path, keys: Mapping[str, str] = {}) -> None:
    """Note that a run takes its pipeline from a file, and by the names of its nodes the keys that it asked for; other
    names keep theirs.

    A pipeline that came through a pipe has no file to remember, and a store that cannot be written remembers none.
    """
    store.adopt()
    file = pipeline.resolve()
    if not file.is_file():
        return
    name = hashlib.sha256(f"{_user()} {file}".encode(errors="surrogateescape")).hexdigest()[:32]
    entry = store.root / FOLDER / f"{name}.json"
    aside = entry.with_suffix(f".{os.getpid()}")
    text = json.dumps({"file": str(file), "keys": _read(entry)[1] | dict(keys)}, indent=1)
    with suppress(OSError):
        try:
            entry.parent.mkdir(parents=True, exist_ok=True)
            aside.write_text(text + "\n", encoding="utf-8", errors="surrogateescape")
            aside.replace(entry)
        finally:
            aside.unlink(missing_ok=True)


def _user() -> int:
    """The number of this user, by which files are owned; on Windows 0, as there of every file."""
    return os.geteuid() if hasattr(os, "geteuid") else 0


def remembered(store: Store) -> list[GcRoot]:
    """The pipelines of a store whose files exist; an entry that cannot be read is none."""
    roots = []
    for path in sorted((store.root / FOLDER).glob("*.json")):
        name, keys = _read(path)
        try:
            exists = stat.S_ISREG(Path(name).stat().st_mode)
        except (FileNotFoundError, NotADirectoryError, ValueError):
            continue
        except OSError:  # a file that may not be looked at counts as there
            exists = True
        if exists:
            roots.append(GcRoot(Path(name), frozenset(keys.values()), path.lstat().st_uid == _user()))
    return roots


def _read(entry: Path) -> tuple[str, dict[str, str]]:
    """The file of an entry, and the keys that it asked for; nothing of an entry that cannot be read."""
    try:
        table = json_files.table(entry, LIMIT)
    except (OSError, ValueError):
        return "", {}
    keys = table.get("keys")
    named = {str(name): str(key) for name, key in keys.items()} if isinstance(keys, dict) else {}
    return str(table.get("file", "")), named


@dataclass
class Kept:
    """Keys that are needed and, where an input is not there to tell the key, the settings of the result."""

    keys: set[str] = field(default_factory=set)
    timed: set[str] = field(default_factory=set)  # keys of what was asked of a machine, leaving the machine out
    loose: list[tuple[Node, dict[str, Any]]] = field(default_factory=list)

    def add(self, planner: Resolver, nodes: Iterable[Node]) -> None:
        """Keep the results that these nodes need, each after its inputs."""
        artifacts: dict[str, Artifact | None] = {}
        for node in nodes:
            artifacts[node.name] = None
            inputs = {name: artifact for name in node.inputs if (artifact := artifacts[name])}
            if len(inputs) < len(node.inputs):
                self.loose.append((node, planner.settings(node)))
                continue
            question = planner.question(node, inputs)
            self.keys.add(question.key)
            if key := anywhere(question):
                self.timed.add(key)
            with suppress(StoreError):  # that one is corrupt; what was made from it need not be
                artifacts[node.name] = planner.store.get(node.stage, question.key)

    def holds(self, artifact: Artifact) -> bool:
        """True if an artifact is needed, or may be."""
        asked = artifact.manifest.question
        alike = ((asked.stage, asked.model, asked.config) == (n.stage, n.model, config) for n, config in self.loose)
        return artifact.manifest.key in self.keys or anywhere(asked) in self.timed or any(alike)

    def holds_checkpoint(self, name: str) -> bool:
        """True if the checkpoint `stage-key` is one that a run would go on from, or may be."""
        stage, _, key = name.rpartition("-")
        return key in self.keys or any(node.stage == stage for node, _ in self.loose)


def closure(kept: Iterable[Artifact], everything: Iterable[Artifact]) -> set[str]:
    """The keys of the kept artifacts and of all that they were made from."""
    by_key = {artifact.manifest.key: artifact for artifact in everything}
    keys, todo = set(), [artifact.manifest.key for artifact in kept]
    while todo:
        key = todo.pop()
        if key not in keys:
            keys.add(key)
            todo += [source.key for source in by_key[key].manifest.question.inputs.values() if source.key in by_key]
    return keys
