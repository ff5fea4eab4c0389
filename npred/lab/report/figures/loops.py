"""The loop of [DAPF, Fig. 1] with each predictor: states, input and delay estimate, differences, and coverage."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np

from npred.lab.config import conditions
from npred.lab.config.results import NUMERICAL, PredictorId
from npred.lab.report.figures.evaluation_data import EvaluationData, Histogram
from npred.lab.report.figures.figure import Figure, LegendEntry, Panel, legend
from npred.lab.report.figures.notation import common_unit, quantity, symbol, timed, with_unit
from npred.lab.report.figures.style import DOTTED, ROLES, Axes, LineStyle, line_of, log, positive, short
from npred.loop import lyapunov, metrics

GOAL: dict[str, Any] = DOTTED | {"linewidth": 0.8, "zorder": 0}
ROUNDS = 30  # of the fixed-point iteration for when a command acts


def figure1(evaluation: EvaluationData) -> Figure:
    """x, U and D_hat over time [DAPF, Fig. 1], and how far each loop is from the numerical predictor's."""
    plant, loops, t = evaluation.plant, evaluation.loops, evaluation.loops[NUMERICAL].t
    columns = {predictor: np.column_stack([loop.X, loop.U, loop.D_hat]) for predictor, loop in loops.items()}
    kept, panels = _converging(evaluation), []
    for k, (name, goal) in enumerate(_goals(evaluation, t).items()):
        series = {predictor: values[:, k] for predictor, values in columns.items()}
        what = "" if name != "D_hat" else "delay " if plant.declares_delay else "delay estimate "
        span = _around([goal, *(series[predictor] for predictor in kept)], [*series.values()])
        ends = "; ".join(f"{predictor.label} {each[0]:.4g} to {each[-1]:.4g}" for predictor, each in series.items())
        title = what + quantity(plant, name)
        alt = f"{title} from t = 0 to {t[-1]:g}: {ends}."

        def draw(axis: Axes, series: Any = series, goal: Any = goal, span: Any = span) -> None:
            for predictor, values in series.items():
                axis.plot(t, values, **line_of(predictor).line)
            axis.plot(t, goal, **GOAL)
            axis.set(xlabel=timed(plant, "t"), xlim=(t[0], t[-1]), ylim=span)

        panels.append(Panel(title, alt, draw))
    exact = loops[NUMERICAL].X
    apart = {predictor: np.linalg.norm(loop.X - exact, axis=1) for predictor, loop in loops.items()}
    apart = {predictor: each for predictor, each in apart.items() if np.any((each > 0) & np.isfinite(each))}
    if apart:  # curves that lie on one another have a distance here
        title = with_unit("difference from the numerical loop", common_unit(plant, plant.states))
        largest = "; ".join(f"{predictor.label} {short(np.max(each))}" for predictor, each in apart.items())
        alt = f"|X − X of the numerical loop| on a logarithmic scale, at most: {largest}."
        panels.append(Panel(title, alt, _curves(t, apart, timed(plant, "t"))))
    near = ", ".join(f"{predictor.label} {short(np.max(apart[predictor]))}" for predictor in kept if predictor in apart)
    config = evaluation.config
    D, D_hat0 = map(plant.time_text, (config.D, config.D_hat0))
    delay = "the delay that the plant declares" if plant.declares_delay else f"D = {D} and D̂(0) = {D_hat0}"
    caption = (
        f"One closed loop{f' [{plant.figure}]' if plant.figure else ''} "
        f"from X(0) = ({', '.join(f'{value:g}' for value in config.X0)}) with {delay}, run with each "
        f"predictor{_limits(evaluation)}. Grey and dotted: {'rest' if plant.rests else 'the reference'}, and "
        f"{'the delay there' if plant.declares_delay else 'the true delay'}. "
        "A loop that does not converge may leave the picture."
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


def _limits(evaluation: EvaluationData) -> str:
    """The bounds of U, where a pipeline gives some; that there are none, where it draws a bounded loop too."""
    plant, bounds = evaluation.plant, evaluation.config.input_bounds
    if bounds is None:
        return ", U without bounds" if evaluation.bounded and plant.input_bounds is None else ""
    ranges = zip(plant.inputs, bounds, strict=True)
    return "".join(
        f", {symbol(plant, name)} in [{low:g}, {high:g}]".replace("inf", "∞") for name, (low, high) in ranges
    )


def _converging(evaluation: EvaluationData) -> list[PredictorId]:
    """The predictors whose loops a panel has to show whole: the numerical one, and all whose loop ends settled.

    A loop that is lost may leave the picture, so that the others can be distinguished.
    """
    kept = []
    for predictor, loop in evaluation.loops.items():
        target, run = evaluation.plant.target(loop.t), cast(Any, loop)  # a radius takes only t and X of Trajectories
        if predictor == NUMERICAL or metrics.converged(metrics.radius(run, target), target):
            kept.append(predictor)
    return kept


def _goals(evaluation: EvaluationData, t: np.ndarray) -> dict[str, np.ndarray]:
    """By name where states and inputs are to go, the input leading by D, and the true delay, (nt,) each."""
    plant, D = evaluation.plant, np.full(len(t), evaluation.config.D)
    acts = t + D
    if plant.declares_delay:
        D, acts = (t - t) + plant.delay(plant.target(t), t), t
        for _ in range(ROUNDS):  # s = t + D(target(s), s)
            acts = t + plant.delay(plant.target(acts), acts)
    X, u = (np.broadcast_to(goal, (len(t), goal.shape[-1])) for goal in (plant.target(t), plant.u_target(acts)))
    return dict(zip((*plant.states, *plant.inputs, "D_hat"), (*X.T, *u.T, D), strict=True))


def _around(series: list[np.ndarray], others: list[np.ndarray]) -> tuple[float, float]:
    """The range of all series, and of those others that leave it by less than its height; with room on both sides."""
    low, high = _ends(np.concatenate(series)) or (0.0, 1.0)
    near = [ends for ends in map(_ends, others) if ends and max(low - ends[0], ends[1] - high) < high - low]
    low, high = min([low, *(a for a, _ in near)]), max([high, *(b for _, b in near)])
    room = 0.15 * (high - low) or 1.0
    return low - room, high + room


def _ends(values: np.ndarray) -> tuple[float, float] | None:
    """The least and the largest of the finite values; None where there is none."""
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if len(finite) else None


def _curves(t: np.ndarray, curves: Mapping[PredictorId, np.ndarray], time: str) -> Callable[[Axes], None]:
    """Draws positive curves over time, on a logarithmic side."""

    def draw(axis: Axes) -> None:
        for predictor, values in curves.items():
            axis.plot(t, positive(values), **line_of(predictor).line)
        axis.set(xlabel=time, xlim=(t[0], t[-1]))
        log(axis, "y")

    return draw


def ends(evaluation: EvaluationData) -> list[Panel]:
    """The distance to rest, and W(t) of the stability proof where the update law runs, along the loops of figure1."""
    plant, config, t = evaluation.plant, evaluation.config, evaluation.loops[NUMERICAL].t
    distance = {c: np.linalg.norm(loop.X - plant.target(loop.t), axis=1) for c, loop in evaluation.loops.items()}
    last = "; ".join(f"{predictor.label} {values[-1]:.1e}" for predictor, values in distance.items())
    title = with_unit("distance |X − X*|", common_unit(plant, plant.states))
    alt = f"Over {plant.time_text(t[-1])} on a logarithmic scale; at the end: {last}."
    panels = [Panel(title, alt, _curves(t, distance, timed(plant, "t")))]
    proven = {predictor: loop for predictor, loop in evaluation.loops.items() if np.isfinite(loop.N).any()}
    if proven:
        law = conditions.adaptation(config, plant)
        gamma = law.gamma if law else 1.0
        W = {c: lyapunov.W(loop.N, config.D, loop.D_hat, gamma, config.b) for c, loop in proven.items()}
        falls = "; ".join(f"{c.label} from {values[0]:.3g} to {values[-1]:.3g}" for c, values in W.items())
        alt = f"D log N + (b / γ) (D − D̂)², with b = {config.b:g}, γ = {gamma:g}: {falls}."
        panels.append(Panel("W(t) of the proof", alt, _curves(t, W, timed(plant, "t"))))
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
