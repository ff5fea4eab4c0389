"""An evaluation for the terminal: errors, radii and loops that converge, in short and in full."""

from npred.lab.config.results import Evaluated
from npred.lab.stages.report import tables


def summary(result: Evaluated, width: int | None = None) -> str:
    """The samples of the errors, and the table of each predictor."""
    return f"{_title(result)}\n\n{tables.predictors(result).terminal(width)}"


def details(result: Evaluated, width: int | None = None) -> str:
    """All tables of the page on errors and loops, wider than most screens."""
    shown = tables.accuracy(result), tables.kinds(result), tables.loops(result), tables.scenarios(None, result)
    texts = [f"{table.title}\n{table.terminal(width)}" for table in shown if table]
    return "\n\n".join([_title(result), *texts])


def _title(result: Evaluated) -> str:
    rows = f"{result.held_out} held-out samples ({result.held_out_kind}), {result.fresh} fresh ones"
    return f"{result.plant}: {rows}, and closed loops"
