"""`npred reproduce`: published experiments, from the store or measured now."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType

from npred.cli.options import Common
from npred.errors import ConfigError, MissingError
from npred.pipeline import Runner, experiments
from npred.pipeline.experiments import ExperimentPlanner
from npred.results import Reproduced
from npred.stages.reproduce import load

PAGE = "reproduce.html"


def reproduce(
    options: Common, names: list[str] | None, listed: bool, numerical: bool, force: bool, output: Path | None
) -> None:
    """The rows of these experiments, of all by default; with `listed` what there is.

    Raises ConfigError for a name that there is none of, before anything is measured, MissingError without experiments.
    """
    forced = frozenset({experiments.STAGE} if force else ())
    chosen = list(dict.fromkeys(names or experiments.names()))
    planners = [ExperimentPlanner(name, options.results, forced) for name in chosen]
    for planner in planners:
        planner.check([])
    rows = package("rows")
    if listed:
        _list(options, chosen)
        return
    options.results.adopt()
    results = [rows.joined(_parts(options, planner, not numerical), not numerical) for planner in planners]
    document = {"experiments": [result.json_object() for result in results]}
    options.show(document, lambda: rows.summary(results, options.console.width))
    _publish(options, results, output, whole=chosen == experiments.names() and not numerical)


def summary(document: dict[str, object], width: int | None = None) -> str:
    """A result's JSON as a table. Raises StoreError where it is none, ConfigError without its experiment."""
    return package("rows").summary([Reproduced.of(document, "result")], width)


def package(module: str) -> ModuleType:
    """A module of npred_experiments. Raises MissingError without that package."""
    try:
        return import_module(f"npred_experiments.{module}")
    except ModuleNotFoundError:
        raise MissingError(f"{experiments.STAGE}: {experiments.ABSENT}") from None


def _parts(options: Common, planner: ExperimentPlanner, trained: bool) -> list[Reproduced]:
    """An experiment's parts, one after the other: a time is taken of a machine that does nothing else."""
    outcomes = Runner(options.console, jobs=1).run(planner, planner.nodes(trained))
    return [Reproduced.read(outcome.artifact.folder) for outcome in outcomes]


def _publish(options: Common, results: Sequence[Reproduced], output: Path | None, whole: bool) -> None:
    """Write the page to `output`, by default, where the results are `whole`, into the store, and say where it is.

    Raises ConfigError for an `output` that cannot be written.
    """
    if output is None and not whole:
        return
    path, page = output or options.results.root / PAGE, package("page")
    text = page.markdown(results) if path.suffix == ".md" else page.page(results)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: expected a file that can be written, got: {error.strerror}; name another") from None
    options.console.note(f"page: {path}")


def _list(options: Common, names: list[str]) -> None:
    """The experiments with their titles and sources."""
    loaded = {name: load(name) for name in names}
    rows = [[name, experiment.title, experiment.source] for name, experiment in loaded.items()]
    document = {"experiments": [dict(zip(("name", "title", "source"), row, strict=True)) for row in rows]}
    options.show_table(document, ["experiment", "title", "source"], rows)
