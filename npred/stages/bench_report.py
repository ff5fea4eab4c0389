"""A benchmark for people: its rows as a table, when a network pays, and what of the tails is the machine's own."""

from typing import Any

COLUMNS = ("predictor", "runtime", "dx", "batch", "median", "p95", "p99.9", "max", "ε sup", "× published", "× euler")
TIMES = ("median_us", "p95_us", "p999_us", "max_us")
RATIOS = ("speedup_published", "speedup_compiled")


def summary(result: dict[str, Any]) -> Any:
    """The rows as a table, and the sentences on them."""
    from rich.console import Group
    from rich.table import Table

    title = f"microseconds a call, up to {result['calls']} calls, {result['hardware']['cpu']}"
    table = Table(title=title)
    for column in COLUMNS:
        table.add_column(column, justify="left" if column in ("predictor", "runtime") else "right")
    for row in result["rows"]:
        table.add_row(*_cells(row))
    return Group(table, *sentences(result))


def sentences(result: dict[str, Any]) -> list[str]:
    """When a network pays, one a network; then the machine."""
    return [*(found["sentence"] for found in result["crossover"]), result["stops"]["sentence"]]


def stopped(stops: dict[str, float]) -> str:
    """What of the tails is the machine's own; see timing.stops."""
    if not stops["per_s"]:
        return "The machine did not stop a thread that only reads the clock: the tails are the predictors' own."
    often = f"{stops['per_s']:.0f} times a second, for {stops['median_us']:.0f} µs in the median"
    long = f"{1000 / stops['per_s']:.1f} µs"
    return f"The machine stops a thread that only reads the clock {often}: from {long} a call on, p99.9 includes that."


def _cells(row: dict[str, Any]) -> list[str]:
    times = [_short(row[key]) for key in TIMES]
    ratios = ["" if row[key] is None else f"{row[key]:.3g}" for key in RATIOS]
    return [_name(row), _runtime(row), f"{row['dx']:.3g}", str(row["batch"]), *times, _error(row), *ratios]


def _name(row: dict[str, Any]) -> str:
    return f"{row['predictor']} (ε of {row['matches']})" if row["matches"] not in (None, "front") else row["predictor"]


def _runtime(row: dict[str, Any]) -> str:
    if row["copies"] is None:
        return row["runtime"]
    return f"{row['runtime']}, {row['device']}, {'with' if row['copies'] else 'without'} copies"


def _error(row: dict[str, Any]) -> str:
    return "∞" if row["eps_sup"] is None else f"{row['eps_sup']:.2e}"


def _short(microseconds: float) -> str:
    return f"{microseconds:.1f}" if microseconds < 1000 else f"{microseconds:.0f}"
