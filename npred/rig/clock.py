"""Waiting for a time, and how late a program is that does nothing else."""

import os
import time
from multiprocessing.connection import Connection

import numpy as np

SPIN = 2e-4  # s before the time, from which on the clock is read without sleeping


def wait(until: float) -> float:
    """Sleep until time.monotonic() is `until`, the last part of it awake; what it is then."""
    while (left := until - time.monotonic()) > 0:
        if left > SPIN:
            time.sleep(left - SPIN)
    return time.monotonic()


def witness(dt: float, seconds: float, answer: Connection, parent: int) -> None:
    """Send how late, in seconds, a process comes that waits for each dt and does nothing: the machine's own stops."""
    start, late = time.monotonic(), []
    for k in range(1, int(seconds / dt) + 1):
        if os.getppid() != parent:
            return
        late.append(wait(start + k * dt) - start - k * dt)
    answer.send(np.array(late))
