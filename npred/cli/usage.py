"""Usage errors in one line, as all others: typer would draw a box of several."""

import sys
from typing import Any

import typer
from typer.core import TyperGroup

from npred.console import Console

USAGE: type[BaseException] = typer.BadParameter.__mro__[1]  # what every usage error is; typer keeps the name to itself


class OneLine(TyperGroup):
    """The group of all commands."""

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Run the command of the arguments and exit with its code; without `standalone_mode` return it."""
        if not standalone_mode:
            return super().main(*args, standalone_mode=False, **extra)
        try:
            code = super().main(*args, standalone_mode=False, **extra)
        except USAGE as error:
            sys.exit(_tell(error))
        except typer.Abort:
            sys.exit(1)
        sys.exit(code if isinstance(code, int) else 0)


def _tell(error: Any) -> int:
    """Say it on stderr; the exit code."""
    got = " ".join(error.format_message().split()).rstrip(".")
    if got:  # else no command was named, and the help is printed
        path, wanted = error.ctx.command_path, " ".join(error.ctx.command.collect_usage_pieces(error.ctx))
        Console().error(f"expected {path} {wanted}, got: {got}; see {path} --help")
    return error.exit_code
