"""Files made to outlive a loss of power, and a full disk in one line."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from npred.errors import NpredError
from npred.json_files import sync

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_WORDS = ("No space left on device", "Disk quota exceeded", "File too large")  # of libraries that drop the number


def make(folder: Path) -> None:
    """A folder and those above it; a new name is made durable in the folder that holds it."""
    if not folder.is_dir():
        make(folder.parent)
        folder.mkdir(exist_ok=True)
        sync(folder.parent)


@contextmanager
def room(root: Path) -> Iterator[None]:
    """Raise NpredError, one line, where the disk below `root` is full, whichever library met it."""
    try:
        yield
    except Exception as error:
        if is_full(error):
            todo = "free some, npred gc says what is not needed, and run again: what is finished is kept"
            raise NpredError(f"{root}: expected room to write, got a full disk; {todo}") from error
        raise


def is_full(error: BaseException | None) -> bool:
    """Whether an error, or what it came from, is a full disk or a quota used up; not where it was raised `from None`,
    for then it says of which disk it is.
    """
    if error is None:
        return False
    numbered = isinstance(error, OSError) and error.errno in _FULL
    before = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    return numbered or any(word in str(error) for word in _WORDS) or is_full(before)
