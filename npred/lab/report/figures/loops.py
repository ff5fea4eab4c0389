"""Closed loops with each predictor: [DAPF, Fig. 1], other conditions, other delays, and how the data cover them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from npred.diagnosis.delay_margin import MismatchedLoop, delay_margin
from npred.lab.config import conditions
from npred.lab.config.results import NUMERICAL, PredictorId
from npred.lab.config.results.evaluate import Behaviour, Conditions, DelayMap
from npred.lab.report.figures.evaluation_data import EvaluationData, Histogram
from npred.lab.report.figures.figure import Figure, LegendEntry, Panel, curves, legend
from npred.lab.report.figures.style import DOTTED, ROLES, Axes, LineStyle, line_of, log, short
from npred.loop import lyapunov, metrics
from npred.loop.trajectory_views import around
from npred.plants import Plant
from npred.plants.notation import common_unit, quantity, symbol, timed, with_unit

GOAL = replace(DOTTED, width=0.8)
ROUNDS = 30  # rounds of the fixed-point iteration for when a command acts
MARK = (0.01, 9)  # a dash that leaves a legend's marker alone
SPREAD = 0.5  # share of a scenario's room between its first and its last predictor
REACH = 1e-4  # share of the largest value: further left on a logarithmic side are arrows
POINTS, BEYOND = 80, 1.5  # estimates that are looked at for the delay margin, up to so many times the margin
FAR = 2.0  # in D, where the margin has no end


def figure1(evaluation: EvaluationData) -> Figure:
    """x, U and D_hat over time [DAPF, Fig. 1], and how far each loop is from the numerical predictor's."""
    plant, loops, t = evaluation.plant, evaluation.loops, evaluation.loops[NUMERICAL].t
    over_t: Any = {"xlabel": timed(plant, "t"), "xlim": (t[0], t[-1])}
    columns = {predictor: np.column_stack([loop.X, loop.U, loop.D_hat]) for predictor, loop in loops.items()}
    whole, panels = _converging(evaluation), []
    for k, (name, goal) in enumerate(_goals(evaluation, t).items()):
        series = {predictor: values[:, k] for predictor, values in columns.items()}
        what = "" if name != "D_hat" else "delay " if plant.declares_delay else "delay estimate "
        span = around([goal, *(series[predictor] for predictor in whole)], [*series.values()])
        ends = "; ".join(f"{predictor.label} {each[0]:.4g} to {each[-1]:.4g}" for predictor, each in series.items())
        title = what + quantity(plant, name)
        alt = f"{title} from t = 0 to {t[-1]:g}: {ends}."
        lines = [(GOAL, t, goal), *((line_of(predictor), t, values) for predictor, values in series.items())]
        panels.append(Panel(title, alt, curves(lines, **over_t, ylim=span)))
    exact = loops[NUMERICAL].X
    apart = {predictor: np.linalg.norm(loop.X - exact, axis=1) for predictor, loop in loops.items()}
    apart = {predictor: each for predictor, each in apart.items() if np.any((each > 0) & np.isfinite(each))}
    if apart:  # curves that lie on one another have a distance here
        title = with_unit("difference from the numerical loop", common_unit(plant, plant.states))
        largest = "; ".join(f"{predictor.label} {short(np.max(each))}" for predictor, each in apart.items())
        alt = f"|X − X of the numerical loop| on a logarithmic scale, at most: {largest}."
        panels.append(Panel(title, alt, _over_time(plant, t, apart)))
    near = ", ".join(f"{each.label} {short(np.max(apart[each]))}" for each in whole if each in apart)
    config, bounds, limits = evaluation.config, evaluation.config.input_bounds, ""
    if bounds is not None:
        ranges = zip(plant.inputs, bounds, strict=True)
        limits = "".join(f", {symbol(plant, name)} in [{low:g}, {high:g}]" for name, (low, high) in ranges)
    elif evaluation.bounded and plant.input_bounds is None:  # the pipeline draws a bounded loop too
        limits = ", U without bounds"
    D, D_hat = map(plant.time_text, (config.D, config.D_hat))
    delay = "the delay that the plant declares" if plant.declares_delay else f"D = {D} and D̂(0) = {D_hat}"
    caption = (
        f"One closed loop{f' [{plant.figure}]' if plant.figure else ''} "
        f"from X(0) = ({', '.join(f'{value:g}' for value in config.X0)}) with {delay}, run with each "
        f"predictor{limits.replace('inf', '∞')}. Grey and dotted: {'rest' if plant.rests else 'the reference'}, and "
        f"{'the delay there' if plant.declares_delay else 'the true delay'}. "
        "A loop that does not settle may leave the picture."
    )
    if near:
        caption += f" Lines that lie on each other differ from the numerical loop by at most: {near}."
    return Figure("figure1", "The closed loop", caption, panels, legend([*loops]))


def figure1_bounded(evaluation: EvaluationData) -> Figure | None:
    """The same of the loops with U within `figure_bounds`; None where there are none."""
    table = evaluation.config.bounded
    if table is None:
        return None
    figure = figure1(replace(evaluation, config=table, loops=evaluation.bounded))
    return replace(figure, name="figure1_bounded", title="The closed loop, U within bounds")


def _converging(evaluation: EvaluationData) -> list[PredictorId]:
    """The predictors whose loops a panel has to show whole: the numerical one, and all whose loop ends settled.

    A loop that does not settle may leave the picture, so that the others can be distinguished.
    """
    whole = []
    for predictor, loop in evaluation.loops.items():
        target, _ = conditions.targets(evaluation.plant, evaluation.config, loop.t)
        run = cast(Any, loop)  # a radius takes only t and X of Trajectories
        if predictor == NUMERICAL or metrics.converged(metrics.radius(run, target), target):
            whole.append(predictor)
    return whole


def _goals(evaluation: EvaluationData, t: np.ndarray) -> dict[str, np.ndarray]:
    """By name where states and inputs are to go, the input leading by D, and the true delay, (nt,) each."""
    plant, D = evaluation.plant, np.full(len(t), evaluation.config.D)
    acts = t + D
    if plant.declares_delay:
        D, acts = (t - t) + plant.delay(plant.target(t), t), t
        for _ in range(ROUNDS):  # s = t + D(target(s), s)
            acts = t + plant.delay(plant.target(acts), acts)
    both = conditions.targets(plant, evaluation.config, t)[0], conditions.targets(plant, evaluation.config, acts)[1]
    X, u = (np.broadcast_to(goal, (len(t), goal.shape[-1])) for goal in both)
    return dict(zip((*plant.states, *plant.inputs, "D_hat"), (*X.T, *u.T, D), strict=True))


def _over_time(plant: Plant, t: np.ndarray, values: dict[PredictorId, np.ndarray]) -> Callable[[Axes], None]:
    """Draws positive values over time, on a logarithmic side."""
    lines = [(line_of(predictor), t, each) for predictor, each in values.items()]
    return curves(lines, timed(plant, "t"), "y", xlim=(t[0], t[-1]))


def ends(evaluation: EvaluationData) -> list[Panel]:
    """The distance to rest, and W(t) of the stability proof where the update law runs, along the loops of figure1."""
    plant, config, t = evaluation.plant, evaluation.config, evaluation.loops[NUMERICAL].t
    goal = conditions.targets(plant, config, t)[0]
    distance = {c: np.linalg.norm(loop.X - goal, axis=1) for c, loop in evaluation.loops.items()}
    last = "; ".join(f"{predictor.label} {values[-1]:.1e}" for predictor, values in distance.items())
    title = with_unit("distance |X − X*|", common_unit(plant, plant.states))
    alt = f"Over {plant.time_text(t[-1])} on a logarithmic scale; at the end: {last}."
    panels = [Panel(title, alt, _over_time(plant, t, distance))]
    proven = {predictor: loop for predictor, loop in evaluation.loops.items() if np.isfinite(loop.N).any()}
    if proven:
        law = conditions.adaptation(config, plant)
        gamma = law.gamma if law else 1.0
        W = {c: lyapunov.W(loop.N, config.D, loop.D_hat, gamma, config.b) for c, loop in proven.items()}
        falls = "; ".join(f"{c.label} from {values[0]:.3g} to {values[-1]:.3g}" for c, values in W.items())
        alt = f"D log N + (b / γ) (D − D̂)², with b = {config.b:g}, γ = {gamma:g}: {falls}."
        panels.append(Panel("W(t) of the proof", alt, _over_time(plant, t, W)))
    return panels


def coverage(evaluation: EvaluationData) -> Figure:
    """A panel per state, an input, and the delay estimate."""
    panels = []
    for name, histogram in evaluation.coverage.items():
        of, edges = quantity(evaluation.plant, name), histogram.edges

        def draw(axis: Axes, histogram: Histogram = histogram) -> None:
            axis.stairs(histogram.data, histogram.edges, fill=True, color=ROLES["fill"][0])
            for predictor, density in histogram.loops.items():
                line = line_of(predictor).line
                style = {"color": line["color"], "linestyle": line["linestyle"], "linewidth": 1.0}
                axis.stairs(density, histogram.edges, **style)
            axis.set(xlim=(histogram.edges[0], histogram.edges[-1]))
            log(axis, "y")

        panels.append(Panel(f"density of {of}", f"The data cover {of} from {edges[0]:.4g} to {edges[-1]:.4g}.", draw))
    caption = (
        "Filled: the training data; lines: what the closed loops visit. Upwards: the share per unit of the quantity, "
        "on a logarithmic scale. A network is only reliable where it was trained."
    )
    shown = next(iter(evaluation.coverage.values())).loops
    entries = [LegendEntry("data", LineStyle("fill", (), 5)), *legend([*shown])]
    return Figure("coverage", "Coverage of the data", caption, panels, entries)


def scenarios(plant: Plant, conditions: Sequence[Conditions]) -> Figure | None:
    """A panel each for the worst radius, the settling time and |D_hat - D|; None where there are no scenarios."""
    if not conditions:
        return None
    radius = with_unit("worst radius", common_unit(plant, plant.states))
    panels = [
        _scenario_panel(radius, conditions, lambda does: does.radius.worst, True),
        _scenario_panel(timed(plant, "settles after"), conditions, lambda does: does.settle_time, False),
    ]
    if not plant.declares_delay:
        panels.append(_scenario_panel(timed(plant, "|D̂ − D| at the end"), conditions, lambda does: does.D_error, True))
    predictors = list(conditions[0].models)
    far = ", ".join(f"{each.label} {sum(one.models[each].far for one in conditions)}" for each in predictors)
    caption = (
        f"The cases again under {len(conditions)} other conditions, each predictor from the same states with the same "
        "noise. An arrow means that the value is smaller than the axis; a loop that does not settle has no mark. "
        f"Loops that overflow, or end farther from rest than a fifth of its size: {far}."
    )
    entries = [LegendEntry(each.label, LineStyle(line_of(each).role, MARK, marker="o")) for each in predictors]
    return Figure("scenarios", "Other conditions", caption, panels, entries)


def _scenario_panel(
    title: str, conditions: Sequence[Conditions], value: Callable[[Behaviour], float | None], logarithmic: bool
) -> Panel:
    """A mark per predictor on the line of each scenario, the first scenario on top; an arrow where it lies far left."""
    names, predictors = [one.name for one in conditions], list(conditions[0].models)
    numbers = {each: [value(one.models[each]) for one in conditions] for each in predictors}
    values = {each: np.array([np.nan if v is None else v for v in row], dtype=float) for each, row in numbers.items()}

    def draw(axis: Axes) -> None:
        offsets = np.linspace(-SPREAD / 2, SPREAD / 2, len(values)) if len(values) > 1 else [0.0]
        finite = {predictor: np.where(np.isfinite(row), row, np.nan) for predictor, row in values.items()}
        low = REACH * np.nanmax([0.0, *np.concatenate(list(finite.values()))]) if logarithmic else 0.0
        for offset, (predictor, row) in zip(offsets, finite.items(), strict=True):
            places, colour = np.arange(len(names)) + offset, line_of(predictor).colour
            drawn = (row >= low) & ((row > 0) | (not logarithmic))
            axis.plot(np.where(drawn, row, np.nan), places, "o", color=colour)
            axis.plot(np.where(row < low, low, np.nan), places, "<", color=colour)
        axis.set(yticks=range(len(names)), yticklabels=list(names), ylim=(len(names) - 0.5, -0.5))
        if low > 0:
            log(axis, "x")
            # beside the names there is little room
            axis.xaxis.get_major_locator().set_params(numticks=4)  # type: ignore[call-arg]
        else:
            axis.set_xlim(left=0, right=axis.get_xlim()[1] * 1.03)  # no mark is cut at the edge

    rows = [
        f"{name}: {', '.join(f'{predictor.label} {short(row[k])}' for predictor, row in values.items())}"
        for k, name in enumerate(names)
    ]
    return Panel(title, f"{'; '.join(rows)}.", draw)


def delays(evaluation: EvaluationData) -> Figure | None:
    """One panel per predictor; None where the pipeline asks for no map."""
    maps = {each: row.map for each, row in evaluation.models.items() if row.map and each.epoch is None}
    if not maps:
        return None
    exact = np.array(maps[NUMERICAL].converged)
    panels = []
    for predictor, cells in maps.items():
        converged = np.array(cells.converged)
        missed = exact & ~converged

        def draw(axis: Axes, predictor: PredictorId = predictor, cells: DelayMap = cells) -> None:
            x, y = np.meshgrid(cells.D_hat, cells.D)
            converged, colour = np.array(cells.converged), line_of(predictor).colour
            missed = exact & ~converged
            size = min(90.0, 2600 / max(converged.shape) ** 1.6)
            ring = {"facecolors": "none", "edgecolors": ROLES["frozen"][0], "linewidths": 1.4}
            axis.scatter(x[converged], y[converged], size, colour, marker="s", linewidths=0)
            axis.scatter(x[~converged], y[~converged], size / 2, ROLES["muted"][0], marker="x", linewidths=1.0)
            axis.scatter(x[missed], y[missed], 2.2 * size, marker="o", **ring)
            axis.set(xlabel=timed(evaluation.plant, "D̂(0)"), ylabel=timed(evaluation.plant, "D"))
            axis.margins(0.08)
            axis.grid(False)

        total = converged.size if predictor == NUMERICAL else exact.sum()
        beside = "" if predictor == NUMERICAL else f"; {missed.sum()} others converge with the numerical predictor only"
        alt = f"{predictor.label} converges in {converged.sum()} of {converged.size} cells of D by D̂(0){beside}."
        panels.append(Panel(f"{predictor.label}: {(converged & exact).sum()} of {total}", alt, draw))
    caption = (
        "Loops from the same state, for each true delay D and first estimate D̂(0). Square: the loop converges; cross: "
        "it does not; ringed: only the numerical predictor's does. A network's count is of those cells in which the "
        "numerical predictor's loop converges."
    )
    entries = [
        LegendEntry("converges", LineStyle("ink", MARK, marker="s")),
        LegendEntry("does not", LineStyle("muted", MARK, marker="x")),
    ]
    return Figure("delays", "Delays and first estimates", caption, panels, entries)


def margin(plant: Plant, name: str, D: float) -> Figure:
    """The real part of the rightmost root over D_hat - D, the margin shaded; raises as npred.delay_margin does."""
    low, high = delay_margin(plant, D)
    loop = MismatchedLoop(plant, D)
    errors = np.linspace(max(BEYOND * low, -D), BEYOND * (high if np.isfinite(high) else FAR * D), POINTS)
    rates = np.array([loop.rightmost(max(D + error, 0.0)) for error in errors])

    def draw(axis: Axes) -> None:
        axis.axvspan(low, min(high, errors[-1]), color=ROLES["fill"][0], linewidth=0)
        axis.axhline(0.0, color=ROLES["muted"][0], linewidth=0.8)
        axis.plot(errors, rates, color=ROLES["blue"][0], linewidth=1.4)
        axis.set(xlabel=timed(plant, "D̂ − D"), xlim=(errors[0], errors[-1]))

    first, last = (plant.time_text(end, ".4g") if np.isfinite(end) else "any longer one" for end in (low, high))
    caption = (
        f"Small states of the loop of {plant.name}, D = {plant.time_text(D)}, with a constant D̂ decay where the "
        f"rightmost root is left of 0: for D̂ − D from {first} to {last}, shaded."
    )
    title = with_unit("rightmost root, real part", f"1/{plant.time_unit}")
    return Figure(name, "The delay margin", caption, [Panel(title, caption, draw)])
