"""The clock of a rig, time.monotonic, common to all processes of a machine: its start, waiting, and being late."""

import signal
import time
from multiprocessing.connection import Connection

import numpy as np

from npred.terminal import interruption

SPIN = 2e-4  # s before the time, from which on the clock is read without sleeping


def agreed(parent: Connection) -> float:
    """Say that this process is ready; when all begin. Whoever started it ends it, so that the log has its end: it
    ignores signals, which a terminal or `timeout` sends to all.
    """
    for number in interruption.SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    try:
        parent.send(None)
        return parent.recv()
    except (EOFError, OSError):  # it is gone
        raise SystemExit(1) from None


def wait(until: float) -> float:
    """Sleep until time.monotonic() is `until`, the last part of it awake; what it is then."""
    while (left := until - time.monotonic()) > 0:
        if left > SPIN:
            time.sleep(left - SPIN)
    return time.monotonic()


def only_wait(dt: float, seconds: float, parent: Connection) -> None:
    """Send how late, in seconds, a process comes that waits for each dt and does nothing: the machine's own stops."""
    start, late = agreed(parent), []
    for k in range(1, int(seconds / dt) + 1):
        if parent.poll():
            return
        late.append(wait(start + k * dt) - start - k * dt)
    parent.send(np.array(late))
