"""The rows of one published experiment, and their table."""

import math
from collections.abc import Sequence
from functools import partial

from npred import registry
from npred.results import Reproduced, ReproducedRow
from npred.stages.reproduce.experiment import Experiment, Measured, PublishedNumber
from npred.terminal.console import columns

NOTHING = Measured(None, None)
HEADER = ["experiment", "predictor", "metric", "published", "as published", "as meant"]
UNPRINTED = 6  # decimals of a number that the source does not print


def load(name: str) -> Experiment:
    """The experiment of that name. Raises ConfigError, in one line, for another name."""
    return registry.EXPERIMENTS.load("reproduce", name)


def run(name: str) -> Reproduced:
    """An experiment's numerical rows, measured now; its networks' published rows beside them."""
    experiment = load(name)
    measured = experiment.measure()
    numerical = [_row(row, measured[row.metric]) for row in experiment.numerical]
    return Reproduced(name=name, rows=[*numerical, *(_row(row, NOTHING) for row in experiment.networks)])


def _row(published: PublishedNumber, measured: Measured) -> ReproducedRow:
    return ReproducedRow(
        predictor=published.predictor, metric=published.metric, published=published.value,
        as_published=_finite(measured.as_published), as_meant=_finite(measured.as_meant),
    )  # fmt: skip


def _finite(value: float | None) -> float | None:
    """None for a loop that has left the finite numbers."""
    return value if value is not None and math.isfinite(value) else None


def without_networks(result: Reproduced) -> Reproduced:
    """The numerical rows alone."""
    networks = {(row.predictor, row.metric) for row in load(result.name).networks}
    rows = [row for row in result.rows if (row.predictor, row.metric) not in networks]
    return Reproduced(name=result.name, rows=rows)


def summary(result: Reproduced, width: int | None = None) -> str:
    """One experiment as a table."""
    return table([result], width)


def table(results: Sequence[Reproduced], width: int | None = None) -> str:
    """All rows for people, each number with the digits that its source prints."""
    return columns(HEADER, [cells for result in results for cells in rows(result)], width, numbers=HEADER[3:])


def rows(result: Reproduced) -> list[list[str]]:
    """The cells of each row; a number that is not there is a dash."""
    experiment = load(result.name)
    printed = {(row.predictor, row.metric): row.digits for row in [*experiment.numerical, *experiment.networks]}
    return [_cells(result.name, row, printed.get((row.predictor, row.metric), "")) for row in result.rows]


def _cells(name: str, row: ReproducedRow, digits: str) -> list[str]:
    write = partial(_written, like=digits)
    return [name, row.predictor, row.metric, digits or "–", write(row.as_published), write(row.as_meant)]


def _written(value: float | None, like: str) -> str:
    """A number with as many decimals as the printed one has; a tiny one by its power of ten."""
    if value is None:
        return "–"
    mantissa, _, power = like.partition("e")
    decimals = len(mantissa.partition(".")[2]) if like else UNPRINTED
    if power or (value and abs(value) < 0.5 * 10.0**-decimals):
        return f"{value:.{min(decimals, 2) if not power else decimals}e}"
    return f"{value:.{decimals}f}"
