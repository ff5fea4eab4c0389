"""The typer application: how a function becomes a command, and how a failure becomes an exit code."""

import inspect
import os
import sys
import traceback
from collections.abc import Callable
from typing import Any

import typer

from npred.cli.options import Common, parameters
from npred.cli.usage import Command, Group
from npred.console import Console
from npred.errors import NpredError

app = typer.Typer(
    name="npred",
    cls=Group,
    help="Numerical and neural predictor feedback for delayed nonlinear plants: generate, train, evaluate, bench.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)


class Terminated(KeyboardInterrupt):
    """SIGTERM: the same way out as Ctrl-C, with another exit code."""


def command(panel: str, to: typer.Typer = app) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register f(options, *, own parameters) as a command that also takes the flags of its options class."""

    def register(function: Callable[..., None]) -> Callable[..., None]:
        name = function.__name__.strip("_").replace("_", "-")
        to.command(name=name, cls=Command, rich_help_panel=panel, help=function.__doc__)(_with_flags(function))
        return function

    return register


def group(panel: str) -> Callable[[Callable[..., None]], typer.Typer]:
    """Make f(options, *, own parameters) a command with commands of its own: it runs where none of them is named."""

    def register(function: Callable[..., None]) -> typer.Typer:
        made = typer.Typer(cls=Group, no_args_is_help=False)
        made.callback(invoke_without_command=True, help=function.__doc__)(_with_flags(function))
        app.add_typer(made, name=function.__name__, rich_help_panel=panel)
        return made

    return register


def _with_flags(function: Callable[..., None]) -> Callable[..., None]:
    """The function as typer reads it: its own parameters, then the flags; a failure becomes an exit code."""
    first, *own = inspect.signature(function).parameters.values()
    options: type[Common] = first.annotation
    shared = parameters(options)

    def call(**values: Any) -> None:
        common = options(**{parameter.name: values.pop(parameter.name) for parameter in shared})
        code = guarded(lambda: function(common, **values), common.console)
        if code:
            raise typer.Exit(code)

    signature = inspect.Signature([*own, *shared])
    vars(call).update(__signature__=signature, __doc__=function.__doc__)
    call.__annotations__ = {name: parameter.annotation for name, parameter in signature.parameters.items()}
    return call


def guarded(call: Callable[[], None], console: Console) -> int:
    """The exit code of a call: 0, the failure's own, 130 or 143 where it was interrupted, 1 for the unforeseen."""
    try:
        call()
    except NpredError as error:
        console.error(str(error))
        return error.exit_code
    except KeyboardInterrupt as stop:
        console.error("interrupted; finished stages and checkpoints are kept: the same command goes on from there")
        return 143 if isinstance(stop, Terminated) else 130
    except BrokenPipeError:  # the reader of stdout has left, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        return _unforeseen(error, console)
    return 0


def _unforeseen(error: Exception, console: Console) -> int:
    if console.verbose:
        traceback.print_exception(error)
        return 1
    first = (str(error).splitlines() or ["no message"])[0]
    console.error(f"{type(error).__name__}: {first}; run with -v for the traceback")
    return 1
