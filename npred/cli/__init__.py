"""The command line, `npred`."""

import sys
from gc import freeze, set_threshold

from npred.cli.app import app
from npred.lab.report.terminal import interruption, streams
from npred.lab.report.terminal.console import Console

__all__ = ["app", "main"]

MANY = 100_000  # objects between two searches for cycles: by default they take a third of the time of `npred status`


def main() -> None:
    """Run the command of sys.argv and exit with its code; SIGTERM and SIGHUP end it as Ctrl-C does."""
    interruption.listen()
    streams.prepare()
    set_threshold(MANY)
    try:
        app()
    except OSError as error:  # commands say theirs: this is of a help that stdout does not take
        streams.silence(sys.stdout)
        Console().error(str(streams.unwritable(error.strerror)))
        sys.exit(1)
    finally:
        freeze()  # while it is taken down, the interpreter would look for cycles among all that is left
