"""The flags that commands share, each declared once, and how a flag is declared."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer.models import ArgumentInfo, OptionInfo

from npred.base import defaults
from npred.base.errors import ConfigError
from npred.lab.report.terminal.console import Console, columns

if TYPE_CHECKING:  # pydantic and filelock come with these, which `npred --help` has no use for
    from npred.lab.config import Pipeline
    from npred.lab.scheduler.plan import Planner
    from npred.lab.store import Store


def flag(
    help: str, *names: str, word: str | None = None, least: float | None = None, variable: str | None = None
) -> OptionInfo:
    """A flag for typer: `word` for its value, the `least` number, an environment `variable` for its default."""
    return typer.Option(*names, help=help, metavar=word, min=least, envvar=variable)


def argument(word: str | None, help: str, default: bool | str = True) -> ArgumentInfo:
    """An argument for typer, as `flag`; `default` names in words the value without it."""
    return typer.Argument(metavar=word, help=help, show_default=default)


@dataclass(frozen=True)
class Common:
    """Flags of every command."""

    store: Annotated[Path, flag("The folder of the store.", variable=defaults.STORE_VARIABLE)] = defaults.STORE
    json: Annotated[bool, flag("Print one JSON document on stdout.", "--json")] = False
    quiet: Annotated[bool, flag("Print only warnings and errors.", "-q", "--quiet")] = False
    verbose: Annotated[bool, flag("Print more messages, and tracebacks.", "-v", "--verbose")] = False

    @cached_property
    def console(self) -> Console:
        """The console that takes messages."""
        return Console(quiet=self.quiet, verbose=self.verbose)

    @cached_property
    def results(self) -> "Store":
        from npred.lab.store import Store

        return Store(self.store)

    def show(self, document: Mapping[str, object], text: Callable[[], str]) -> None:
        """The document with --json, else the text for people."""
        self.console.json(document) if self.json else self.console.out(text())

    def show_table(self, document: Mapping[str, object], header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """The document with --json, else a table for people."""
        self.show(document, lambda: columns(header, rows, self.console.width))


FALLBACKS = f"{defaults.PIPELINE_VARIABLE}, {defaults.PIPELINE}, or the only TOML file here"
PIPELINE = argument(
    "PIPELINE", "A pipeline file, or the name of a pipeline that npred contains, as smoke.", default=FALLBACKS
)
OVERRIDES = flag("Override a key, as train.fno.epochs=5; repeatable.", "--set", word="KEY=VALUE")


@dataclass(frozen=True)
class Piped(Common):
    """Flags of the commands that read a pipeline file."""

    pipeline_name: Annotated[str | None, PIPELINE] = None
    set: Annotated[list[str] | None, OVERRIDES] = None

    @cached_property
    def pipeline(self) -> Path:
        """The pipeline file; one that was not named is said."""
        path = defaults.pipeline(self.pipeline_name)
        if self.pipeline_name is None:
            self.console.note(f"pipeline {path}")
        return path

    @cached_property
    def config(self) -> "Pipeline":
        from npred.lab import config

        return config.load(self.pipeline, self.set)


@dataclass(frozen=True)
class Planned(Piped):
    """Flags of the commands that compare a pipeline with the store."""

    device: Annotated[str, flag("Device of the networks: auto, cpu, cuda or cuda:N.")] = "auto"

    def planner(self, forced: frozenset[str] = frozenset(), borrows: bool = False) -> "Planner":
        """The pipeline against the store; `borrows` as for Planner."""
        from npred.base import devices
        from npred.lab.scheduler.plan import Planner

        return Planner(self.config, self.results, devices.resolve(self.device), forced, borrows)


@dataclass(frozen=True)
class Working(Planned):
    """Flags of the commands that work for some time."""

    jobs: Annotated[int | None, flag("Number of processes and threads; by default all cores.", least=1)] = None


@dataclass(frozen=True)
class Staged(Working):
    """Flags of a command that brings the results of stages."""

    force: Annotated[bool, flag("Run again even if the store has the result.", "--force")] = False


@dataclass(frozen=True)
class Running(Working):
    """Flags of the commands that can run elsewhere, or only say what would run."""

    dry_run: Annotated[bool, flag("Say what would run, and run nothing.", "--dry-run")] = False
    executor: Annotated[
        str, flag("Where batches of rollouts run.", word="local|dask:ADDRESS", variable=defaults.EXECUTOR_VARIABLE)
    ] = "local"


@dataclass(frozen=True)
class Work(Running, Staged):
    """Flags of the commands that run stages."""

    wide: Annotated[bool, flag("Print everything that was measured, in tables of any width.", "--wide")] = False


@dataclass(frozen=True)
class Trains(Work):
    """Flags of the commands that may train."""

    tensorboard: Annotated[Path | None, flag("Write TensorBoard event files of the training there.", word="DIR")] = None


WATCHDOG = flag("How long the controller waits for a sample before it holds U, or sends 0.", word="TIME[:hold|zero]")


@dataclass(frozen=True)
class Exporting(Common):
    """Flags of every `npred export`."""

    set: Annotated[list[str] | None, OVERRIDES] = None
    nx: Annotated[int | None, flag("Number of nodes; by default 101, for a controller as in evaluate.")] = None


@dataclass(frozen=True)
class ExportingLoop(Exporting):
    """Flags of `npred export` of a controller: the parts of the pipeline's loop that differ there."""

    predictor: Annotated[str, flag("A numerical predictor, as rk4, instead of a network.", word="METHOD")] = ""
    actuator: Annotated[str, flag("Where u comes from; by default as in evaluate.", word="measured|history")] = ""
    observer: Annotated[
        str, flag("Observer, as kind=ekf,offset=true; by default as in evaluate.", word="KEY=VALUE,…")
    ] = ""
    safety: Annotated[
        str, flag("Safety filter, as margin=0.1,delay=0.02; by default as in evaluate.", word="KEY=VALUE,…")
    ] = ""
    guard: Annotated[float | None, flag("Largest error of U that the guard accepts; by default as in evaluate.")] = None
    watchdog: Annotated[str, WATCHDOG] = ""
    max_sample_age: Annotated[
        float | None, flag("Oldest sample that is used; by default 50 control steps.", word="TIME")
    ] = None

    @property
    def overrides(self) -> list[str]:
        """Those of --set, and the keys of [evaluate] that have a flag. Raises ConfigError for a flag without a key."""
        flags = [f"evaluate.actuator={self.actuator}"] if self.actuator else []
        for key, text in (("observer", self.observer), ("safety", self.safety)):
            pairs = re.split(r",(?=\w+=)", text) if text else []
            if not all(re.match(r"\w+=", pair) for pair in pairs):
                raise ConfigError(f"--{key}: expected KEY=VALUE,…, got {text!r}; name the keys of evaluate.{key}")
            flags += [f"evaluate.{key}.{pair}" for pair in pairs]
        return [*(self.set or []), *flags]


def writable(path: Path) -> Path:
    """The path. Raises ConfigError where no file can be written there."""
    if not path.parent.is_dir() or (path.exists() and not path.is_file()):
        raise ConfigError(f"{path}: expected a file that can be written, in a folder that is there; make {path.parent}")
    return path


def rewritable(path: Path, command: str) -> str:
    """The line that a pipeline begins with which `npred COMMAND` writes. Raises ConfigError for a file without it."""
    head = f"# made by npred {command}"
    if path.exists() and not path.read_text("utf-8", "replace").startswith(head):
        raise ConfigError(f"{path}: expected no such file, or one that npred {command} made; name another by -o")
    return head


def drawable(path: Path) -> Path:
    """The path. Raises ConfigError where no figure can be written there."""
    from npred.lab.report.figures.figure import FORMATS

    if path.suffix[1:] not in FORMATS:
        raise ConfigError(f"--figure: expected a file that ends in {', '.join(FORMATS)}, got {path}; name another")
    return writable(path)


def writable_folder(path: Path, of: str) -> Path:
    """The path. Raises ConfigError where it is no folder, and none can be made there."""
    if path.exists() and not path.is_dir():
        raise ConfigError(f"--output: expected a folder for the {of}, {path} is a file; choose another")
    return path
