"""The time of a predictor call: against its error, against the grid, and its tail."""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from math import inf, isfinite

from npred.figures.figure import Figure, LegendEntry, Panel
from npred.figures.style import Axes, LineStyle, colours, log
from npred.registry import METHODS, NETWORKS, RUNTIMES, Entry, Registry
from npred.results import PredictorId, ranked
from npred.results.bench import CallTimes

FAR = 1000  #: times the networks' error: no prediction any more, an unstable step say
INTERPRETED = Registry(  #: how the baselines of pipeline/interpreted.py are drawn
    "baseline",
    "npred.baselines",
    {
        "published": Entry("", "O(nx²) sums, interpreted", ("muted", (1, 1.5), "X")),
        "euler_python": Entry("", "Euler, interpreted", ("muted", (), "P")),
    },
)
TAIL = {"median_us": "o", "p95_us": "|", "p999_us": "|"}


def speed(rows: list[CallTimes]) -> Figure:
    """Latency against error and against dx, a line through the grids of each; median to 99.9 % at the finest dx."""
    single = [row for row in rows if row.batch == 1 and isfinite(row.eps_sup)]
    front = _series(_near(single))
    grids = _series(row for row in single if row.matches is None)
    networks = {c.model: c for c in ranked(PredictorId(row.predictor) for row in rows if row.is_network)}
    looks = {name: _look(series[0], networks) for name, series in _series(single).items()}
    caption = (
        "Time of one call at batch 1. Versus ε: the median and the error, one mark per grid. The line of a method "
        "joins the grids that no other grid of it beats in both; lower and further left is better. From the median "
        "to the 99.9 % quantile: at the finest dx; a control loop misses its deadline in the tail."
    )
    panels = (
        Panel("µs per call versus ε", _alt_front(front), partial(_fronts, front, looks)),
        Panel("µs per call versus dx", _alt_grids(grids), partial(_lines, grids, looks)),
        Panel("µs, median to 99.9 %", _alt_tail(grids), partial(_tails, grids, looks)),
    )  # fmt: skip
    return Figure("speed", "Latency and accuracy", caption, panels, tuple(LegendEntry(*item) for item in looks.items()))


def _near(rows: list[CallTimes]) -> list[CallTimes]:
    """Without the errors that would leave the others no room."""
    worst = max((row.eps_sup for row in rows if row.is_network), default=inf)
    return [row for row in rows if row.eps_sup <= FAR * worst]


def label(row: CallTimes) -> str:
    """Predictor and runtime for people."""
    if (parts := _numerical(row)) is not None:
        return parts.label(row.predictor)
    device = "" if row.copies is None else f" on {row.device}, {'with' if row.copies else 'without'} copies"
    return f"{NETWORKS.label(row.predictor)}, {row.runtime}{device}"


def _look(row: CallTimes, networks: dict[str, PredictorId]) -> LineStyle:
    """A numerical predictor has one look; a network its colour, and the dash and marker of the runtime."""
    if (parts := _numerical(row)) is not None:
        role, dash, marker = parts.look(row.predictor)
        return LineStyle(role, dash, 1.2, marker)
    _, dash, marker = RUNTIMES.look(row.runtime)
    return LineStyle(colours(networks[row.predictor])[row.copies is not None], dash, 1.2, marker)


def _numerical(row: CallTimes) -> Registry | None:
    """The registry that names the row's predictor; None for a network."""
    return {"python": INTERPRETED, "compiled": METHODS}.get(row.runtime)


def _series(rows: Iterable[CallTimes]) -> dict[str, list[CallTimes]]:
    """The rows of each predictor and runtime, from the finest grid to the coarsest."""
    series: dict[str, list[CallTimes]] = {}
    for row in sorted(rows, key=lambda row: row.dx):
        series.setdefault(label(row), []).append(row)
    return dict(sorted(series.items(), key=lambda item: _rank(item[1][0])))


def _rank(row: CallTimes) -> tuple[int, str]:
    order = [*INTERPRETED.builtin, *METHODS.builtin, *NETWORKS.builtin]
    return order.index(row.predictor) if row.predictor in order else len(order), label(row)


def _fronts(series: dict[str, list[CallTimes]], looks: dict[str, LineStyle], axis: Axes) -> None:
    for name, rows in series.items():
        front, look = _unbeaten(rows), looks[name]
        axis.plot([row.eps_sup for row in rows], [row.median_us for row in rows], look.marker, color=look.colour)
        line = replace(look, marker="").line
        axis.plot([row.eps_sup for row in front], [row.median_us for row in front], **line)
    axis.set_xlabel("sup error ε")
    log(axis, "x", "y")


def _unbeaten(rows: list[CallTimes]) -> list[CallTimes]:
    """The rows that no other beats in error and time, by rising error: their times fall, so a line has no way back."""
    best: list[CallTimes] = []
    for row in sorted(rows, key=lambda row: (row.eps_sup, row.median_us)):
        if not best or row.median_us < best[-1].median_us:
            best.append(row)
    return best


def _lines(series: dict[str, list[CallTimes]], looks: dict[str, LineStyle], axis: Axes) -> None:
    for name, rows in series.items():
        axis.plot([row.dx for row in rows], [row.median_us for row in rows], **looks[name].line)
    axis.set_xlabel("dx")
    log(axis, "x", "y")


def _tails(series: dict[str, list[CallTimes]], looks: dict[str, LineStyle], axis: Axes) -> None:
    for position, (name, (finest, *_)) in enumerate(series.items()):
        style = looks[name]
        axis.plot([finest.median_us, finest.p999_us], [position, position], color=style.colour, linewidth=1.2)
        for key, marker in TAIL.items():
            axis.plot(
                [getattr(finest, key)], [position], marker if key != "median_us" else style.marker, color=style.colour
            )
    named = list(series) if _room(axis) > len(series) else [""] * len(series)  # else the legend has to do
    axis.set(yticks=range(len(series)), yticklabels=named, xlabel="µs per call")
    axis.invert_yaxis()
    axis.grid(axis="y", visible=False)
    log(axis, "x")


def _room(axis: Axes) -> float:
    """The number of labels that the y axis has the height for."""
    line = 1.2 * float(axis.yaxis.get_ticklabels()[0].get_fontsize())
    return axis.bbox.height * 72 / axis.figure.dpi / line


def _alt_front(series: dict[str, list[CallTimes]]) -> str:
    quickest = {name: min(rows, key=lambda row: row.median_us) for name, rows in series.items()}
    return "; ".join(f"{n}: {r.median_us:.3g} µs at error {r.eps_sup:.1e}" for n, r in quickest.items()) + "."


def _alt_grids(series: dict[str, list[CallTimes]]) -> str:
    texts = [f"{name}: {rows[-1].median_us:.3g} µs at dx = {rows[-1].dx:.3g}, {rows[0].median_us:.3g} µs at "
             f"{rows[0].dx:.3g}" for name, rows in series.items()]  # fmt: skip
    return "; ".join(texts) + "."


def _alt_tail(series: dict[str, list[CallTimes]]) -> str:
    texts = [f"{name}: {rows[0].median_us:.3g} to {rows[0].p999_us:.3g} µs" for name, rows in series.items()]
    return "; ".join(texts) + "."
