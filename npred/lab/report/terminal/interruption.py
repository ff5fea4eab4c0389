"""Ctrl-C, SIGTERM and SIGHUP: one way out, one line, and the exit code 128 + the signal, however often they come.

No exception is raised where the signal finds the program: it could leave a library's lock taken for ever, or an import
half done. A thread hears of the signal and ends the process at once, which the store bears as it bears kill -9. Where
there is something to put away, in `graceful`, the work is asked to end first, and raises KeyboardInterrupt at its next
report of progress.
"""

import _thread
import atexit
import os
import select
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
LINE = "interrupted; finished stages and checkpoints are stored: run the same command to go on"
SHOW_CURSOR = b"\x1b[?25h"  # the live view hides it
GRACE = 3.0  # s that work which is asked to end may take, and that of multiprocessing at the very end
_wakeup: list[socket.socket] = []  # what the interpreter writes the number of each signal to, at once, and its end
_received: list[int] = []
_said: list[str] = []
_saying = _thread.allocate_lock()
_views: list[object] = []  # on the screen: the cursor stands at the end of their last row
_graceful: list[str] = []  # what is said of the work that is asked to end


def listen() -> None:
    """From now on a signal ends the process; a second one does so without a grace.

    A signal that is ignored, as nohup and a shell's background have it, stays so.
    """
    if _wakeup:
        return
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # a closed stream: what is opened next, as a result, would get its words
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one
    _wakeup.extend(socket.socketpair())
    _wakeup[1].setblocking(False)
    signal.set_wakeup_fd(_wakeup[1].fileno(), warn_on_full_buffer=False)
    _thread.start_new_thread(_watch, ())
    handled = [number for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    for number in handled:
        # in the main thread, so that an error which it meets later is known to come later
        signal.signal(number, lambda number, frame: _received.append(number))
    sys.warnoptions.append("ignore:resource_tracker:UserWarning")  # read by the process that puts away what is left
    # The first to be registered is called last: while the interpreter is taken down, a signal would do its default.
    atexit.register(lambda: [signal.signal(number, signal.SIG_IGN) for number in handled])


def interrupted() -> bool:
    """True if a signal has arrived: later failures may come from it."""
    return bool(_received)


def check() -> None:
    """Raise KeyboardInterrupt if a signal has arrived: for work that can end here."""
    if _received:
        raise KeyboardInterrupt


@contextmanager
def graceful(line: str = LINE) -> Iterator[None]:
    """A signal gives the work in the block GRACE seconds to end, at its next `check`; `line` is said of it then."""
    _graceful.append(line)
    try:
        yield
    finally:
        if not _received:
            _graceful.pop()


@contextmanager
def below(view: object) -> Iterator[None]:
    """What is said of a signal in the block begins a new line, below the last row of a live view."""
    _views.append(view)
    try:
        yield
    finally:
        _views.remove(view)


def code() -> int:
    """130 for Ctrl-C, 143 for SIGTERM, 129 for SIGHUP."""
    return 128 + (_received[0] if _received else signal.SIGINT)


def say(error: Callable[[str], None]) -> None:
    """Say once, with this function, that the command was interrupted."""
    with _saying:  # _leave waits for it, or it would cut the line
        if not (_received and _said):
            error(_line())
            _said.append(_line())


def _line() -> str:
    return _graceful[-1] if _graceful else LINE


def _watch() -> None:
    """A thread, for the main one may be in compiled code for long, where Python calls no handler."""
    while (number := _wakeup[0].recv(1)[0]) not in SIGNALS:
        pass  # signals with others' handlers
    _received.append(number)
    if _graceful:
        select.select(_wakeup[:1], [], [], GRACE)  # or until a second one comes
    _leave()


def leave() -> None:
    """The end of a command that was interrupted: the interpreter is not taken down, for that waits for threads."""
    if _received:
        with suppress(OSError, ValueError, AttributeError):  # closed
            sys.stdout.flush()
        _leave()


def _leave() -> None:
    """End without waiting for threads."""
    said = not _saying.acquire(timeout=GRACE) or _said  # who says it for so long is stuck in the middle of it
    with suppress(OSError):
        if sys.stderr and sys.stderr.isatty():
            os.write(2, SHOW_CURSOR)
        if not said:
            os.write(2, (("\n" if _views else "") + f"error: {_line()}\n").encode())
    if util := sys.modules.get("multiprocessing.util"):
        _bounded(lambda: util._run_finalizers(0))  # or the process that watches semaphores says that they are left
    os._exit(code())


def _bounded(call: Callable[[], None]) -> None:
    """Run a function that may wait for others, as for a queue that nobody reads: for GRACE seconds at most."""
    over = _thread.allocate_lock()
    over.acquire()

    def run() -> None:
        with suppress(Exception):
            call()
        over.release()

    try:
        _thread.start_new_thread(run, ())
    except RuntimeError:  # from Python 3.12 on none starts while the interpreter is taken down
        return
    over.acquire(timeout=GRACE)
