"""The command line, `npred`."""

import sys
from gc import freeze, set_threshold

from npred.cli.app import app, failure
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
        if "--json" in sys.argv:
            sys.exit(_documented())
        app()
    except OSError as error:  # commands say theirs: this is of a help that stdout does not take
        streams.silence(sys.stdout)
        Console().error(str(streams.unwritable(error.strerror)))
        sys.exit(1)
    finally:
        freeze()  # while it is taken down, the interpreter would look for cycles among all that is left


def _documented() -> int:
    """The exit code of the command; wrong usage, as a flag that there is not, is a document on stdout too."""
    try:
        return app(standalone_mode=False) or 0
    except Exception as error:  # of typer, or of click in older versions of it
        if not (isinstance(code := getattr(error, "exit_code", None), int) and hasattr(error, "show")):
            raise
        error.show()  # type: ignore[attr-defined]
        Console().json(failure("UsageError", error.format_message(), code))  # type: ignore[attr-defined]
        return code
