"""The typer application: how a function becomes a command, and how a failure becomes an exit code."""

import inspect
import re
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import fields
from itertools import zip_longest
from typing import Any, TypeVar, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from npred.cli.completion import literal
from npred.cli.options import Common
from npred.errors import NpredError, first_line, missing, similar
from npred.terminal import interruption, streams, waiting
from npred.terminal.console import Console

USAGE: type[BaseException] = typer.BadParameter.__mro__[1]  # what every usage error is; typer keeps the name to itself
# What the parser says of a number, by version, and what npred says
FAULTS = {"integer|not in the range": "a whole number", "number|float|greater than": "a number"}
Function = TypeVar("Function", bound=Callable[..., None])


class Untyped:
    """Where a flag has no word for its value, it takes none; help is text, of which rich would eat `[evaluate]`."""

    def __init__(self, *args: Any, **named: Any) -> None:
        super().__init__(*args, **named)
        self.help: str | None
        for one in (self, *self.params) if self.rich_markup_mode == "rich" else ():  # type: ignore[attr-defined]
            one.help = one.help and literal(one.help)

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
    """Commands under one name, or all of them; a usage error is one line, where typer draws a box."""

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Run the command of the arguments and exit with its code; without `standalone_mode` return it."""
        if not standalone_mode:
            return super().main(*args, standalone_mode=False, **extra)
        try:
            code = super().main(*args, standalone_mode=False, **extra)
        except USAGE as error:
            sys.exit(_report_usage(error, args[0] if args and args[0] else extra.get("args") or sys.argv[1:]))
        except OSError as error:  # commands say theirs: this is of a help that stdout does not take
            streams.silence(sys.stdout)
            Console().error(str(streams.unwritable(error.strerror)))
            sys.exit(1)
        sys.exit(code if isinstance(code, int) else 0)


def _report_usage(error: Any, arguments: Sequence[str]) -> int:
    """Say it on stderr, with the usage where the parser says of which command; the exit code."""
    got, context = " ".join(error.format_message().split()).rstrip("."), error.ctx
    if context and (fault := _fault_of_option(error, arguments)):
        Console().error(fault if fault.endswith("?") else f"{fault}; see {context.command_path} --help")
        return error.exit_code
    path, expected = "npred", ""  # of an option without its value
    if context:
        path, pieces = context.command_path, context.command.collect_usage_pieces(context)
        expected, got = f"expected {path} {' '.join(pieces)}, got: ", got.removeprefix("Got ")
    if got:  # else no command was named, and the help is printed
        Console().error(f"{expected}{got}; see {path} --help")
    return error.exit_code


def _fault_of_option(error: Any, arguments: Sequence[str]) -> str:
    """An unknown command or option, or a number that is none, in the words of npred; else nothing."""
    command = error.ctx.command
    if unknown := re.match(r"No such command '(.*?)'", error.message):
        near = similar(unknown[1], [*command.list_commands(error.ctx), *_options(command)])
        return f"{unknown[1]}: expected a command of {error.ctx.command_path}, found no such{near}"
    if option := getattr(error, "option_name", ""):
        near = similar(option, _options(command)) or _key(option, command)
        return f"{option}: expected an option of {error.ctx.command_path}, found no such{near}"
    expected = next((words for form, words in FAULTS.items() if re.search(form, error.message)), "")
    names: Sequence[str] = error.param.opts if expected and getattr(error, "param", None) else []
    values = [
        text.partition("=")[2] or following
        for text, following in zip_longest(arguments, arguments[1:], fillvalue="")
        if text.partition("=")[0] in names
    ]
    least = re.search(r"(?:equal to |>=)([\d.]+)", error.message)
    expected += f" of at least {least[1]}" if least else ""
    return f"{names[-1]}: expected {expected}, got {', '.join(map(repr, values))}" if values else ""


def _options(command: Any) -> list[str]:
    """The long options of a command."""
    return [name for parameter in command.params for name in parameter.opts if name.startswith("--")]


def _key(option: str, command: Any) -> str:
    """How to set a key of the pipeline that is called like an unknown option, as --epochs; else nothing."""
    from npred import config

    leaf = option.removeprefix("--").replace("-", "_")
    keys = [key for key, _ in config.leaves() if key.rpartition(".")[2] == leaf]
    return f"; write --set {keys[0]}=VALUE" if keys and "--set" in _options(command) else ""


app = typer.Typer(
    name="npred",
    cls=Group,
    help="Numerical and neural predictor feedback for delayed nonlinear plants: generate, train, evaluate, bench.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)


def command(
    panel: str, to: typer.Typer = app, name: str = "", help: str | None = None, waits: str = ""
) -> Callable[[Function], Function]:
    """Register f(options, *, own parameters) as a command, which also takes the flags of its options class.

    Its name and help are f's own unless they are given. `waits` is what it says of itself where it takes some seconds.
    """

    def register(function: Function) -> Function:
        words = name or function.__name__.strip("_").replace("_", "-")
        to.command(words, cls=Command, rich_help_panel=panel, help=help)(with_flags(function, waits))
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
        with waiting.heard(console.wait), waiting.said(waits) if waits else nullcontext():
            call()
        interruption.check()
        return 0
    except BrokenPipeError:  # the reader of stdout has left, as `head` does
        return 1
    except (Exception, KeyboardInterrupt) as error:
        if interruption.heard() or isinstance(error, KeyboardInterrupt):  # libraries turn a signal into other errors
            interruption.say(console.error)
            return interruption.code()
        if isinstance(error, ModuleNotFoundError):  # of a package of an extra, where nothing has said so before
            error = missing("npred", error) or error
        if isinstance(error, NpredError):
            name, colon, rest = str(error).partition(":")
            console.error(f"{flags.get(name, name)}{colon}{rest}")
            return error.exit_code
        return _unforeseen(error, console)
    finally:
        console.close()


def _unforeseen(error: BaseException, console: Console) -> int:
    console.detail("".join(traceback.format_exception(error)).rstrip())
    todo = f"the traceback is in {console.log.path}" if console.log else "run with -v for the traceback"
    if not console.verbose:
        console.error(f"{type(error).__name__}: {first_line(error, 'no message')}; {todo}")
    return 1
