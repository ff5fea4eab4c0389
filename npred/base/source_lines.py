"""File and line of code that a user wrote, and a failure of it in one line."""

import inspect
import linecache
import re
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # `npred --help` has no use for it
    import numpy as np


def line(function: Callable[..., Any]) -> str:
    """my_plant.py:12, where the function begins; "" for one that is not written in Python."""
    code = _code(function)
    return f"{Path(code.co_filename).name}:{code.co_firstlineno}" if code else ""


def where(error: BaseException, function: Callable[..., Any]) -> str:
    """ " at my_plant.py:12", the last line of the function's file that the failure went through; else ""."""
    code = _code(function)
    number = last_line(error, code.co_filename) if code else ""
    return f" at {Path(code.co_filename).name}{number}" if number else ""


def last_line(error: BaseException, file: str) -> str:
    """ ":12", the last line of that file that the failure went through; else ""."""
    theirs = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f":{theirs[-1]}" if theirs else ""


def failed(error: BaseException, function: Callable[..., Any]) -> str:
    """The rest of the last such line from where it failed, as it is written there: np.sin(x.h) + 1; else ""."""
    code = _code(function)
    frames = [f for f in traceback.extract_tb(error.__traceback__) if code and f.filename == code.co_filename]
    if not frames or frames[-1].lineno is None or frames[-1].colno is None:
        return ""
    return linecache.getline(frames[-1].filename, frames[-1].lineno).encode()[frames[-1].colno :].decode()


def called(error: BaseException, function: Callable[..., Any]) -> str:
    """The name of what it called there, as it is written: np.sin; else ""."""
    call = re.match(r"([\w.]+(\[[^]]*\])?)\(", failed(error, function))
    return call[1] if call else ""


def library(error: BaseException) -> str:
    """The package outside npred that the failure was raised in, where that is one that was installed; else ""."""
    frame = [*traceback.walk_tb(error.__traceback__)][-1][0]
    installed = "site-packages" in frame.f_code.co_filename
    return str(frame.f_globals.get("__name__", "")).partition(".")[0] if installed else ""


def one_line(error: BaseException) -> str:
    """The failure in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def values(names: Sequence[str], numbers: "np.ndarray") -> str:
    """A state in words: h = 1.2, v = 0."""
    return ", ".join(f"{name} = {value + 0.0:.4g}" for name, value in zip(names, numbers, strict=True))


def ranges(names: Sequence[str], pairs: "np.ndarray") -> str:
    """Ranges (n, 2) in words: u in [-1, 1], v in [0, 2]."""
    return ", ".join(f"{name} in [{a:g}, {b:g}]" for name, (a, b) in zip(names, pairs.tolist(), strict=True))


def _code(function: Callable[..., Any]) -> Any:
    """The function's code, a method's and a decorated function's too; None where it is not Python."""
    return getattr(inspect.unwrap(getattr(function, "__func__", function)), "__code__", None)
