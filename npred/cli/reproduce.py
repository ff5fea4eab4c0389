"""`npred reproduce`: published experiments, from the store or measured now."""

from npred import registry
from npred.cli.options import Common
from npred.pipeline import reproduction
from npred.pipeline.reproduction import Reproduction
from npred.terminal.console import columns


def reproduce(options: Common, names: list[str] | None, listed: bool, numerical: bool, force: bool) -> None:
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
    options.show(document, lambda: stage.table(results, options.console.width))


def _list(options: Common, names: list[str]) -> None:
    """The experiments with their titles and sources."""
    from npred.stages.reproduce import reproduce as stage

    experiments = {name: stage.load(name) for name in names}
    rows = [[name, experiment.title, experiment.source] for name, experiment in experiments.items()]
    document = {"experiments": [dict(zip(("name", "title", "source"), row, strict=True)) for row in rows]}
    options.show(document, lambda: columns(["experiment", "title", "source"], rows, options.console.width))
