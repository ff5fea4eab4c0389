"""One lock a key, held by one process at a time; who holds it can be read beside it."""

import json
import os
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from npred.errors import StoreError


@contextmanager
def held(path: Path, waiting: Callable[[str], None] | None = None) -> Iterator[None]:
    """Hold the lock file; the kernel frees it when the process dies, kill -9 included.

    A lock held elsewhere is waited for after one call of `waiting(holder)`; without `waiting` it is a StoreError.
    """
    lock = _acquire(path, waiting)
    note = _note(path)
    note.write_text(json.dumps({"pid": os.getpid(), "host": platform.node()}))
    try:
        yield
    finally:
        note.unlink(missing_ok=True)
        lock.release()


def holder(path: Path) -> str:
    """Who holds the lock, in words."""
    try:
        who = json.loads(_note(path).read_text())
    except (OSError, ValueError):  # the holder is between taking the lock and signing it, or has just left
        return "another process"
    return f"process {who['pid']} on {who['host']}"


def _acquire(path: Path, waiting: Callable[[str], None] | None) -> FileLock:
    lock = FileLock(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout:
        if waiting is None:
            raise StoreError(f"{path}: expected a free lock, got one held by {holder(path)}; wait for it") from None
        waiting(holder(path))
        lock.acquire()
    except OSError as error:
        raise StoreError(f"{path}: expected a writable store, got: {error.strerror}; choose another --store") from None
    return lock


def _note(path: Path) -> Path:
    return path.with_suffix(".holder")
