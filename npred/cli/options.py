"""The flags that commands share, each declared once."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from npred import defaults
from npred.cli import completion
from npred.errors import ConfigError
from npred.terminal.console import Console

if TYPE_CHECKING:  # pydantic and filelock come with these, which `npred --help` has no use for
    from npred.config import Pipeline
    from npred.pipeline import Planner
    from npred.store import Store


@dataclass(frozen=True)
class Common:
    """Flags of every command."""

    store: Annotated[Path, typer.Option(envvar=defaults.STORE_VARIABLE, help="Where results are kept.")] = (
        defaults.STORE
    )
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")] = False
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Warnings and errors only.")] = False
    verbose: Annotated[bool, typer.Option("-v", "--verbose", help="More messages; tracebacks.")] = False

    @cached_property
    def console(self) -> Console:
        """The console that takes messages."""
        return Console(quiet=self.quiet, verbose=self.verbose)

    @cached_property
    def results(self) -> "Store":
        """The store of results."""
        from npred.store import Store

        return Store(self.store)

    def show(self, document: dict[str, Any], text: Callable[[], Any]) -> None:
        """The document with --json, else the text for people."""
        self.console.json(document) if self.json else self.console.out(text())


@dataclass(frozen=True)
class Planned(Common):
    """Flags of the commands that read a pipeline file."""

    pipeline_name: Annotated[
        str | None,
        typer.Argument(
            metavar="PIPELINE",
            show_default=f"{defaults.PIPELINE_VARIABLE}, {defaults.PIPELINE}, or the only TOML file here",
            help="A pipeline file, or the name of one that is part of npred, as smoke.",
            autocompletion=completion.pipelines,
        ),
    ] = None
    set: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Override a key, as in train.fno.epochs=5; repeatable.",
            autocompletion=completion.settings,
        ),
    ] = None
    device: Annotated[str, typer.Option(help="auto, cpu, cuda or cuda:N.", autocompletion=completion.devices)] = "auto"
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes and threads; all cores by default.")] = None

    @cached_property
    def pipeline(self) -> Path:
        """The pipeline file."""
        return defaults.pipeline(self.pipeline_name)

    @cached_property
    def config(self) -> "Pipeline":
        """The pipeline, resolved."""
        from npred import config

        return config.load(self.pipeline, self.set)

    def planner(self, forced: frozenset[str] = frozenset(), borrows: bool = False) -> "Planner":
        """The pipeline against the store; `borrows` as for Planner."""
        from npred.parallel import devices
        from npred.pipeline import Planner

        return Planner(self.config, self.results, devices.resolve(self.device), forced, borrows)


@dataclass(frozen=True)
class Running(Planned):
    """Flags of the commands that run something."""

    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would run, and run nothing.")] = False
    executor: Annotated[
        str,
        typer.Option(
            envvar=defaults.EXECUTOR_VARIABLE, metavar="local|dask:ADDRESS", help="Where batches of rollouts run."
        ),
    ] = "local"


@dataclass(frozen=True)
class Work(Running):
    """Flags of the commands that run stages."""

    force: Annotated[bool, typer.Option("--force", help="Run the named stages even if the store has them.")] = False
    wide: Annotated[bool, typer.Option("--wide", help="Print all that was measured, in tables of any width.")] = False
    tensorboard: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write the epochs of trainings as event files there.")
    ] = None


def writable(path: Path) -> Path:
    """The path. Raises ConfigError where no file can be written there."""
    if not path.parent.is_dir() or (path.exists() and not path.is_file()):
        raise ConfigError(f"{path}: expected a file that can be written, in a folder that is there; make {path.parent}")
    return path


def writable_folder(path: Path, of: str) -> Path:
    """The path. Raises ConfigError where it is no folder, and none can be made there."""
    if path.exists() and not path.is_dir():
        raise ConfigError(f"--output: expected a folder for the {of}, {path} is a file; choose another")
    return path


def parameters(options: type[Common]) -> list[inspect.Parameter]:
    """The fields of an options class as parameters of a command: the pipeline file first, then the flags."""
    hints = get_type_hints(options, include_extras=True)
    ordered = sorted(fields(options), key=lambda field: field.name != "pipeline_name")
    kind = inspect.Parameter.KEYWORD_ONLY
    return [inspect.Parameter(f.name, kind, default=f.default, annotation=hints[f.name]) for f in ordered]
