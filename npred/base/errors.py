"""Every failure a user can meet, each with its exit code; messages say what was expected, what came, what to do."""

import errno
import os
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_WORDS = ("No space left on device", "Disk quota exceeded", "File too large")  # messages without a number


class NpredError(Exception):
    """A failure in one line: what was expected, what came, what to do. The base is a stage that failed."""

    exit_code = 1

    def _render_traceback_(self) -> list[str]:
        """The text for IPython: the lines of the caller. `%debug` has the frames of npred too."""
        inside = (str(Path(__file__).parents[1]), f"{os.sep}IPython{os.sep}")
        frames = [f for f in traceback.extract_tb(self.__traceback__) if not any(part in f.filename for part in inside)]
        return [*map(str.rstrip, traceback.format_list(frames)), f"{type(self).__name__}: {self}"]


class ConfigError(NpredError, ValueError):
    """Usage or configuration: an unknown key, a wrong type, a value out of range, a plant file that does not load."""

    exit_code = 2


class UnmetError(NpredError):
    """The answer is no: an unmet gate, `status --check` with something stale, a recording without a pipeline."""

    exit_code = 3


class StoreError(NpredError):
    """The store is locked or corrupt; the message names the file."""

    exit_code = 4


class MissingError(NpredError):
    """This machine lacks something: an extra, a device, a compiler, a folder that compiled code is safe in."""

    exit_code = 5


class DivergedError(NpredError):
    """A rollout, a predictor or a training overflowed."""


EXTRAS = {  # the packages that a small installation lacks, by the extra that has them
    "torch": "train", "onnx": "onnx", "onnxruntime": "onnx", "onnxscript": "onnx", "scipy": "experiments",
    "pandas": "identify",
    "mcap": "mcap", "rosbags": "rosbag", "pyulog": "ulog", "pyarrow": "parquet", "python_calamine": "excel",
}  # fmt: skip


def imported(what: str, module: str, extra: str = "") -> ModuleType:
    """A module of npred that may need one of EXTRAS. Raises MissingError, after `what` needs it, without that.

    `extra` is the one that has all that the module needs, where it is another than the package's.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise missing(what, error, extra) or error from None


def missing(what: str, error: ModuleNotFoundError, extra: str = "") -> MissingError | None:
    """The same failure in one line, with its cure; None where the module is none of EXTRAS."""
    package = (error.name or "").partition(".")[0]
    return lacking(what, package, extra or EXTRAS[package]) if package in EXTRAS else None


def installed(module: str) -> bool:
    """True if a module could be imported; it is not."""
    try:
        return find_spec(module) is not None
    except (ModuleNotFoundError, ValueError):
        return False


def required(what: str, module: str, package: str, extra: str) -> ModuleType:
    """A module of an optional package, imported now. Raises MissingError, after `what` needs it, without it."""
    try:
        return import_module(module)
    except ImportError:
        raise lacking(what, package, extra) from None


def lacking(what: str, package: str, extra: str) -> MissingError:
    """The failure of `what`, which needs a package that is not installed."""
    return MissingError(f"{what}: expected the package {package}, found none; pip install 'npred[{extra}]'")


@contextmanager
def room_on_disk(root: Path) -> Iterator[None]:
    """Raise NpredError, one line, where the disk below `root` is full, whichever library met it."""
    try:
        yield
    except Exception as error:
        if disk_is_full(error):
            todo = "free some (npred gc says what is not needed) and run again: finished results stay"
            raise NpredError(f"{root}: expected room to write, got a full disk; {todo}") from error
        raise


def disk_is_full(error: BaseException | None) -> bool:
    """Whether an error or its cause is a full disk; not where it was raised `from None`: then it says of which disk."""
    if error is None:
        return False
    numbered = isinstance(error, OSError) and error.errno in _FULL
    before = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    return numbered or any(word in str(error) for word in _WORDS) or disk_is_full(before)


def bytes_text(count: float) -> str:
    """A number of bytes in words: 9.6 PB."""
    units = ("B", "kB", "MB", "GB", "TB", "PB")
    power = min(max(len(f"{count:.0f}") - 1, 0) // 3, len(units) - 1)
    return f"{count / 1000**power:.3g} {units[power]}"


def unlisted(
    what: str, name: object, names: Iterable[str], kind: str = "one of", todo: str = "name one of them"
) -> str:
    """The message of a name that is not in a list: the names in it, and the closest one, else the cure."""
    names = list(names)
    if not names:
        return f"{what}: expected no name, for there is none to choose, got {name!r}; leave it out"
    near = similar(str(name), names) or f"; {todo}"
    return f"{what}: expected {kind} {', '.join(names)}, got {name!r}{near}"


def similar(name: str, names: Iterable[str]) -> str:
    """`; did you mean …?` with the name that comes closest, in any case; nothing where none comes close."""
    from difflib import get_close_matches

    cased = {each.casefold().lstrip("-"): each for each in names}
    close = [cased[each] for each in get_close_matches(name.casefold().lstrip("-"), cased, n=2)]
    return f"; did you mean {' or '.join(close)}?" if close else ""


def first_line(of: object, otherwise: str = "") -> str:
    """The first line with a word of an error's message, or of a text; where it has none, `otherwise` or its type."""
    return (str(of).strip().splitlines() or [otherwise or type(of).__name__])[0]
