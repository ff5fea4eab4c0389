"""The accuracy of networks: how they learn, their errors on held-out samples, and their certificates."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from npred.lab.config.results import Certified, PredictorId
from npred.lab.report.figures.evaluation_data import OF, ErrorArrays, EvaluationData
from npred.lab.report.figures.figure import Figure, LegendEntry, Panel, curves, legend
from npred.lab.report.figures.loops import ends
from npred.lab.report.figures.style import DOTTED, ROLES, Axes, lettered, line_of, log, power, short
from npred.plants import Plant
from npred.plants.notation import common_unit, quantity, symbol, with_unit

BINS = 24
CELLS = (18, 14)  # cells of the map over the first two states
LEVELS = 9  # colours of that map
ABOUT = {
    "nominal": "nominal rollouts have the experiment's delays",
    "exploring": "exploring ones wider ranges of delays and estimates",
    "redrawn": "a redrawn D̂ is not the loop's",
}
Epochs = list[dict[str, float]]
METRICS = {"loss": "training loss", "mse": "held-out mean square", "eps_sup": "held-out sup error ε"}
SHARES = np.linspace(0, 1, 201)


def errors(evaluation: EvaluationData) -> Figure:
    """Error over x, over D_hat, and its distribution."""
    plant, by_network = evaluation.plant, evaluation.errors
    sup = "; ".join(f"{network.label} {error.sup.max():.2e}" for network, error in by_network.items())
    half = "; ".join(f"{network.label} {np.median(error.sup):.2e}" for network, error in by_network.items())
    bands = []
    for network, error in by_network.items():
        x = np.linspace(0, 1, len(error.over_x))
        bands.append((line_of(network), x, error.over_x[:, -1], error.over_x[:, 0]))
    caption = (
        f"|P̂ − P| on {len(evaluation.D_hat)} {evaluation.samples}, "
        f"in {common_unit(plant, plant.states, 'state units')}. Lines: the largest error, shaded: from the median to "
        "it. x = 0 is now, x = 1 the state one delay ahead, which the control acts on."
    )
    over = _over(evaluation.D_hat, by_network, quantity(plant, "D_hat"))
    shares = _distribution({network: error.sup for network, error in by_network.items()})
    panels = [
        Panel("error versus x", f"Largest error over all x: {sup}.", curves(bands, "x", "y", xlim=(0, 1))),
        Panel(f"error versus {symbol(plant, 'D_hat')}", f"Largest error by delay; over all: {sup}.", over),
        Panel("share of samples below ε", f"Distribution of the largest error over x; median: {half}.", shares),
    ]
    return Figure("errors", "Where networks err", caption, panels, legend([*by_network]))


def _over(values: np.ndarray, by_network: Mapping[PredictorId, ErrorArrays], label: str) -> Callable[[Axes], None]:
    """Draws the median and the largest error in each of BINS ranges of these values."""
    edges = np.linspace(values.min(), values.max(), BINS + 1)
    which = np.clip(np.digitize(values, edges) - 1, 0, BINS - 1)
    bands = []
    for network, error in by_network.items():
        parts = [error.sup[which == k] for k in range(BINS)]
        middle, sup = (np.array([f(part) if len(part) else np.nan for part in parts]) for f in (np.median, np.max))
        bands.append((line_of(network), (edges[1:] + edges[:-1]) / 2, sup, middle))
    return curves(bands, label, "y")


def _distribution(sup_by_network: Mapping[PredictorId, np.ndarray], **limits: object) -> Callable[[Axes], None]:
    """Draws the share of samples (N,) whose error is below ε, a line per network."""
    lines = [(line_of(network), np.quantile(sup, SHARES), SHARES) for network, sup in sup_by_network.items()]
    return curves(lines, "ε", "x", ylim=(0, 1.02), **limits)


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
        alt = f"Median and largest error: {'; '.join(ends)}."
        panels.append(Panel(OF[kind], alt, _distribution(networks, xlim=span)))
    about = ", ".join(ABOUT[kind] for kind in evaluation.kinds if kind in ABOUT)
    caption = f"The share of held-out rows whose largest |P̂ − P| over x is below ε, by kind of row: {about}."
    return Figure("kinds", "By kind of row", caption, panels, legend([*evaluation.errors]))


def learning(histories: Mapping[PredictorId, Epochs]) -> Figure:
    """The metrics of each network's epochs, as its training left them."""
    solid = {network: replace(line_of(network), dash=()) for network in histories}  # dashes hide roughness
    panels = []
    for key, title in METRICS.items():
        lines, words = [], []
        for network, epochs in histories.items():
            values = [row[key] for row in epochs]
            marked = replace(solid[network], marker="" if len(epochs) > 1 else "o")  # one point makes no line
            lines.append((marked, [row["epoch"] for row in epochs], values))
            words.append(f"{network.label} {values[0]:.2e} to {values[-1]:.2e} in {len(epochs)} epochs")
        panels.append(Panel(title, f"{title}: {'; '.join(words)}.", curves(lines, "epoch", "y")))
    caption = (
        "One point per epoch. The loss differs by network; the errors are in state units, on the rollouts that the "
        "data hold out."
    )
    entries = [LegendEntry(network.label, style) for network, style in solid.items()]
    return Figure("learning", "Training", caption, panels, entries)


def certificate(evaluation: EvaluationData) -> Figure:
    """Error against radius with the line of theory, the distance to the target, and W(t) [DAPF, Theorem 3]."""
    plant, gain = evaluation.plant, evaluation.gain
    radii = {
        predictor: scores
        for predictor, scores in evaluation.models.items()
        if 0 < scores.eps_kappa < np.inf and 0 < scores.radius.median < np.inf
    }

    def draw(axis: Axes) -> None:
        for predictor, row in radii.items():
            eps, median, worst = row.eps_kappa, row.radius.median, row.radius.worst
            colour, marker = line_of(predictor).colour, "o" if predictor.epoch is None else "s"
            worst = worst if 0 < worst < np.inf else np.nan
            axis.plot([eps, eps], [median, worst], "-", color=colour, linewidth=1.0)
            axis.plot([eps], [median], marker, color=colour)
            axis.plot([eps], [worst], marker, markerfacecolor=ROLES["paper"][0], markeredgecolor=colour)
        if radii and np.isfinite(gain):
            eps = [row.eps_kappa for row in radii.values()]
            span = np.array([min(eps) / 3, max(eps) * 3])
            axis.plot(span, gain * span, **DOTTED.line)
        axis.set_xlabel(with_unit("ε_{κ} on held-out samples", common_unit(plant, plant.inputs)))
        log(axis, "x", "y")

    words = [
        f"{predictor.label}: ε_{{κ}} {row.eps_kappa:.2e}, radius from {short(row.radius.median)} (median) to "
        f"{short(row.radius.worst)} (worst)"
        for predictor, row in radii.items()
    ]
    alt = "; ".join(words) + "." if words else "No network's loops stay finite."
    theory, entries = "", legend([*evaluation.loops])
    if np.isfinite(gain):  # else an error that stays takes the linearised loop out of all bounds
        theory = f". Dotted: the radius of a small constant error ε of U, {gain:.4g} ε; that number is the gain"
        entries.append(LegendEntry(f"constant error: {gain:.4g} ε", DOTTED))
    beside = ends(evaluation)
    others = "Distance and W" if len(beside) > 1 else "Distance"
    caption = (
        "Radius: where loops end (filled: median over the cases, hollow: worst; squares: stopped early) against the "
        f"error that control sees{theory}. {others}: the loop of the first figure over time."
    )
    panels = [Panel("radius versus ε_{κ}", alt, draw), *beside]
    return Figure("certificate", "Error and radius", caption, panels, entries)


def certified(plant: Plant, result: Certified | None, errors: Mapping[PredictorId, np.ndarray]) -> Figure | None:
    """The share of rollouts with a larger error of U than ε, by network; None without a certificate."""
    if result is None:
        return None
    first = next(iter(result.models.values()))

    lines = []
    for network, row in result.models.items():
        ordered, line = np.sort(errors[network]), line_of(network)
        share = 1 - np.arange(len(ordered)) / len(ordered)
        lines.append((line, ordered, share))
        if row.adversarial and row.adversarial < np.inf:
            lines.append((replace(line, width=0, marker="x"), [row.adversarial], share[-1:]))
    shares = curves(lines, with_unit("ε, of U", common_unit(plant, plant.inputs)), "x", "y")

    def draw(axis: Axes) -> None:
        axis.axvline(first.tolerance, **DOTTED.line)
        shares(axis)

    crosses = "" if first.adversarial is None else "; crosses: the largest error that an adversary found"
    caption = (
        f"Of {first.rollouts:,} fresh rollouts the share in which the largest error of U, over inputs and over "
        f"{first.samples or 'some'} random samples of a rollout, is above ε. With a confidence "
        f"of {first.confidence:.4g}, at most a share {first.probability:.4g} of all such rollouts is above the end of "
        f"a line{crosses}. Dotted: the tolerance of the guard. It is valid for "
        f"the distribution that rollouts are drawn from."
    )
    alt = "; ".join(f"{network.label}: at most {short(row.eps_kappa)}" for network, row in result.models.items()) + "."
    tolerance = LegendEntry(f"tolerance {first.tolerance:.4g}", DOTTED)
    panels = [Panel("share of rollouts above ε", alt, draw)]
    return Figure("certified", "With a confidence", caption, panels, [*legend([*result.models]), tolerance])
