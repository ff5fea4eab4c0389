"""Compiled code on the disk: written aside, sealed with digests, renamed into place, verified before it is run.

A compiled file is code. So it lies where only its owner can write, and one that is not as it was written is compiled
again: a flipped bit in a constant would give other numbers without a word.
"""

import errno
import json
import os
import shutil
import tempfile
from functools import cache
from pathlib import Path

from npred.base import json_files
from npred.base.errors import MissingError, NpredError, disk_is_full

VARIABLE, HOME = "NPRED_CACHE", "XDG_CACHE_HOME"
SEAL = "digests.json"


def full(error: OSError, folder: Path) -> NpredError | None:
    """The failure in words where the disk of the cache is full, else None."""
    if not disk_is_full(error):
        return None
    todo = f"free some, or name a folder on another disk in {VARIABLE}"
    return NpredError(f"{folder}: expected room for compiled code, got a full disk; {todo}")


def folder() -> Path:
    """The folder of compiled code: $NPRED_CACHE, else the user's cache, else a temporary folder; none but the owner may
    enter it.

    Raises MissingError for a relative path, and for a folder that others can write to: no fault of a plant; NpredError
    for a full disk.
    """
    home = _absolute(HOME) or Path(os.path.expanduser("~/.cache"))
    chosen = (_absolute(VARIABLE) or home / "npred") / "kernels"
    if not chosen.is_absolute():  # there is no home
        return _temporary()
    try:
        if not chosen.parent.exists():  # who could write to it could replace kernels by another folder
            chosen.parent.mkdir(parents=True, exist_ok=True)
            chosen.parent.chmod(0o700)
        chosen.mkdir(mode=0o700, exist_ok=True)
        _private(chosen)
        tempfile.TemporaryFile(dir=chosen).close()
        return chosen
    except OSError as error:
        if error := full(error, chosen):
            raise error from None
        return _temporary()


root = cache(folder)  # the folder of this process, checked once


def _absolute(variable: str) -> Path | None:
    """The folder that an environment variable names; an empty one is unset."""
    text = os.environ.get(variable, "")
    if text and not os.path.isabs(text):
        raise MissingError(f"{variable}: expected an absolute path, got {text!r}; begin it with /")
    return Path(text) if text else None


def _private(folder: Path) -> None:
    """Keep others out. Raises MissingError where they could write, OSError where this user cannot."""
    if not hasattr(os, "geteuid"):  # Windows, where a profile is its user's by its access list
        return
    status = folder.stat()
    if status.st_uid == os.geteuid() and not status.st_mode & 0o022:
        if status.st_mode & 0o777 != 0o700:
            folder.chmod(0o700)
    elif not os.access(folder, os.W_OK):
        raise PermissionError(errno.EACCES, "cannot be written", str(folder))
    else:
        what = f"{folder}: expected a folder that only you can write to, for the code in it is run"
        cure = f"remove it (all is compiled again) or name another in {VARIABLE}"
        raise MissingError(f"{what}, got mode {status.st_mode & 0o777:o} of user {status.st_uid}; {cure}")


def _temporary() -> Path:
    """A folder for this process and those that it starts, removed at its end."""
    from multiprocessing.util import Finalize  # runs at the end of pools' processes too, where atexit does not

    try:
        home = Path(tempfile.mkdtemp(prefix="npred-"))
    except OSError as error:
        cure = f"name one that can be written in {VARIABLE}"
        raise MissingError(f"{VARIABLE}: expected a folder for compiled code, got: {error.strerror}; {cure}") from None
    os.environ[VARIABLE] = str(home)
    Finalize(None, shutil.rmtree, (home, True), exitpriority=0)
    (home / "kernels").mkdir(mode=0o700)
    return home / "kernels"


def aside() -> Path:
    """A new folder beside the kernels, to write one in. Raises NpredError for a full disk."""
    try:
        return Path(tempfile.mkdtemp(dir=root(), prefix=".new-"))
    except OSError as error:
        raise full(error, root()) or error from None


def sound(target: Path) -> bool:
    """True if every sealed file is unchanged."""
    try:
        sealed = json.loads((target / SEAL).read_bytes())
        return all(json_files.sha256(target / name) == digest for name, digest in sealed.items())
    except (OSError, ValueError, AttributeError):
        return False


def install(folder: Path, target: Path) -> None:
    """Seal a compiled file, make it durable and rename it into place, where another process may have been faster."""
    files = [Path(here, name) for here, _, names in os.walk(folder) for name in names]
    digests = {str(path.relative_to(folder)): json_files.sha256(path) for path in files}
    (folder / SEAL).write_text(json.dumps(digests), encoding="utf-8")
    for path in [*files, folder / SEAL, folder]:
        json_files.sync(path)
    if target.exists() and not sound(target):
        broken = Path(tempfile.mkdtemp(dir=target.parent, prefix=".old-"))
        target.rename(broken / target.name)
        shutil.rmtree(broken, ignore_errors=True)
    if not target.exists():
        try:
            folder.rename(target)
        except FileExistsError:
            return
        except OSError as error:
            if error.errno != errno.ENOTEMPTY:
                raise
        json_files.sync(target.parent)
