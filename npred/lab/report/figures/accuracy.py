"""Figures of accuracy: how networks learn, and their errors on held-out samples: over x, delays, states and kinds."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from npred.lab.config.results import PredictorId
from npred.lab.report.figures.evaluation_data import OF, ErrorArrays, EvaluationData
from npred.lab.report.figures.figure import Figure, LegendEntry, Panel, legend
from npred.lab.report.figures.notation import common_unit, quantity, symbol
from npred.lab.report.figures.style import ROLES, Axes, LineStyle, lettered, line_of, log, positive, power, short

BINS = 24
CELLS = (18, 14)  # of the map over the first two states
LEVELS = 9  # colours of that map
ABOUT = {
    "nominal": "nominal rollouts have the experiment's delays",
    "exploring": "exploring ones wider ranges of delays and estimates",
    "redrawn": "a redrawn D̂ is not the loop's",
}
Epochs = list[dict[str, float]]
SHOWN = {"loss": "training loss", "mse": "held-out mean square", "eps_sup": "held-out sup error ε"}


def errors(evaluation: EvaluationData) -> Figure:
    """Error over x, over D_hat, and its distribution."""
    plant, by_network = evaluation.plant, evaluation.errors
    sup = "; ".join(f"{network.label} {error.sup.max():.2e}" for network, error in by_network.items())
    half = "; ".join(f"{network.label} {np.median(error.sup):.2e}" for network, error in by_network.items())

    def over_x(axis: Axes) -> None:
        for network, error in by_network.items():
            x = np.linspace(0, 1, len(error.over_x))
            _draw_band(axis, network, x, error.over_x[:, 0], error.over_x[:, -1])
        axis.set(xlabel="x", xlim=(0, 1))
        log(axis, "y")

    caption = (
        f"|P̂ − P| on {len(evaluation.D_hat)} {evaluation.samples}, "
        f"in {common_unit(plant, plant.states, 'state units')}. Lines: the largest error, shaded: from the median to "
        "it. x = 0 is now, x = 1 the state one delay ahead, which the control acts on."
    )
    panels = [
        Panel("error versus x", f"Largest error over all x: {sup}.", over_x),
        Panel(
            f"error versus {symbol(plant, 'D_hat')}",
            f"Largest error by delay; over all: {sup}.",
            _over(evaluation.D_hat, by_network, quantity(plant, "D_hat")),
        ),
        Panel(
            "share of samples below ε",
            f"Distribution of the largest error over x; median: {half}.",
            _distribution({network: error.sup for network, error in by_network.items()}),
        ),
    ]
    return Figure("errors", "Where networks err", caption, panels, legend([*by_network]))


def box(evaluation: EvaluationData) -> Figure:
    """The largest error over the state box: the first two states, or the one there is."""
    plant, names = evaluation.plant, list(evaluation.plant.states)
    of_all = "" if len(names) < 3 else f" (the first two of {len(names)} states)"
    caption = f"The largest |P̂ − P| on {evaluation.samples} by where the state is{of_all}. Hatched: no samples there."
    if len(names) == 1:
        draw = _over(evaluation.X[:, 0], evaluation.errors, quantity(plant, names[0]))
        panels = [Panel(f"error versus {symbol(plant, names[0])}", "Largest and median error by state.", draw)]
        return Figure("box", "Over the states", caption, panels, legend([*evaluation.errors]))
    sups = np.concatenate([error.sup for error in evaluation.errors.values()])
    sups = sups[sups > 0]
    low, high = (sups.min(), sups.max()) if len(sups) else (0.1, 1.0)
    levels = np.geomspace(max(low, high * 1e-4), high * 1.0001, LEVELS + 1)  # the same for all networks
    panels = [_box_panel(evaluation, network, error, levels) for network, error in evaluation.errors.items()]
    return Figure("box", "Over the states", caption, panels)


def _box_panel(evaluation: EvaluationData, network: PredictorId, error: ErrorArrays, levels: np.ndarray) -> Panel:
    plant, (first, second, *_) = evaluation.plant, evaluation.plant.states

    def draw(axis: Axes) -> None:
        import matplotlib
        from matplotlib.colors import BoundaryNorm
        from matplotlib.ticker import FuncFormatter

        edges, largest = worst(evaluation.X[:, :2], error.sup)
        colours = matplotlib.colormaps["cividis"].resampled(LEVELS)
        axis.patch.set(hatch="//", edgecolor=ROLES["muted"][0], linewidth=0)  # no colour of the page's is free for it
        shown = np.ma.masked_invalid(np.clip(largest, levels[0], None))
        drawn = axis.pcolormesh(*edges, shown.T, cmap=colours, norm=BoundaryNorm(levels, LEVELS))
        bar = axis.figure.colorbar(drawn, ax=axis, ticks=levels[::3], aspect=28, pad=0.02)
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: lettered(power(value))))
        bar.outline.set_visible(False)
        axis.set_xlabel(quantity(plant, first))
        axis.grid(False)

    pairs = zip(plant.states, evaluation.X[np.argmax(error.sup)], strict=True)
    at = ", ".join(f"{symbol(plant, name)} = {value:.3g}" for name, value in pairs)
    alt = f"Largest error in cells of the state space; largest of all {error.sup.max():.2e} at {at}."
    return Panel(f"{network.label}: {quantity(plant, second)}", alt, draw)


def worst(X: np.ndarray, sup: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Edges of the cells over X (N, 2), and the largest error in each; NaN where there are no samples."""
    edges = [np.linspace(X[:, k].min(), X[:, k].max(), count + 1) for k, count in enumerate(CELLS)]
    where = tuple(np.clip(np.digitize(X[:, k], edges[k]) - 1, 0, CELLS[k] - 1) for k in range(2))
    largest = np.full(CELLS, -np.inf)
    np.maximum.at(largest, where, sup)
    return edges, np.where(np.isfinite(largest), largest, np.nan)


def _draw_band(axis: Axes, network: PredictorId, x: np.ndarray, middle: np.ndarray, sup: np.ndarray) -> None:
    line = line_of(network)
    axis.plot(x, positive(sup), **line.line)
    axis.fill_between(x, positive(middle), positive(sup), color=line.colour, alpha=0.14, linewidth=0)


def _over(values: np.ndarray, by_network: Mapping[PredictorId, ErrorArrays], label: str) -> Callable[[Axes], None]:
    """Draws the median and the largest error in each of BINS ranges of these values."""
    edges = np.linspace(values.min(), values.max(), BINS + 1)
    which = np.clip(np.digitize(values, edges) - 1, 0, BINS - 1)

    def draw(axis: Axes) -> None:
        for network, error in by_network.items():
            parts = [error.sup[which == k] for k in range(BINS)]
            middle, sup = (np.array([f(part) if len(part) else np.nan for part in parts]) for f in (np.median, np.max))
            _draw_band(axis, network, (edges[1:] + edges[:-1]) / 2, middle, sup)
        axis.set_xlabel(label)
        log(axis, "y")

    return draw


def _distribution(sup_by_network: Mapping[PredictorId, np.ndarray], **limits: Any) -> Callable[[Axes], None]:
    """Draws the share of samples (N,) whose error is below ε, a line per network."""

    def draw(axis: Axes) -> None:
        share = np.linspace(0, 1, 201)
        for network, sup in sup_by_network.items():
            axis.plot(positive(np.quantile(sup, share)), share, **line_of(network).line)
        axis.set(xlabel="ε", ylim=(0, 1.02), **limits)
        log(axis, "x")

    return draw


def kinds(evaluation: EvaluationData) -> Figure | None:
    """The distribution of the error on rows of each kind, all on one scale; None where there is one kind alone."""
    if len(evaluation.kinds) < 2:
        return None
    errors = np.concatenate([sup for networks in evaluation.kinds.values() for sup in networks.values()])
    errors = errors[errors > 0]
    span = (errors.min() / 2, errors.max() * 2) if len(errors) else (0.1, 1.0)
    panels = []
    for kind, networks in evaluation.kinds.items():
        ends = [f"{network.label} {short(np.median(sup))} and {short(sup.max())}" for network, sup in networks.items()]
        panels.append(
            Panel(OF[kind], f"Median and largest error: {'; '.join(ends)}.", _distribution(networks, xlim=span))
        )
    about = ", ".join(ABOUT[kind] for kind in evaluation.kinds if kind in ABOUT)
    caption = f"The share of held-out rows whose largest |P̂ − P| over x is below ε, by kind of row: {about}."
    return Figure("kinds", "By kind of row", caption, panels, legend([*evaluation.errors]))


def learning(histories: Mapping[PredictorId, Epochs]) -> Figure:
    """The metrics of each network's epochs, as its training left them."""
    solid = {network: replace(line_of(network), dash=()) for network in histories}  # dashes hide roughness
    caption = (
        "One point per epoch. The loss differs by network; the errors are in state units, on the rollouts that the "
        "data hold out."
    )
    panels = [_learning_panel(title, key, histories, solid) for key, title in SHOWN.items()]
    entries = [LegendEntry(network.label, style) for network, style in solid.items()]
    return Figure("learning", "Training", caption, panels, entries)


def _learning_panel(
    title: str, key: str, histories: Mapping[PredictorId, Epochs], lines: Mapping[PredictorId, LineStyle]
) -> Panel:
    def draw(axis: Axes) -> None:
        for network, epochs in histories.items():
            marked = replace(lines[network], marker="" if len(epochs) > 1 else "o")  # one point makes no line
            axis.plot([row["epoch"] for row in epochs], [row[key] for row in epochs], **marked.line)
        axis.set_xlabel("epoch")
        log(axis, "y")

    ends = [
        f"{network.label} {rows[0][key]:.2e} to {rows[-1][key]:.2e} in {len(rows)} epochs"
        for network, rows in histories.items()
    ]
    return Panel(title, f"{title}: {'; '.join(ends)}.", draw)
