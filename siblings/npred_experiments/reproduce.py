"""`npred reproduce`: published experiments, from the store or measured now."""

from pathlib import Path

from npred.base.errors import ConfigError
from npred.cli.options import Common
from npred.lab.scheduler.runner import Runner
from npred_experiments import EXPERIMENTS, page, rows
from npred_experiments.experiment import Reproduced, load
from npred_experiments.planner import STAGE, ExperimentPlanner

PAGE = "reproduce.html"


def reproduce(
    options: Common, names: list[str] | None, listed: bool, numerical: bool, force: bool, output: Path | None
) -> None:
    """The rows of these experiments, of all by default; with `listed` their names.

    The page goes to `output`, or into the store where the results are those of all. Raises ConfigError for a name that
    there is none of, before anything is measured, and for an `output` that cannot be written.
    """
    chosen = list(dict.fromkeys(names or EXPERIMENTS.names()))
    planners = [ExperimentPlanner(name, options.results, frozenset({STAGE} if force else ())) for name in chosen]
    for planner in planners:
        planner.check([])
    if listed:
        loaded = {name: load(name) for name in chosen}
        table = [[name, experiment.title, experiment.source] for name, experiment in loaded.items()]
        document = {"experiments": [dict(zip(("name", "title", "source"), row, strict=True)) for row in table]}
        options.show_table(document, ["experiment", "title", "source"], table)
        return
    options.results.adopt()
    runner, results = Runner(options.console, jobs=1), []  # a time is taken of a machine that does nothing else
    for planner in planners:
        outcomes = runner.run(planner, planner.nodes(trained=not numerical))
        parts = [Reproduced.read(outcome.artifact.folder) for outcome in outcomes]
        results.append(rows.joined(parts, networks=not numerical))
    document = {"experiments": [result.json_object() for result in results]}
    options.show(document, lambda: rows.summary(results, options.console.width))
    whole = chosen == EXPERIMENTS.names() and not numerical
    if output is None and not whole:
        return
    path = output or options.results.root / PAGE
    text = page.markdown(results) if path.suffix == ".md" else page.page(results)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: expected a file that can be written, got: {error.strerror}; name another") from None
    options.console.note(f"page: {path}")
