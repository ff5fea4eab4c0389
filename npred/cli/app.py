"""The typer application: how a function becomes a command, and how a failure becomes an exit code."""

import inspect
import traceback
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import fields
from typing import Any, TypeVar, get_type_hints

import typer

from npred.base.errors import NpredError, first_line, missing
from npred.base.progress import announce, listener
from npred.cli.options import Common
from npred.lab.report.terminal import interruption
from npred.lab.report.terminal.console import Console

Function = TypeVar("Function", bound=Callable[..., None])


app = typer.Typer(
    name="npred",
    help="Numerical and neural predictor feedback for delayed nonlinear plants: generate, train, evaluate, bench.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # rich would eat `[evaluate]`
)


def command(
    to: typer.Typer = app, name: str = "", help: str | None = None, waits: str = ""
) -> Callable[[Function], Function]:
    """Register f(options, *, own parameters) as a command, which also takes the flags of its options class.

    Its name and help are f's own unless they are given. `waits` is what it says of itself where it takes some seconds.
    """

    def register(function: Function) -> Function:
        words = name or function.__name__.strip("_").replace("_", "-")
        about = " ".join((help or function.__doc__ or "").split())
        to.command(words, help=help, short_help=about)(with_flags(function, waits))
        return function

    return register


def with_flags(function: Callable[..., None], waits: str = "") -> Callable[..., None]:
    """The function as typer reads it: its parameters, then the flags of its first one's class, the pipeline file
    before the others. A failure becomes an exit code.
    """
    first, *arguments = inspect.signature(function).parameters.values()
    options: type[Common] = first.annotation
    hints = get_type_hints(options, include_extras=True)
    shared = sorted(fields(options), key=lambda field: field.name != "pipeline_name")

    def call(context: typer.Context, **values: Any) -> None:
        common = options(**{field.name: values.pop(field.name) for field in shared})
        if context.invoked_subcommand:  # of a group
            return
        if code := guarded(lambda: function(common, **values), common.console, waits, _flags(context)):
            raise typer.Exit(code)

    kind = inspect.Parameter.KEYWORD_ONLY
    flags = [inspect.Parameter(f.name, kind, default=f.default, annotation=hints[f.name]) for f in shared]
    parameters = [inspect.Parameter("context", kind, annotation=typer.Context), *arguments, *flags]
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    call.__doc__ = function.__doc__
    return call


def _flags(context: typer.Context) -> dict[str, str]:
    """The flags that the user wrote, by the names that they have as arguments in Python."""
    sources = {p: context.get_parameter_source(str(p.name)) for p in context.command.params}
    written = [p for p, source in sources.items() if source and source.name == "COMMANDLINE"]
    return {str(p.name): p.opts[-1] for p in written if p.opts[-1].startswith("--")}


def guarded(call: Callable[[], None], console: Console, waits: str = "", flags: Mapping[str, str] = {}) -> int:
    """The exit code of a call: 0, the failure's own, that of a signal, 1 for the unforeseen. Ends the console's log.

    A message that begins with an argument's name, as `precision: expected …`, names the one of `flags` instead.
    """
    try:
        with listener(console.wait), announce(waits) if waits else nullcontext():
            call()
        interruption.check()
        return 0
    except BrokenPipeError:  # the reader of stdout has left, as `head` does
        return 1
    except (Exception, KeyboardInterrupt) as error:
        # libraries turn a signal into other errors
        if interruption.interrupted() or isinstance(error, KeyboardInterrupt):
            interruption.say(console.error)
            return interruption.code()
        if isinstance(error, ModuleNotFoundError):  # of a package of an extra, where nothing has said so before
            error = missing("npred", error) or error
        if isinstance(error, NpredError):
            name, colon, rest = str(error).partition(":")
            console.error(f"{flags.get(name, name)}{colon}{rest}")
            return error.exit_code
        console.detail("".join(traceback.format_exception(error)).rstrip())
        todo = f"the traceback is in {console.log.path}" if console.log else "run with -v for the traceback"
        if not console.verbose:
            console.error(f"{type(error).__name__}: {first_line(error, 'no message')}; {todo}")
        return 1
    finally:
        console.close()
