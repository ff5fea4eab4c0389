"""Figures of accuracy: the errors of networks on held-out samples, and their effect on the closed loop."""

from functools import partial
from typing import Any

import numpy as np

from npred.figures.evaluation_data import ErrorArrays, Evidence
from npred.figures.figure import Key, Panel, Plate
from npred.figures.loops import ends, keys
from npred.figures.notation import common_unit, quantity, symbol, with_unit
from npred.figures.style import ROLES, Look, lettered, log, look, power, short
from npred.results import Contender
from npred.results.evaluate import Scores

BINS = 24
CELLS = (18, 14)  # of the map over the first two states
LEVELS = 9  # colours of that map


def certificate(evidence: Evidence) -> Plate:
    """Error against radius with the line of theory, the distance to the target, and W(t) [DAPF, Theorem 3]."""
    radii = {
        contender: scores
        for contender, scores in evidence.models.items()
        if 0 < scores.eps_kappa < np.inf and 0 < scores.radius.median < np.inf
    }
    gain, line, key = evidence.gain, "", ()
    if np.isfinite(gain):  # else an error that stays takes the linearised loop out of all bounds
        line = f"; an error that stayed constant would move the end along the dotted line, {gain:.4g} ε"
        key = (Key(f"constant error: {gain:.4g} ε", Look("muted", (1, 2))),)
    beside = ends(evidence)
    others = "Distance and W" if len(beside) > 1 else "Distance"
    caption = (
        "Radius: where loops end (filled: median over the cases, hollow: worst; squares: stopped early) against the "
        f"error that control sees{line}. {others}: the loop of the first figure over time."
    )
    eps = with_unit("ε_{κ} on held-out samples", common_unit(evidence.plant, evidence.plant.inputs))
    panels = (Panel("radius versus ε_{κ}", _alt_radii(radii), partial(_radii, radii, gain, eps)), *beside)
    return Plate("certificate", "Error and radius", caption, panels, (*keys(evidence.loops), *key))


def errors(evidence: Evidence) -> Plate:
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
    return Plate("errors", "Where networks err", caption, panels, keys(by_network))


def box(evidence: Evidence) -> Plate:
    """The largest error over the state box: the first two states, or the one there is."""
    plant, names = evidence.plant, list(evidence.plant.states)
    said = "" if len(names) < 3 else f" (the first two of {len(names)} states)"
    caption = f"The largest |P̂ − P| on {evidence.samples} by where the state is{said}. Hatched: no samples there."
    if len(names) == 1:
        draw = partial(_over, evidence.X[:, 0], evidence.errors, quantity(plant, names[0]))
        panels = [Panel(f"error versus {symbol(plant, names[0])}", "Largest and median error by state.", draw)]
        return Plate("box", "Over the states", caption, tuple(panels), keys(evidence.errors))
    levels = _levels(evidence.errors)
    panels = [
        Panel(
            f"{contender.label}: {quantity(plant, names[1])}",
            _alt_box(evidence, error),
            partial(_cells, evidence, error, levels),
        )
        for contender, error in evidence.errors.items()
    ]
    return Plate("box", "Over the states", caption, tuple(panels))


def _radii(rows: dict[Contender, Scores], gain: float, label: str, axis: Any) -> None:
    for contender, row in rows.items():
        eps, median, worst = row.eps_kappa, row.radius.median, row.radius.worst
        colour, marker = look(contender).colour, "o" if contender.epoch is None else "s"
        worst = worst if 0 < worst < np.inf else np.nan
        axis.plot([eps, eps], [median, worst], "-", color=colour, linewidth=1.0)
        axis.plot([eps], [median], marker, color=colour)
        axis.plot([eps], [worst], marker, markerfacecolor=ROLES["paper"][0], markeredgecolor=colour)
    if rows and np.isfinite(gain):
        eps = [row.eps_kappa for row in rows.values()]
        span = np.array([min(eps) / 3, max(eps) * 3])
        axis.plot(span, gain * span, color=ROLES["muted"][0], linestyle=(0, (1, 2)), linewidth=1.2)
    axis.set_xlabel(label)
    log(axis, "x", "y")


def _alt_radii(rows: dict[Contender, Scores]) -> str:
    radii = [
        f"{contender.label}: ε_{{κ}} {row.eps_kappa:.2e}, radius from {short(row.radius.median)} (median) to "
        f"{short(row.radius.worst)} (worst)"
        for contender, row in rows.items()
    ]
    return "; ".join(radii) + "." if radii else "No network's loops stay finite."


def _band(axis: Any, contender: Contender, x: np.ndarray, middle: np.ndarray, sup: np.ndarray) -> None:
    axis.plot(x, _positive(sup), **look(contender).line)
    axis.fill_between(x, _positive(middle), _positive(sup), color=look(contender).colour, alpha=0.14, linewidth=0)


def _positive(values: np.ndarray) -> np.ndarray:
    """For a logarithmic side: an error of zero is left out."""
    return np.where(values > 0, values, np.nan)


def _over_x(by_network: dict[Contender, ErrorArrays], axis: Any) -> None:
    for contender, error in by_network.items():
        _band(axis, contender, np.linspace(0, 1, len(error.over_x)), error.over_x[:, 0], error.over_x[:, -1])
    axis.set(xlabel="x", xlim=(0, 1))
    log(axis, "y")


def _over(values: np.ndarray, by_network: dict[Contender, ErrorArrays], label: str, axis: Any) -> None:
    edges = np.linspace(values.min(), values.max(), BINS + 1)
    which = np.clip(np.digitize(values, edges) - 1, 0, BINS - 1)
    centres = (edges[1:] + edges[:-1]) / 2
    for contender, error in by_network.items():
        parts = [error.sup[which == k] for k in range(BINS)]
        middle, sup = (np.array([f(part) if len(part) else np.nan for part in parts]) for f in (np.median, np.max))
        _band(axis, contender, centres, middle, sup)
    axis.set_xlabel(label)
    log(axis, "y")


def distribution(sup_by_network: dict[Contender, np.ndarray], axis: Any, **limits: Any) -> None:
    """The share of samples (N,) whose error is below ε, a line per network."""
    share = np.linspace(0, 1, 201)
    for contender, sup in sup_by_network.items():
        axis.plot(_positive(np.quantile(sup, share)), share, **look(contender).line)
    axis.set(xlabel="ε", ylim=(0, 1.02), **limits)
    log(axis, "x")


def _levels(by_network: dict[Contender, ErrorArrays]) -> np.ndarray:
    """Edges of the colours, equal on the logarithmic scale, the same for all networks."""
    sups = np.concatenate([error.sup for error in by_network.values()])
    sups = sups[sups > 0]
    low, high = (sups.min(), sups.max()) if len(sups) else (0.1, 1.0)
    return np.geomspace(max(low, high * 1e-4), high * 1.0001, LEVELS + 1)


def _cells(evidence: Evidence, error: ErrorArrays, levels: np.ndarray, axis: Any) -> None:
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


def _alt_box(evidence: Evidence, error: ErrorArrays) -> str:
    where = evidence.X[np.argmax(error.sup)]
    pairs = zip(evidence.plant.states, where, strict=True)
    at = ", ".join(f"{symbol(evidence.plant, name)} = {value:.3g}" for name, value in pairs)
    return f"Largest error in cells of the state space; largest of all {error.sup.max():.2e} at {at}."
