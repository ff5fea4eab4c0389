"""The rows of experiments: the parts of each as one, and as text."""

from collections.abc import Sequence

from npred.lab.report.terminal.console import columns
from npred_experiments.experiment import (
    AS_MEANT,
    Experiment,
    PredictionTime,
    Reproduced,
    TrainedForLoop,
    load,
)

HEADER = ["experiment", "predictor", "metric", "published", "as published", "as meant"]
TIMES_HEADER = ["experiment", "predictor", "of one prediction", "published, ms", "here, ms", "sup error"]
ON_ITS_GRID = "on its loop's grid"  # the setting of a network of which no time is published
UNPRINTED = 6  # decimals of a number that the source does not print


def joined(parts: Sequence[Reproduced], networks: bool) -> Reproduced:
    """An experiment's parts as one; the published numbers of `networks` stand there too where none was trained."""
    experiment = load(parts[0].name)
    rows_of = {(row.predictor, row.metric): row for part in parts for row in part.rows}
    published = [*experiment.numerical, *(experiment.networks if networks else ())]
    rows = [rows_of.get((row.predictor, row.metric)) or row.row() for row in published]
    trained = [each for part in parts for each in part.trained]
    clocked = [each for part in parts for each in part.times]
    return Reproduced(
        name=parts[0].name, rows=rows, trained=trained, times=_times(experiment, clocked, trained) if networks else []
    )


def _times(
    experiment: Experiment, clocked: Sequence[PredictionTime], trained: Sequence[TrainedForLoop]
) -> list[PredictionTime]:
    """The published times beside those that were taken here, and then those of which none is published."""
    settings = {each.predictor: each.setting for each in reversed(experiment.times)}  # the first of each
    networks = [
        PredictionTime(
            predictor=each.network, setting=settings.get(each.network, ON_ITS_GRID), ms=each.ms, error=each.eps_sup
        )
        for each in trained
        if each.loop == AS_MEANT
    ]
    here = {(each.predictor, each.setting): each for each in [*clocked, *networks]}
    printed = {(each.predictor, each.setting): each.ms for each in experiment.times}
    rows = []
    for key in dict.fromkeys([*printed, *here]):
        row = here.get(key) or PredictionTime(predictor=key[0], setting=key[1], ms=None, error=None)
        rows.append(row.model_copy(update={"published_ms": printed.get(key)}))
    return rows


def summary(results: Sequence[Reproduced], width: int | None = None) -> str:
    """Everything for people: the rows, then the times of single predictions, if any were taken."""
    return "\n\n".join(filter(None, (table(results, width), times_table(results, width))))


def table(results: Sequence[Reproduced], width: int | None = None) -> str:
    """All rows, each number with the digits that its source prints."""
    return columns(HEADER, [row for result in results for row in cells_of(result)], width, numbers=HEADER[3:])


def times_table(results: Sequence[Reproduced], width: int | None = None) -> str:
    """The times of single predictions for people; empty where there are none."""
    times = [
        [result.name, each.predictor, each.setting]
        + ["–" if value is None else f"{value:.3g}" for value in (each.published_ms, each.ms, each.error)]
        for result in results
        for each in result.times
    ]
    return columns(TIMES_HEADER, times, width, numbers=TIMES_HEADER[3:]) if times else ""


def cells_of(result: Reproduced) -> list[list[str]]:
    """The cells of each row; a number that is not there is a dash."""
    experiment, cells = load(result.name), []
    printed = {(row.predictor, row.metric): row.digits for row in [*experiment.numerical, *experiment.networks]}
    for row in result.rows:
        digits = printed.get((row.predictor, row.metric), "")
        written = [_written(value, digits) for value in (row.as_published, row.as_meant)]
        cells.append([result.name, row.predictor, row.metric, digits or "–", *written])
    return cells


def _written(value: float | None, like: str) -> str:
    """A number with as many decimals as the printed one has; a tiny one by its power of ten."""
    if value is None:
        return "–"
    mantissa, _, power = like.partition("e")
    decimals = len(mantissa.partition(".")[2]) if like else UNPRINTED
    if power or (value and abs(value) < 0.5 * 10.0**-decimals):
        return f"{value:.{min(decimals, 2) if not power else decimals}e}"
    return f"{value:.{decimals}f}"
