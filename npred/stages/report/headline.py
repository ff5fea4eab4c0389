"""A run in three sentences: the error, the closed loop, the time of a call."""

from typing import Any

from npred.config import FROZEN
from npred.figures.evaluation_data import OF
from npred.figures.latency import label
from npred.figures.style import short, words
from npred.registry import METHODS
from npred.stages.report.tables import converged
from npred.terminal.progress_bars import counted

Row = dict[str, Any]


def summary(evaluated: Row, benched: Row, networks: list[str], adaptation: str) -> list[str]:
    """The three, each with its numbers."""
    return [_errors(evaluated, networks), _loops(evaluated["models"], networks, adaptation), _speed(benched, networks)]


def _of_delay(adaptation: str) -> str:
    return "with the delay estimate held" if adaptation == FROZEN else "with a delay that the controller does not know"


def _errors(evaluated: Row, networks: list[str]) -> str:
    rows = {words(name): evaluated["models"][name] for name in networks}
    errors = [f"{short(row['eps_sup'])} for the {name} (mean square {short(row['mse'])})" for name, row in rows.items()]
    own, *others = evaluated["kinds"]
    samples = f"{evaluated['held_out']:,} held-out samples of {OF[own]}"
    others = [_of_kind(kind, evaluated["kinds"][kind]["rows"], list(rows.values())) for kind in others]
    return "; ".join([f"On {samples} the largest error of a prediction is {' and '.join(errors)}", *others]) + "."


def _of_kind(kind: str, count: int, rows: list[Row]) -> str:
    errors = " and ".join(short(row["kinds"][kind]["eps_sup"]) for row in rows)
    return f"on {count:,} of {OF[kind]} it is {errors}"


def _loops(models: dict[str, Row], networks: list[str], adaptation: str) -> str:
    counts = [f"{converged(models[n])} with the {words(n)} (median radius {short(models[n]['radius']['median'])})"
             for n in networks]  # fmt: skip
    counts.append(f"{converged(models['numerical'])} with the numerical predictor")
    if adaptation != FROZEN:
        counts.append(f"{converged(models['no_adaptation'])} without adaptation")
    *first, last = counts
    cases = models["numerical"]["radius"]["cases"]
    return f"Of {cases} closed loops {_of_delay(adaptation)}, {', '.join(first)} and {last} converge."


def _speed(benched: Row, networks: list[str]) -> str:
    single = [row for row in benched["rows"] if row["batch"] == 1 and row["matches"] is None]
    finest = min((row["dx"] for row in single), default=0.0)
    mine = [row for row in single if row["predictor"] in networks and row["dx"] == finest]
    if not mine:
        return "No network was timed."
    row = min(mine, key=lambda row: row["median_us"])
    ratio = row["speedup_published"]  # None where inputs have delays of their own, which that predictor has no word for
    over = "" if ratio is None else f", {ratio:,.0f} times faster than interpreted O(nx²) sums"
    text = f"A call of the {label(row)}, takes {row['median_us']:.1f} µs at dx = {finest:.3g}{over}"
    return f"{text}{_against_numerics(benched, row['predictor'])}."


def _against_numerics(benched: Row, network: str) -> str:
    crossovers = [one for one in benched["crossover"] if one["predictor"] == network]
    if not crossovers:
        return ""
    one = crossovers[0]
    steps = counted(one["best_steps"], "steps")
    numerical = METHODS.label(one["best"])
    return f"; {numerical} on {steps} is as accurate in {one['best_us']:.1f} µs"
