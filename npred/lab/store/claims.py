"""Who is at work in a store: one lock per key, held by the process that makes the result, and the claims of runs on the
results that they read. gc leaves those alone, though no lock is held on what is only read.
"""

import json
import os
import platform
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from filelock import FileLock, Timeout

from npred.base import json_files
from npred.base.errors import NpredError, StoreError, disk_is_full, room_on_disk

Claim = Callable[[str], None]
ATTEMPTS = 100  # each is lost only if another process looks at the claims in the microseconds between two calls
_CLAIM = re.compile(r"run-[0-9a-f]{32}\.lock")


class HeldError(StoreError):
    """Another process holds the lock."""


@contextmanager
def held(path: Path, waiting: Callable[[str], None] | None = None) -> Iterator[None]:
    """Hold the lock file; the kernel frees it when the process dies, kill -9 included.

    A lock held elsewhere is waited for after one call of `waiting(holder)`; without `waiting` it is a StoreError.
    So is a store that cannot be written or whose file system has no locks.
    """
    # No lock file that merely exists: where flock is missing it would outlive a killed process and stop all others.
    lock, note = FileLock(path, fallback_to_soft=False), path.with_suffix(".holder")
    try:
        with room_on_disk(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            lock.acquire(timeout=0)
    except Timeout:
        if waiting is None:
            raise HeldError(f"{path}: expected a free lock, got one held by {_holder(note)}; wait for it") from None
        waiting(_holder(note))
        lock.acquire()
    except OSError as error:
        raise StoreError(
            f"{path}: expected a store that can be written and locked, got: {error.strerror}; choose another --store"
        ) from None
    try:
        try:  # to write for people who holds the lock; on a full disk nobody can, and the lock holds all the same
            note.write_text(json.dumps({"pid": os.getpid(), "host": platform.node()}), encoding="utf-8")
        except OSError as error:
            if not disk_is_full(error):
                raise
        yield
    finally:
        note.unlink(missing_ok=True)
        lock.release()


def _holder(note: Path) -> str:
    """The process that holds a lock, in words."""
    try:
        who = json_files.table(note, limit=1024)
        return f"process {who['pid']} on {who['host']}"
    except (OSError, ValueError, KeyError):  # the holder is between taking the lock and signing it, or has just left
        return "another process"


@contextmanager
def claimed(root: Path) -> Iterator[Claim]:
    """A call with a key claims it until the block ends, or the process; nobody deletes from a store without claims."""
    in_use(root)  # takes away what a process that was killed left
    with ExitStack() as stack:
        try:
            file = stack.enter_context(_opened(root))
        except (OSError, NpredError):  # read-only, or full: what has to be written will say so
            yield lambda key: None
            return

        def claim(key: str) -> None:
            with suppress(OSError):
                file.write(f"{key}\n".encode("ascii"))

        yield claim


@contextmanager
def _opened(root: Path) -> Iterator[BinaryIO]:
    """The file of a new claim, under a lock that `in_use` of other processes sees.

    Between its opening and its lock, another process may lock and remove a lock file, for nobody seems to hold it. Then
    the claim is made again under another name, so that no name ever has a second file. Raises OSError and NpredError.
    """
    for _ in range(ATTEMPTS):
        path = root / ".locks" / f"run-{uuid4().hex}.lock"
        with ExitStack() as stack:
            try:
                stack.callback(_remove, path)
                stack.enter_context(held(path))
            except HeldError:  # by the process that is about to remove it
                continue
            if not path.exists():  # removed before it was locked
                continue
            stack.callback(_remove, _keys(path))
            yield stack.enter_context(_keys(path).open("ab", buffering=0))
            return
    raise StoreError(f"{root}: expected to claim a key, failed {ATTEMPTS} times; run again")


def in_use(root: Path) -> set[str]:
    """The keys that runs at work have claimed; the claims of processes that have ended are removed."""
    keys: set[str] = set()
    for path in root.glob(".locks/run-*.lock"):
        if not _CLAIM.fullmatch(path.name):
            continue
        lock = FileLock(path, fallback_to_soft=False)
        try:
            with lock.acquire(timeout=0):
                for left in (_keys(path), path.with_suffix(".holder"), path):
                    left.unlink(missing_ok=True)
        except Timeout:
            with suppress(FileNotFoundError):
                keys.update(_keys(path).read_text(encoding="ascii").split())
        except OSError:  # a store that cannot be written, or one that has just gone
            continue
    return keys


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink(missing_ok=True)


def _keys(path: Path) -> Path:
    return path.with_suffix(".keys")
