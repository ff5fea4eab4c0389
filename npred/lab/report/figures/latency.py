"""The time of a predictor call: against its error, against the grid, and its tail."""

from collections.abc import Iterable
from dataclasses import replace
from math import inf, isfinite

from npred.base.registry import METHODS, NETWORKS, RUNTIMES, Entry, Registry
from npred.lab.config.results import PredictorId, ranked
from npred.lab.config.results.bench import CallTimes
from npred.lab.report.figures.figure import Figure, LegendEntry, Panel, curves
from npred.lab.report.figures.style import Axes, LineStyle, colours, log

FAR = 1000  #: times the networks' error: no prediction any more, an unstable step say
INTERPRETED = Registry(  #: how the baselines of pipeline/interpreted.py are drawn
    "baseline",
    "npred.baselines",
    {
        "published": Entry("", "O(nx²) sums, interpreted", ("muted", (1, 1.5), "X")),
        "euler_python": Entry("", "Euler, interpreted", ("muted", (), "P")),
    },
)
NUMERICS = {"python": INTERPRETED, "compiled": METHODS}  # by runtime; all others are of networks
TAIL = {"median_us": "", "p95_us": "|", "p999_us": "|"}


def speed(rows: list[CallTimes]) -> Figure:
    """Latency against error and against dx, a line through the grids of each; median to 99.9 % at the finest dx."""
    single = [row for row in rows if row.batch == 1 and isfinite(row.eps_sup)]
    worst = max((row.eps_sup for row in single if row.is_network), default=inf)
    near = _series(row for row in single if row.eps_sup <= FAR * worst)  # others would leave these no room
    grids = _series(row for row in single if row.matches is None)
    networks = {c.model: c for c in ranked(PredictorId(row.predictor) for row in rows if row.is_network)}
    styles = {name: _style(series[0], networks) for name, series in _series(single).items()}

    def against_error(axis: Axes) -> None:
        for name, series in near.items():
            style, best = styles[name], list[CallTimes]()
            for row in sorted(series, key=lambda row: (row.eps_sup, row.median_us)):
                if not best or row.median_us < best[-1].median_us:  # so a line has no way back
                    best.append(row)
            points = [row.eps_sup for row in series], [row.median_us for row in series]
            axis.plot(*points, style.marker, color=style.colour)
            line = replace(style, marker="").line
            axis.plot([row.eps_sup for row in best], [row.median_us for row in best], **line)
        axis.set_xlabel("sup error ε")
        log(axis, "x", "y")

    def tails(axis: Axes) -> None:
        for position, (name, (finest, *_)) in enumerate(grids.items()):
            style = styles[name]
            axis.plot([finest.median_us, finest.p999_us], [position, position], color=style.colour, linewidth=1.2)
            for key, marker in TAIL.items():
                axis.plot([getattr(finest, key)], [position], marker or style.marker, color=style.colour)
        axis.set(yticks=range(len(grids)), yticklabels=list(grids), xlabel="µs per call")
        axis.invert_yaxis()
        axis.grid(axis="y", visible=False)
        log(axis, "x")

    over_dx = [(styles[name], [r.dx for r in rows], [r.median_us for r in rows]) for name, rows in grids.items()]
    quickest = {name: min(series, key=lambda row: row.median_us) for name, series in near.items()}
    front = [f"{name}: {row.median_us:.3g} µs at error {row.eps_sup:.1e}" for name, row in quickest.items()]
    by_dx = [
        f"{name}: {coarse.median_us:.3g} µs at dx = {coarse.dx:.3g}, {fine.median_us:.3g} µs at {fine.dx:.3g}"
        for name, (fine, coarse) in ((name, (series[0], series[-1])) for name, series in grids.items())
    ]
    tail = [f"{name}: {series[0].median_us:.3g} to {series[0].p999_us:.3g} µs" for name, series in grids.items()]
    caption = (
        "Time of one call at batch 1. Versus ε: the median and the error, one mark per grid. The line of a method "
        "joins the grids that no other grid of it beats in both; lower and further left is better. From the median "
        "to the 99.9 % quantile: at the finest dx; a control loop misses its deadline in the tail."
    )
    panels = [
        Panel("µs per call versus ε", "; ".join(front) + ".", against_error),
        Panel("µs per call versus dx", "; ".join(by_dx) + ".", curves(over_dx, "dx", "x", "y")),
        Panel("µs, median to 99.9 %", "; ".join(tail) + ".", tails),
    ]
    entries = [LegendEntry(name, style) for name, style in styles.items()]
    return Figure("speed", "Latency and accuracy", caption, panels, entries)


def label(row: CallTimes) -> str:
    """Predictor and runtime for people."""
    if row.runtime in NUMERICS:
        return NUMERICS[row.runtime].label(row.predictor)
    device = "" if row.copies is None else f" on {row.device}, {'with' if row.copies else 'without'} copies"
    return f"{NETWORKS.label(row.predictor)}, {row.runtime}{device}"


def _style(row: CallTimes, networks: dict[str, PredictorId]) -> LineStyle:
    """A numerical predictor has one line; a network its colour, and the dash and marker of the runtime."""
    if row.runtime in NUMERICS:
        role, dash, marker = NUMERICS[row.runtime].look(row.predictor)
        return LineStyle(role, dash, 1.2, marker)
    _, dash, marker = RUNTIMES.look(row.runtime)
    return LineStyle(colours(networks[row.predictor])[row.copies is not None], dash, 1.2, marker)


def _series(rows: Iterable[CallTimes]) -> dict[str, list[CallTimes]]:
    """The rows of each predictor and runtime, from the finest grid to the coarsest."""
    order = [*INTERPRETED.builtin, *METHODS.builtin, *NETWORKS.builtin]
    series: dict[str, list[CallTimes]] = {}
    for row in sorted(rows, key=lambda row: row.dx):
        series.setdefault(label(row), []).append(row)

    def rank(item: tuple[str, list[CallTimes]]) -> tuple[int, str]:
        name = item[1][0].predictor
        return order.index(name) if name in order else len(order), item[0]

    return dict(sorted(series.items(), key=rank))
