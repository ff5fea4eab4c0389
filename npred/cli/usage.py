"""Changes to typer: usage errors in one line, where it draws a box, and flags without a type."""

import sys
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from npred.terminal import streams
from npred.terminal.console import Console

USAGE: type[BaseException] = typer.BadParameter.__mro__[1]  # what every usage error is; typer keeps the name to itself


class Command(TyperCommand):
    """A command."""

    def get_params(self, ctx: Any) -> list[Any]:
        return _untyped(super().get_params(ctx))


class Group(TyperGroup):
    """Commands under one name, or all of them."""

    def get_params(self, ctx: Any) -> list[Any]:
        return _untyped(super().get_params(ctx))

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


def _untyped(parameters: list[Any]) -> list[Any]:
    """The same, where a flag has no word for its value: it takes none."""
    for parameter in parameters:
        if getattr(parameter, "is_flag", False) and parameter.metavar is None:
            parameter.metavar = ""
    return parameters


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
