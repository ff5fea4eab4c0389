"""`npred reproduce`: published experiments, from the store or measured now."""

from collections.abc import Sequence
from pathlib import Path

from npred import registry
from npred.cli.options import Common
from npred.errors import ConfigError
from npred.pipeline import reproduction
from npred.pipeline.reproduction import Reproduction
from npred.results import Reproduced
from npred.terminal.console import columns

PAGE = "reproduce.html"


def reproduce(
    options: Common, names: list[str] | None, listed: bool, numerical: bool, force: bool, output: Path | None
) -> None:
    """The rows of these experiments, of all by default; with `listed` what there is.

    Raises ConfigError for a name that there is none of, before anything is measured.
    """
    chosen = list(dict.fromkeys(names or registry.EXPERIMENTS.names()))
    for name in chosen:
        reproduction.question(name)
    if listed:
        _list(options, chosen)
        return
    from npred.stages.reproduce import reproduce as stage

    store = Reproduction(options.results, options.console, force)
    results = [store.result(name, trained=not numerical) for name in chosen]
    document = {"experiments": [result.json_object() for result in results]}
    options.show(document, lambda: stage.summary(results, options.console.width))
    _publish(options, results, output, whole=chosen == registry.EXPERIMENTS.names() and not numerical)


def _publish(options: Common, results: Sequence[Reproduced], output: Path | None, whole: bool) -> None:
    """Write the page to `output`, by default, where the results are `whole`, into the store, and say where it is.

    Raises ConfigError for an `output` that cannot be written.
    """
    from npred.stages.report import reproduced

    if output is None and not whole:
        return
    path = output or options.results.root / PAGE
    text = reproduced.markdown(results) if path.suffix == ".md" else reproduced.page(results)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: expected a file that can be written, got: {error.strerror}; name another") from None
    options.console.note(f"page: {path}")


def _list(options: Common, names: list[str]) -> None:
    """The experiments with their titles and sources."""
    from npred.stages.reproduce import reproduce as stage

    experiments = {name: stage.load(name) for name in names}
    rows = [[name, experiment.title, experiment.source] for name, experiment in experiments.items()]
    document = {"experiments": [dict(zip(("name", "title", "source"), row, strict=True)) for row in rows]}
    options.show(document, lambda: columns(["experiment", "title", "source"], rows, options.console.width))
