"""What runs at work take from a store: gc leaves it alone, though no lock is held on what is only read."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from filelock import FileLock, Timeout

from npred.errors import NpredError
from npred.store import locks

Claim = Callable[[str], None]


@contextmanager
def claimed(root: Path) -> Iterator[Claim]:
    """A call with a key claims it until the block ends, or this process does.

    A store that cannot be written takes no claims, and nobody deletes from it either.
    """
    in_use(root)  # takes away what a process that was killed left
    path = root / ".locks" / f"run-{uuid4().hex}.lock"
    with ExitStack() as stack:
        try:
            stack.callback(path.unlink, missing_ok=True)
            stack.enter_context(locks.held(path))
            stack.callback(_keys(path).unlink, missing_ok=True)
            file = stack.enter_context(_keys(path).open("ab", buffering=0))
        except (OSError, NpredError):  # read-only, or full: what has to be written will say so
            with suppress(OSError):
                stack.close()
            yield lambda key: None
            return

        def claim(key: str) -> None:
            with suppress(OSError):
                file.write(f"{key}\n".encode("ascii"))

        yield claim


def in_use(root: Path) -> set[str]:
    """The keys that runs at work have claimed; the claims of processes that have ended are removed."""
    found: set[str] = set()
    for path in root.glob(".locks/run-*.lock"):
        lock = FileLock(path, fallback_to_soft=False)
        try:
            with lock.acquire(timeout=0):
                for left in (_keys(path), path.with_suffix(".holder"), path):
                    left.unlink(missing_ok=True)
        except Timeout:
            found |= _read(_keys(path))
        except OSError:  # a store that cannot be written, or one that has just gone
            continue
    return found


def _keys(path: Path) -> Path:
    return path.with_suffix(".keys")


def _read(path: Path) -> set[str]:
    try:
        return set(path.read_text(encoding="ascii").split())
    except FileNotFoundError:
        return set()
