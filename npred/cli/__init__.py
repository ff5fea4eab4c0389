"""The command line, `npred`."""

import signal
from types import FrameType

from npred.cli import commands
from npred.cli.app import Terminated, app

__all__ = ["app", "commands", "main"]


def main() -> None:
    """Run the command of sys.argv and exit with its code; SIGTERM ends it as Ctrl-C does, with 143."""
    signal.signal(signal.SIGTERM, _terminate)
    app()


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated
