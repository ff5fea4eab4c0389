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
        Console().error(f"{_expected(error.ctx)}{got}; see {error.ctx.command_path if error.ctx else 'npred'} --help")
    return error.exit_code


def _expected(context: Any) -> str:
    """The usage, where the parser says of which command: of an option without its value it does not."""
    if context is None:
        return ""
    return f"expected {context.command_path} {' '.join(context.command.collect_usage_pieces(context))}, got: "
