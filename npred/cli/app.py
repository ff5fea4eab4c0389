"""The typer application: how a function becomes a command, and how a failure becomes an exit code."""

import inspect
import traceback
from collections.abc import Callable
from importlib import import_module
from typing import Any

import typer

from npred.cli.options import Common, parameters
from npred.cli.usage import Command, Group
from npred.errors import NpredError
from npred.terminal import interruption
from npred.terminal.console import Console

app = typer.Typer(
    name="npred",
    cls=Group,
    help="Numerical and neural predictor feedback for delayed nonlinear plants: generate, train, evaluate, bench.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)


def command(
    panel: str, does: str, to: typer.Typer = app, name: str = "", help: str | None = None, group: bool = False,
    **more: str,
) -> Callable[[Callable[..., None]], Any]:  # fmt: skip
    """Register f(options, *, own parameters) as a command that also takes the flags of its options class.

    f says no more than the parameters: `does`, as "inspect.why", is the function of npred.cli that gets their values,
    and `more`. Its name and help are f's own unless they are given. A `group` takes subcommands, and runs where none of
    them is named.
    """

    def register(function: Callable[..., None]) -> Any:
        words = name or function.__name__.strip("_").replace("_", "-")
        call, about = _with_flags(function, does, **more), help or function.__doc__
        if not group:
            to.command(words, cls=Command, rich_help_panel=panel, help=about)(call)
            return function
        subcommands = typer.Typer(cls=Group, no_args_is_help=False)
        subcommands.callback(invoke_without_command=True, help=about)(call)
        to.add_typer(subcommands, name=words, rich_help_panel=panel)
        return subcommands

    return register


def _with_flags(function: Callable[..., None], does: str, **more: str) -> Callable[..., None]:
    """The function as typer reads it: its parameters, then the flags; a failure becomes an exit code."""
    first, *arguments = inspect.signature(function).parameters.values()
    options: type[Common] = first.annotation
    shared = parameters(options)
    module, _, action = does.partition(".")

    def call(context: typer.Context, **values: Any) -> None:
        if context.invoked_subcommand:  # of a group
            return
        common = options(**{parameter.name: values.pop(parameter.name) for parameter in shared})
        code = guarded(
            lambda: getattr(import_module(f"npred.cli.{module}"), action)(common, **values, **more), common.console
        )
        if code:
            raise typer.Exit(code)

    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    signature = inspect.Signature([context, *arguments, *shared])
    vars(call).update(__signature__=signature, __doc__=function.__doc__)
    call.__annotations__ = {name: parameter.annotation for name, parameter in signature.parameters.items()}
    return call


def guarded(call: Callable[[], None], console: Console) -> int:
    """The exit code of a call: 0, the failure's own, that of a signal, 1 for the unforeseen. Ends the console's log."""
    try:
        call()
        interruption.check()
        return 0
    except BrokenPipeError:  # the reader of stdout has left, as `head` does
        return 1
    except (Exception, KeyboardInterrupt) as error:
        if interruption.heard() or isinstance(error, KeyboardInterrupt):  # libraries turn a signal into other errors
            interruption.say(console.error)
            return interruption.code()
        if isinstance(error, NpredError):
            console.error(str(error))
            return error.exit_code
        return _unforeseen(error, console)
    finally:
        console.close()


def _unforeseen(error: BaseException, console: Console) -> int:
    console.detail("".join(traceback.format_exception(error)).rstrip())
    first = (str(error).splitlines() or ["no message"])[0]
    todo = f"the traceback is in {console.log.path}" if console.log else "run with -v for the traceback"
    if not console.verbose:
        console.error(f"{type(error).__name__}: {first}; {todo}")
    return 1
