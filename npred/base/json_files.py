"""Small files from anywhere: read only if regular and no longer than they should be, parsed without surprises; digests
of files, and what makes them outlive a loss of power.
"""

import errno
import hashlib
import json
import math
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

LIMIT = 16 * 2**20  # bytes; the largest that npred writes, the manifest of thousands of shards, has a few


def read(path: Path, limit: int = LIMIT) -> bytes:
    """A regular file's bytes. Raises OSError, and ValueError for a link, device or pipe, or more than `limit` bytes."""
    status = os.lstat(path)
    if not stat.S_ISREG(status.st_mode):
        raise ValueError("a link, a folder or a device")
    if status.st_size > limit:
        raise ValueError(f"{status.st_size} bytes, more than {limit}")
    with open(path, "rb", buffering=0) as file:  # one call reads a regular file to its end
        return file.read(min(limit, status.st_size + 1))  # a buffer of `limit` would take longer than the reading


def sha256(path: Path) -> str:
    """The sha256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sync(path: Path) -> None:
    """Make a file's bytes, or a folder's names, outlive a loss of power. Raises OSError."""
    posix = hasattr(os, "O_DIRECTORY")  # Windows opens no folder, and syncs what it may write to
    if not posix and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDONLY if posix else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """A folder and those above it; a new name is made durable in the folder that holds it."""
    if not folder.is_dir():
        make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        sync(folder.parent)


def regular(path: Path) -> Path:
    """The path, if it leads to a file. Raises OSError for a pipe or a device, which might be read without an end."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "a pipe, a device or a folder", str(path))
    return path


def parse(content: bytes | str) -> Any:
    """The value of a JSON text. Raises ValueError, also for nesting and numbers that Python cannot hold."""
    try:
        return json.loads(content)
    except RecursionError:
        raise ValueError("JSON nested too deeply") from None


def escaped(value: Any) -> Any:
    """A JSON value whose texts a terminal shows as they are, on one line: escape sequences and line ends spelt out."""

    def spelt_out(leaf: Any) -> Any:
        if not isinstance(leaf, str) or leaf.isprintable():
            return leaf
        return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in leaf)

    return mapped(value, spelt_out)


def mapped(value: Any, change: Callable[[Any], Any]) -> Any:
    """Nested tables and lists with `change` of each key and of each leaf in its place."""
    if isinstance(value, dict):
        return {change(key): mapped(item, change) for key, item in value.items()}
    return [mapped(item, change) for item in value] if isinstance(value, list) else change(value)


def plain(value: Any) -> Any:
    """A value as JSON can hold it: NumPy numbers as numbers, a number that is not finite as null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def table(path: Path, limit: int = LIMIT) -> dict[str, Any]:
    """The JSON object in a file. Raises OSError and ValueError as `read` and `parse` do, and for any other value."""
    value = parse(read(path, limit))
    if not isinstance(value, dict):
        raise ValueError(f"a JSON {type(value).__name__}, no object")
    return value
