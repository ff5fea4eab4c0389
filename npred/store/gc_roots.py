"""The pipeline files that a store's results were made for, the roots of its garbage collection.

`<store>/.pipelines/<name>.json` holds the path of a file and the keys that its last runs asked for. It is kept beside
the results and not in them: what an artifact from elsewhere says must not make this machine read files or run code.
"""

import hashlib
import json
import os
import stat
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from npred import json_files

FOLDER = ".pipelines"
LIMIT = 2**20  # bytes of an entry


class GcRoot(NamedTuple):
    """A pipeline file that exists, what it last asked for, and whether this user ran it: then it may be read again."""

    file: Path
    keys: frozenset[str]
    by_this_user: bool


def register(root: Path, pipeline: Path, keys: Mapping[str, str]) -> None:
    """Remember a pipeline file, and by the names of its nodes the keys that it asked for; other names keep theirs.

    A pipeline that came through a pipe has no file to remember, and a store that cannot be written remembers none.
    """
    file = pipeline.resolve()
    if not file.is_file():
        return
    name = hashlib.sha256(f"{_user()} {file}".encode(errors="surrogateescape")).hexdigest()[:32]
    entry = root / FOLDER / f"{name}.json"
    aside = entry.with_suffix(f".{os.getpid()}")
    text = json.dumps({"file": str(file), "keys": _keys(_read(entry)) | dict(keys)}, indent=1)
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


def registered(root: Path) -> list[GcRoot]:
    """The pipelines of a store whose files exist; an entry that cannot be read is none."""
    entries = {path: _read(path) for path in sorted((root / FOLDER).glob("*.json"))}
    return [
        GcRoot(file, frozenset(_keys(entry).values()), path.lstat().st_uid == _user())
        for path, entry in entries.items()
        if "file" in entry and _exists(file := Path(str(entry["file"])))
    ]


def _read(entry: Path) -> dict[str, object]:
    try:
        return json_files.table(entry, LIMIT)
    except (OSError, ValueError):
        return {}


def _keys(entry: Mapping[str, object]) -> dict[str, str]:
    keys = entry.get("keys")
    return {str(name): str(key) for name, key in keys.items()} if isinstance(keys, dict) else {}


def _exists(file: Path) -> bool:
    """True if there is such a regular file; one that may not be looked at counts as there."""
    try:
        return stat.S_ISREG(file.stat().st_mode)
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return False
    except OSError:
        return True
