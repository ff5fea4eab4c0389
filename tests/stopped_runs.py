"""Runs of the command line in a process of their own, stopped in the middle."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from conftest import HERE, process_environment


def hear_interrupts() -> None:
    """A shell starts what it puts into the background deaf to SIGINT, nohup to SIGHUP, and children inherit that."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


class Process:
    """`npred` with fake stages, stopped in the middle of one of them."""

    def __init__(self, folder: Path, *arguments: str, hang: str = "") -> None:
        self.ready, theirs = os.pipe()
        mine, self.go = os.pipe()
        more = {"FAKE_READY": str(theirs), "FAKE_GO": str(mine), "FAKE_LOG": str(folder / "log")}
        self.process = subprocess.Popen(
            [sys.executable, str(HERE / "fake_stages.py"), *arguments],
            cwd=folder,
            env=process_environment(**more, **({"FAKE_HANG": hang} if hang else {})),
            pass_fds=(theirs, mine),
            preexec_fn=hear_interrupts,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        os.close(theirs)
        os.close(mine)

    def wait_until_in_the_middle(self) -> None:
        assert os.read(self.ready, 1) == b"!"

    def end(self, number: int) -> int:
        self.process.send_signal(number)
        return self.process.wait(30)

    def let_go(self) -> None:
        os.write(self.go, b"!")


@contextmanager
def stopped_in(stage: str, folder: Path, *arguments: str) -> Iterator[Process]:
    running = Process(folder, *arguments, hang=stage)
    try:
        running.wait_until_in_the_middle()
        yield running
    finally:
        running.process.kill()
        running.process.communicate()
