"""Figures of accuracy: how networks learn, and their errors on held-out samples: over x, delays, states and kinds."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from npred.figures.evaluation_data import OF, ErrorArrays, EvaluationData
from npred.figures.figure import Figure, LegendEntry, Panel
from npred.figures.loops import keys
from npred.figures.notation import common_unit, quantity, symbol
from npred.figures.style import ROLES, Axes, lettered, log, look, power, short
from npred.results import PredictorId

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


def errors(evidence: EvaluationData) -> Figure:
    """Error over x, over D_hat, and its distribution."""
    by_network = evidence.errors
    held, unit = len(evidence.D_hat), common_unit(evidence.plant, evidence.plant.states, "state units")
    sup = "; ".join(f"{contender.label} {error.sup.max():.2e}" for contender, error in by_network.items())
    half = "; ".join(f"{contender.label} {np.median(error.sup):.2e}" for contender, error in by_network.items())
    caption = (
        f"|P̂ − P| on {held} {evidence.samples}, in {unit}. Lines: the largest error, shaded: from the "
        "median to it. x = 0 is now, x = 1 the state one delay ahead, which the control acts on."
    )
    panels = (
        Panel("error versus x", f"Largest error over all x: {sup}.", partial(_over_x, by_network)),
        Panel(f"error versus {symbol(evidence.plant, 'D_hat')}", f"Largest error by delay; over all: {sup}.",
              partial(_over, evidence.D_hat, by_network, quantity(evidence.plant, "D_hat"))),
        Panel("share of samples below ε", f"Distribution of the largest error over x; median: {half}.",
              partial(distribution, {c: error.sup for c, error in by_network.items()})),
    )  # fmt: skip
    return Figure("errors", "Where networks err", caption, panels, keys(by_network))


def box(evidence: EvaluationData) -> Figure:
    """The largest error over the state box: the first two states, or the one there is."""
    plant, names = evidence.plant, list(evidence.plant.states)
    said = "" if len(names) < 3 else f" (the first two of {len(names)} states)"
    caption = f"The largest |P̂ − P| on {evidence.samples} by where the state is{said}. Hatched: no samples there."
    if len(names) == 1:
        draw = partial(_over, evidence.X[:, 0], evidence.errors, quantity(plant, names[0]))
        panels = [Panel(f"error versus {symbol(plant, names[0])}", "Largest and median error by state.", draw)]
        return Figure("box", "Over the states", caption, tuple(panels), keys(evidence.errors))
    levels = _levels(evidence.errors)
    panels = [
        Panel(
            f"{contender.label}: {quantity(plant, names[1])}",
            _alt_box(evidence, error),
            partial(_cells, evidence, error, levels),
        )
        for contender, error in evidence.errors.items()
    ]
    return Figure("box", "Over the states", caption, tuple(panels))


def _band(axis: Axes, contender: PredictorId, x: np.ndarray, middle: np.ndarray, sup: np.ndarray) -> None:
    axis.plot(x, _positive(sup), **look(contender).line)
    axis.fill_between(x, _positive(middle), _positive(sup), color=look(contender).colour, alpha=0.14, linewidth=0)


def _positive(values: np.ndarray) -> np.ndarray:
    """For a logarithmic side: an error of zero is left out."""
    return np.where(values > 0, values, np.nan)


def _over_x(by_network: dict[PredictorId, ErrorArrays], axis: Axes) -> None:
    for contender, error in by_network.items():
        _band(axis, contender, np.linspace(0, 1, len(error.over_x)), error.over_x[:, 0], error.over_x[:, -1])
    axis.set(xlabel="x", xlim=(0, 1))
    log(axis, "y")


def _over(values: np.ndarray, by_network: dict[PredictorId, ErrorArrays], label: str, axis: Axes) -> None:
    edges = np.linspace(values.min(), values.max(), BINS + 1)
    which = np.clip(np.digitize(values, edges) - 1, 0, BINS - 1)
    centres = (edges[1:] + edges[:-1]) / 2
    for contender, error in by_network.items():
        parts = [error.sup[which == k] for k in range(BINS)]
        middle, sup = (np.array([f(part) if len(part) else np.nan for part in parts]) for f in (np.median, np.max))
        _band(axis, contender, centres, middle, sup)
    axis.set_xlabel(label)
    log(axis, "y")


def distribution(sup_by_network: dict[PredictorId, np.ndarray], axis: Axes, **limits: Any) -> None:
    """The share of samples (N,) whose error is below ε, a line per network."""
    share = np.linspace(0, 1, 201)
    for contender, sup in sup_by_network.items():
        axis.plot(_positive(np.quantile(sup, share)), share, **look(contender).line)
    axis.set(xlabel="ε", ylim=(0, 1.02), **limits)
    log(axis, "x")


def _levels(by_network: dict[PredictorId, ErrorArrays]) -> np.ndarray:
    """Edges of the colours, equal on the logarithmic scale, the same for all networks."""
    sups = np.concatenate([error.sup for error in by_network.values()])
    sups = sups[sups > 0]
    low, high = (sups.min(), sups.max()) if len(sups) else (0.1, 1.0)
    return np.geomspace(max(low, high * 1e-4), high * 1.0001, LEVELS + 1)


def _cells(evidence: EvaluationData, error: ErrorArrays, levels: np.ndarray, axis: Axes) -> None:
    import matplotlib
    from matplotlib.colors import BoundaryNorm
    from matplotlib.ticker import FuncFormatter

    edges, largest = worst(evidence.X[:, :2], error.sup)
    colours = matplotlib.colormaps["cividis"].resampled(LEVELS)
    axis.patch.set(hatch="//", edgecolor=ROLES["muted"][0], linewidth=0)  # no colour of the page's is free for it
    shown = np.ma.masked_invalid(np.clip(largest, levels[0], None))
    drawn = axis.pcolormesh(*edges, shown.T, cmap=colours, norm=BoundaryNorm(levels, LEVELS))
    bar = axis.figure.colorbar(drawn, ax=axis, ticks=levels[::3], aspect=28, pad=0.02)
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: lettered(power(value))))
    bar.outline.set_visible(False)
    axis.set_xlabel(quantity(evidence.plant, evidence.plant.states[0]))
    axis.grid(False)


def worst(X: np.ndarray, sup: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Edges of the cells over X (N, 2), and the largest error in each; NaN where there are no samples."""
    edges = [np.linspace(X[:, k].min(), X[:, k].max(), count + 1) for k, count in enumerate(CELLS)]
    where = tuple(np.clip(np.digitize(X[:, k], edges[k]) - 1, 0, CELLS[k] - 1) for k in range(2))
    largest = np.full(CELLS, -np.inf)
    np.maximum.at(largest, where, sup)
    return edges, np.where(np.isfinite(largest), largest, np.nan)


def _alt_box(evidence: EvaluationData, error: ErrorArrays) -> str:
    where = evidence.X[np.argmax(error.sup)]
    pairs = zip(evidence.plant.states, where, strict=True)
    at = ", ".join(f"{symbol(evidence.plant, name)} = {value:.3g}" for name, value in pairs)
    return f"Largest error in cells of the state space; largest of all {error.sup.max():.2e} at {at}."


def kinds(evidence: EvaluationData) -> Figure | None:
    """The distribution of the error on rows of each kind, all on one scale; None where there is one kind alone."""
    if len(evidence.kinds) < 2:
        return None
    about = ", ".join(ABOUT[kind] for kind in evidence.kinds if kind in ABOUT)
    caption = f"The share of held-out rows whose largest |P̂ − P| over x is below ε, by kind of row: {about}."
    span = _span(evidence)
    panels = [
        Panel(OF[kind], _alt_kind(sup), partial(distribution, sup, xlim=span)) for kind, sup in evidence.kinds.items()
    ]
    return Figure("kinds", "By kind of row", caption, tuple(panels), keys(evidence.errors))


def _span(evidence: EvaluationData) -> tuple[float, float]:
    """From the smallest positive error to the largest."""
    errors = np.concatenate([sup for networks in evidence.kinds.values() for sup in networks.values()])
    errors = errors[errors > 0]
    return (errors.min() / 2, errors.max() * 2) if len(errors) else (0.1, 1.0)


def _alt_kind(networks: dict[PredictorId, np.ndarray]) -> str:
    said = [f"{contender.label} {short(np.median(sup))} and {short(sup.max())}" for contender, sup in networks.items()]
    return f"Median and largest error: {'; '.join(said)}."


def learning(histories: dict[PredictorId, Epochs]) -> Figure:
    """The metrics of each network's epochs, as its training left them."""
    panels = [Panel(title, _alt_losses(title, key, histories), partial(_losses, key, histories))
              for key, title in SHOWN.items()]  # fmt: skip
    caption = (
        "One point per epoch. The loss differs by network; the errors are in state units, on the rollouts that the "
        "data hold out."
    )
    solid = tuple(
        LegendEntry(network.label, replace(look(network), dash=())) for network in histories
    )  # dashes hide roughness
    return Figure("learning", "Training", caption, tuple(panels), solid)


def _losses(key: str, histories: dict[PredictorId, Epochs], axis: Axes) -> None:
    for network, epochs in histories.items():
        solid = replace(look(network), dash=(), marker="" if len(epochs) > 1 else "o")  # one point makes no line
        axis.plot([row["epoch"] for row in epochs], [row[key] for row in epochs], **solid.line)
    axis.set_xlabel("epoch")
    log(axis, "y")


def _alt_losses(title: str, key: str, histories: dict[PredictorId, Epochs]) -> str:
    ends = "; ".join(f"{network.label} {rows[0][key]:.2e} to {rows[-1][key]:.2e} in {len(rows)} epochs"
                     for network, rows in histories.items())  # fmt: skip
    return f"{title}: {ends}."
