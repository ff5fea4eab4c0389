"""Ctrl-C, SIGTERM and SIGHUP: one way out, one line, and the exit code 128 + the signal, however often they come."""

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from types import FrameType

SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
LINE = "interrupted; finished stages and checkpoints are kept: the same command goes on from there"
SHOW_CURSOR = b"\x1b[?25h"  # the live view hides it
_heard: list[int] = []  # the first signal
_said: list[str] = []


def listen() -> None:
    """Let the first signal raise KeyboardInterrupt, and a second one end the process at once.

    A signal that is ignored, as nohup and a shell's background have it, stays so.
    """
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _hear)


def heard() -> bool:
    """True if a signal has arrived: what failed since may have failed of it."""
    return bool(_heard)


def code() -> int:
    """130 for Ctrl-C, 143 for SIGTERM, 129 for SIGHUP."""
    return 128 + (_heard[0] if _heard else signal.SIGINT)


def say(error: Callable[[str], None]) -> None:
    """Say once, with this function, that the command was interrupted."""
    handlers = {number: signal.signal(number, signal.SIG_IGN) for number in SIGNALS}  # or a second one cuts the line
    if not (_heard and _said):
        error(LINE)
        _said.append(LINE)
    for number, handler in handlers.items():
        if handler is not None:  # None: not installed from Python
            signal.signal(number, handler)


def _hear(number: int, frame: FrameType | None) -> None:
    if _heard:
        _leave()
    _heard.append(number)
    raise KeyboardInterrupt


def _leave() -> None:
    """End without waiting for threads: the store bears it, as it bears kill -9."""
    with suppress(OSError):
        if sys.stderr and sys.stderr.isatty():
            os.write(2, SHOW_CURSOR)
        if not _said:
            os.write(2, f"error: {LINE}\n".encode())
    os._exit(code())
