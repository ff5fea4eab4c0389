"""A run in three sentences: the error, the closed loop, the time of a call."""

from typing import Any

from npred.figures.latency import label
from npred.figures.style import short, words

Row = dict[str, Any]


def summary(evaluated: Row, benched: Row, networks: list[str]) -> list[str]:
    """The three, each with its numbers."""
    return [_errors(evaluated, networks), _loops(evaluated["models"], networks), _speed(benched, networks)]


def _errors(evaluated: Row, networks: list[str]) -> str:
    rows = {words(name): evaluated["models"][name] for name in networks}
    found = [f"{row['eps_sup']:.2g} for the {name} (mean square {short(row['mse'])})" for name, row in rows.items()]
    return f"On {evaluated['held_out']:,} held-out samples the largest error of a prediction is {' and '.join(found)}."


def _loops(models: dict[str, Row], networks: list[str]) -> str:
    found = [f"{_home(models[n])} with the {words(n)} (median radius {short(models[n]['radius']['median'])})"
             for n in networks]  # fmt: skip
    frozen = f"{_home(models['numerical'])} with the numerical predictor, and {_home(models['no_adaptation'])} without"
    return (
        f"Of {models['numerical']['radius']['cases']} closed loops with a delay that the controller does not know, "
        f"{', '.join(found)}, {frozen} adaptation converge."
    )


def _home(row: Row) -> int:
    """How many of the cases converge."""
    return round(row["radius"]["converged"] * row["radius"]["cases"])


def _speed(benched: Row, networks: list[str]) -> str:
    single = [row for row in benched["rows"] if row["batch"] == 1 and row["matches"] is None]
    finest = min((row["dx"] for row in single), default=0.0)
    mine = [row for row in single if row["predictor"] in networks and row["dx"] == finest]
    if not mine:
        return "No network was timed."
    row = min(mine, key=lambda row: row["median_us"])
    over = f"{row['speedup_published']:,.0f} times faster than the published predictor"
    text = f"A call of the {label(row)}, takes {row['median_us']:.1f} µs at dx = {finest:.3g}, {over}"
    return f"{text}{_against_numerics(benched, row['predictor'])}."


def _against_numerics(benched: Row, network: str) -> str:
    found = [one for one in benched["crossover"] if one["predictor"] == network]
    if not found:
        return ""
    one = found[0]
    numerical = label({"predictor": one["best"]})
    return f"; {numerical} on {one['best_steps']} steps is as accurate in {one['best_us']:.1f} µs"
