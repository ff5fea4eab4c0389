"""One lock per key, held by one process at a time, which leaves its name beside it."""

import json
import os
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from npred import json_files
from npred.errors import StoreError
from npred.store import durable


class HeldError(StoreError):
    """Another process holds the lock."""


@contextmanager
def held(path: Path, waiting: Callable[[str], None] | None = None) -> Iterator[None]:
    """Hold the lock file; the kernel frees it when the process dies, kill -9 included.

    A lock held elsewhere is waited for after one call of `waiting(holder)`; without `waiting` it is a StoreError.
    So is a store that cannot be written or whose file system has no locks.
    """
    lock = _acquire(path, waiting)
    try:
        _sign(_note(path))
        yield
    finally:
        _note(path).unlink(missing_ok=True)
        lock.release()


def holder(path: Path) -> str:
    """The process that holds the lock, in words."""
    try:
        who = json_files.table(_note(path), limit=1024)
        return f"process {who['pid']} on {who['host']}"
    except (OSError, ValueError, KeyError):  # the holder is between taking the lock and signing it, or has just left
        return "another process"


def _sign(note: Path) -> None:
    """Write who holds the lock, for people; on a full disk nobody can, and the lock holds all the same."""
    try:
        note.write_text(json.dumps({"pid": os.getpid(), "host": platform.node()}))
    except OSError as error:
        if not durable.is_full(error):
            raise


def _acquire(path: Path, waiting: Callable[[str], None] | None) -> FileLock:
    # No lock file that merely exists: where flock is missing it would outlive a killed process and stop all others.
    lock = FileLock(path, fallback_to_soft=False)
    try:
        with durable.room(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            lock.acquire(timeout=0)
    except Timeout:
        if waiting is None:
            raise HeldError(f"{path}: expected a free lock, got one held by {holder(path)}; wait for it") from None
        waiting(holder(path))
        lock.acquire()
    except OSError as error:
        raise StoreError(
            f"{path}: expected a store that can be written and locked, got: {error.strerror}; choose another --store"
        ) from None
    return lock


def _note(path: Path) -> Path:
    return path.with_suffix(".holder")
