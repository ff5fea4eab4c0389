"""The command line, `npred`."""

import signal
from types import FrameType

from npred import ranks
from npred.cli import commands
from npred.cli.app import Terminated, app, guarded
from npred.console import Console

__all__ = ["app", "commands", "main"]


def main() -> None:
    """Run the command of sys.argv and exit with its code; SIGTERM ends it as Ctrl-C does, with 143.

    Of the processes that torchrun starts, the first does so and the others help it train.
    """
    signal.signal(signal.SIGTERM, _terminate)
    if ranks.count() > 1:
        ranks.join()
        ranks.leave(_lead() if ranks.number() == 0 else _help_out())
    app()


def _lead() -> int:
    """The exit code of the first of several processes."""
    try:
        app()
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        ranks.dismiss()
    return 0


def _help_out() -> int:
    """The exit code of a process that torchrun started to help the first one train."""
    from npred.stages import train

    console = Console(quiet=True)
    return guarded(lambda: train.help_out(console), console)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated
