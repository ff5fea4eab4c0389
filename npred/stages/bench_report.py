"""A benchmark for people and papers: a table, a LaTeX table, and the figure of latency against error."""

from pathlib import Path
from typing import Any

from npred.stages import drawing

COLUMNS = ("predictor", "runtime", "dx", "batch", "median", "p95", "p99.9", "max", "ε sup", "× published", "× euler")
TIMES = ("median_us", "p95_us", "p999_us", "max_us")
RATIOS = ("speedup_published", "speedup_compiled")
MARKERS = "osD^vP*X<>"

LATEX = r"""% needs \usepackage{booktabs}
\begin{tabular}{ll@alignment}
\toprule
predictor & runtime & @heads \\
\midrule
@lines
\bottomrule
\end{tabular}
"""


def write(folder: Path, result: dict[str, Any]) -> None:
    """bench.tex, front.svg and front.png."""
    (folder / "bench.tex").write_text(latex(result["rows"]), encoding="utf-8")
    draw(folder, result["rows"])


def summary(result: dict[str, Any]) -> Any:
    """The rows as a table, and when a network pays."""
    from rich.console import Group
    from rich.table import Table

    title = f"microseconds a call, up to {result['calls']} calls, {result['hardware']['cpu']}"
    table = Table(title=title)
    for column in COLUMNS:
        table.add_column(column, justify="left" if column in ("predictor", "runtime") else "right")
    for row in result["rows"]:
        table.add_row(*_cells(row))
    return Group(table, *(found["sentence"] for found in result["crossover"]))


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


def latex(rows: list[dict[str, Any]]) -> str:
    """A booktabs table of batch 1: median microseconds and error at each dx."""
    table = [row for row in rows if row["batch"] == 1 and row["matches"] is None]
    steps = sorted({row["dx"] for row in table}, reverse=True)
    found = {(_name(row), _runtime(row), row["dx"]): row for row in table}
    lines = []
    for name, runtime in dict.fromkeys((name, runtime) for name, runtime, _ in found):
        cells = [_pair(found.get((name, runtime, dx))) for dx in steps]
        lines.append(" & ".join([name.replace("_", r"\_"), runtime, *cells]) + r" \\")
    heads = " & ".join(f"$dx = {dx:.3g}$: \\textmu s & $\\varepsilon$" for dx in steps)
    text = LATEX.replace("@alignment", "rr" * len(steps)).replace("@heads", heads)
    return text.replace("@lines", "\n".join(lines))


def _pair(row: dict[str, Any] | None) -> str:
    if row is None:
        return "--- & ---"
    if row["eps_sup"] is None:
        return rf"{_short(row['median_us'])} & $\infty$"
    mantissa, exponent = f"{row['eps_sup']:.1e}".split("e")
    return rf"{_short(row['median_us'])} & ${mantissa} \cdot 10^{{{int(exponent)}}}$"


def draw(folder: Path, rows: list[dict[str, Any]]) -> None:
    """Write front.svg and front.png: each predictor's median at batch 1 against its error, a line over its grids."""
    figure = drawing.figure(6.4, 4.4)
    axis = figure.subplots()
    series: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        if row["batch"] == 1 and row["matches"] in (None, "front") and row["eps_sup"] is not None:
            series.setdefault(f"{drawing.words(row['predictor'])}, {_runtime(row)}", []).append(row)
    for number, (label, points) in enumerate(series.items()):
        points = sorted(points, key=lambda row: row["dx"])
        look = {"color": drawing.COLOURS[number % 7], "marker": MARKERS[number % 10], "markersize": 4, "linewidth": 1.0}
        axis.plot([p["eps_sup"] for p in points], [p["median_us"] for p in points], label=label, **look)
    axis.set(xscale="log", yscale="log", xlabel="sup error (state units)", ylabel="median of a call (µs)")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    drawing.save(figure, folder, "front")
