"""Changes to typer: usage errors in one line, where it draws a box, and flags without a type."""

import sys
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from npred.terminal import streams
from npred.terminal.console import Console

USAGE: type[BaseException] = typer.BadParameter.__mro__[1]  # what every usage error is; typer keeps the name to itself


class Untyped:
    """Where a flag has no word for its value, it takes none."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, as typer reads them."""
        parameters = super().get_params(ctx)  # type: ignore[misc]
        for parameter in parameters:
            if getattr(parameter, "is_flag", False) and parameter.metavar is None:
                parameter.metavar = ""
        return parameters


class Command(Untyped, TyperCommand):
    """A command."""


class Group(Untyped, TyperGroup):
    """Commands under one name, or all of them."""

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Run the command of the arguments and exit with its code; without `standalone_mode` return it."""
        if not standalone_mode:
            return super().main(*args, standalone_mode=False, **extra)
        try:
            code = super().main(*args, standalone_mode=False, **extra)
        except USAGE as error:
            sys.exit(_tell(error))
        except OSError as error:  # commands say theirs: this is of a help that stdout does not take
            streams.silence(sys.stdout)
            Console().error(str(streams.unwritable(error.strerror)))
            sys.exit(1)
        sys.exit(code if isinstance(code, int) else 0)


def _tell(error: Any) -> int:
    """Say it on stderr, with the usage where the parser says of which command; the exit code."""
    got, context = " ".join(error.format_message().split()).rstrip("."), error.ctx
    path, expected = "npred", ""  # of an option without its value
    if context:
        path, pieces = context.command_path, context.command.collect_usage_pieces(context)
        expected = f"expected {path} {' '.join(pieces)}, got: "
    if got:  # else no command was named, and the help is printed
        Console().error(f"{expected}{got}; see {path} --help")
    return error.exit_code
