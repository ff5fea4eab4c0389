"""The application: every command by its name, how a function becomes a command, and how a failure an exit code.

The module of a command is imported when the command is called, or its help is asked for: `npred --help` stays quick.
"""

import inspect
import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from dataclasses import fields
from difflib import get_close_matches
from functools import partial
from typing import Annotated, Any, get_type_hints

import typer
import typer.main
from typer.core import TyperCommand, TyperGroup

import npred
from npred.base.errors import ConfigError, NpredError, first_line, missing
from npred.base.progress import announce, listener
from npred.base.registry import COMMANDS, STAGES, attribute, declared_stage
from npred.cli.options import Common, argument
from npred.exports import FORMATS
from npred.lab.report.terminal import interruption
from npred.lab.report.terminal.console import Console

CHECKING = "checking the plant: its formulas, its equilibrium, the loops of its law"
READING = "importing the packages and reading the store: some seconds"
WRITING = "reading, writing and testing the export: some seconds, minutes for large networks"
PLANTS = "List the plants that are built in or installed; `npred plants check` says what is wrong with one."
GRID = "Run a grid of pipelines: --set train.deeponet.width=32,64,128 --set seed=0:10; shared results are made once."
TUNE = "Search better gamma, b and gains of kappa on the loops of [evaluate]; say so if nothing is to be gained."
OF_STAGES = {"identify": "identify:identify", "bench": "execute:bench", "report": "execute:report"}  # with more flags
OTHERS = {  # by name: module:function, help, and what is said of a command that takes some seconds
    "sweep": ("sweep:sweep", GRID),
    "tune": ("tune:tune", TUNE),
    "status": ("inspect:status", "Say of each result whether it is fresh, stale or missing."),
    "why": ("inspect:why", "Say why a stage would run again: what changed, before -> after."),
    "show": ("inspect:show", "Print a result: its question, its files, its answer."),
    "ls": ("inspect:ls", "List every result in the store, the most recent last."),
    "diff": ("inspect:diff", "Compare two results: their questions, and their answers."),
    "init": ("scaffold:init", "Write a new plant to start from: NAME.py and NAME.toml in this folder."),
    "verify": ("store_admin:verify", "Compare every file of every result with its digest; exit 4 if one differs."),
    "gc": ("store_admin:gc", "Print which results no pipeline needs; with --yes, delete them."),
    "doctor": ("store_admin:doctor", "Print versions, devices, threads and the state of the store.", READING),
}
LOOK: dict[str, Any] = {
    "context_settings": {"help_option_names": ["-h", "--help"]},
    "pretty_exceptions_enable": False,
    "rich_markup_mode": None,  # rich would eat `[evaluate]`
}


class Root(TyperGroup):
    """The commands; a name that only a group has is answered with the group's, `npred check` with `plants check`."""

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]
        groups = {group: getattr(each, "commands", ()) for group, each in self.commands.items()}
        nested = {name: f"{group} {name}" for group, names in groups.items() for name in names}
        close = get_close_matches(args[0], nested, n=1)
        if close and not get_close_matches(args[0], self.commands):
            ctx.fail(f"No such command '{args[0]}'. Did you mean '{nested[close[0]]}'?")
        return super().resolve_command(ctx, args)


app = typer.Typer(
    name="npred",
    cls=Root,
    help="Numerical and neural predictor feedback for nonlinear plants whose input is delayed.",
    no_args_is_help=True,
    **LOOK,
)


class LazyCommand(TyperCommand):
    """A command whose function, and so its flags, are there from the first question for them on."""

    def __init__(self, function: str | Callable[..., None], waits: str, **declared: Any) -> None:
        super().__init__(**declared)
        self.function, self.waits = function, waits
        del self.params, self.callback

    def __getattr__(self, name: str) -> Any:
        if name not in ("params", "callback"):
            raise AttributeError(name)
        alone = typer.Typer(add_completion=False, **LOOK)

        def load() -> None:
            function: Any = self.function
            if isinstance(function, str):
                module, name, *names = function.split(":")
                function = attribute(f"npred.cli.{module}:{name}")
                function = function(*names) if names else function
            alone.command()(with_flags(function, self.waits))

        if code := guarded(load, Console(), json="--json" in sys.argv):
            raise typer.Exit(code)
        command = typer.main.get_command(alone)
        self.params, self.callback = command.params, command.callback
        return getattr(self, name)


def add(to: typer.Typer, name: str, function: str | Callable[..., None], help: str, waits: str = "") -> None:
    """Add a command: f(options, *, own parameters), which also takes the flags of its options class, or its place in
    npred.cli: module:function, or module:function:argument where that makes the command. `waits` is what it says of
    itself where it takes some seconds.
    """
    lazy: Any = partial(LazyCommand, function, waits)
    to.command(name, cls=lazy, help=help, short_help=" ".join(help.split()))(lambda: None)


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
        if context.invoked_subcommand:  # a group of commands
            return
        sources = {p: context.get_parameter_source(str(p.name)) for p in context.command.params}
        written = [p for p, source in sources.items() if source and source.name == "COMMANDLINE"]
        flags = {str(p.name): p.opts[-1] for p in written if p.opts[-1].startswith("--")}
        if code := guarded(lambda: function(common, **values), common.console, waits, flags, common.json):
            raise typer.Exit(code)

    kind = inspect.Parameter.KEYWORD_ONLY
    flags = [inspect.Parameter(f.name, kind, default=f.default, annotation=hints[f.name]) for f in shared]
    parameters = [inspect.Parameter("context", kind, annotation=typer.Context), *arguments, *flags]
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return call


def guarded(
    call: Callable[[], None], console: Console, waits: str = "", flags: Mapping[str, str] = {}, json: bool = False
) -> int:
    """The exit code of a call: 0, the failure's own, that of a signal, 1 for the unforeseen. Ends the console's log.

    A message that begins with an argument's name, as `precision: expected …`, names the one of `flags` instead: those
    that the user wrote, by the names that they have as arguments in Python. With `json` a failure
    without an answer is a document on stdout too.
    """

    def failed(kind: str, message: str, exit_code: int) -> int:
        if json and not console.answered:
            with suppress(NpredError, BrokenPipeError):
                console.json(failure(kind, message, exit_code))
        return exit_code

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
            return failed("Interrupted", "interrupted; what is finished is kept", interruption.code())
        if isinstance(error, ModuleNotFoundError):  # the package of an extra, where nothing has said so before
            error = missing("npred", error) or error
        if isinstance(error, NpredError):
            name, colon, rest = str(error).partition(":")
            message = f"{flags.get(name, name)}{colon}{rest}"
            console.error(message)
            return failed(type(error).__name__, message, error.exit_code)
        console.detail("".join(traceback.format_exception(error)).rstrip())
        todo = f"the traceback is in {console.log.path}" if console.log else "run with -v for the traceback"
        message = f"{first_line(error, 'no message')}; {todo}"
        if not console.verbose:
            console.error(f"{type(error).__name__}: {message}")
        return failed(type(error).__name__, message, 1)
    finally:
        console.close()


def failure(kind: str, message: str, exit_code: int) -> dict[str, object]:
    """The document of a failure."""
    return {"error": {"kind": kind, "message": message, "exit_code": exit_code}}


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"npred {npred.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None: ...


add(app, "run", "execute:run", "Run all stages in order; a result that is already in the store is reused.")
for _name in STAGES:
    add(app, _name, OF_STAGES.get(_name, f"execute:stage_command:{_name}"), declared_stage(_name).help)
for _name, _declared in OTHERS.items():
    add(app, _name, *_declared)


@app.command("help")
def _help(
    context: typer.Context,
    words: Annotated[list[str] | None, argument("[COMMAND]...", "As `run` or `plants check`.")] = None,
) -> None:
    """Print the help of one command, or of all."""
    root = context.find_root()
    root.command.main([*(words or []), "--help"], prog_name=root.info_name, standalone_mode=False)


_plants = typer.Typer()
app.add_typer(_plants, name="plants", help=PLANTS, short_help=PLANTS)


@_plants.callback(invoke_without_command=True)
@with_flags
def _listed(options: Common) -> None:
    attribute("npred.cli.inspect:plants")(options)


add(
    _plants,
    "check",
    "inspect:check",
    "Check a plant: each question has one answer; exit 3 if an answer is no.",
    CHECKING,
)
_export = typer.Typer(no_args_is_help=True, help="Write a controller or a trained network for another program.")
app.add_typer(_export, name="export")
for _name, _format in FORMATS.items():
    add(_export, _name, f"export:format_command:{_name}", _format.help, WRITING)
for _name in sorted(set(COMMANDS.names()) - {each.name for each in app.registered_commands}):
    try:
        _function = COMMANDS.installed(_name)
        add(app, _name, _function, _function.__doc__)
    except ConfigError as _error:  # a package that fails stops no other command
        Console().warn(str(_error))
