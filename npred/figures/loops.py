"""The loop of [DAPF, Fig. 1] with each predictor: states, input and delay estimate, differences, and coverage."""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import Any, cast

import numpy as np

from npred.figures.evaluation_data import EvaluationData, Histogram, LoopSeries
from npred.figures.figure import Figure, LegendEntry, Panel
from npred.figures.notation import common_unit, quantity, symbol, timed, with_unit
from npred.figures.style import ROLES, Axes, LineStyle, log, look, short
from npred.loop import delay_law, lyapunov, metrics
from npred.results import NUMERICAL, PredictorId

GOAL = {"color": ROLES["muted"][0], "linewidth": 0.8, "linestyle": (0, (1, 2)), "zorder": 0}
ROUNDS = 30  # of the fixed-point iteration for when a command acts


def figure1(evidence: EvaluationData) -> Figure:
    """x, U and D_hat over time [DAPF, Fig. 1], and how far each loop is from the numerical predictor's."""
    plant, columns = evidence.plant, {contender: _columns(loop) for contender, loop in evidence.loops.items()}
    t, time = evidence.loops[NUMERICAL].t, timed(plant, "t")
    goals, kept = _goals(evidence, t), _converging(evidence)
    panels = []
    for k, name in enumerate((*plant.states, *plant.inputs, "D_hat")):
        what = "" if name != "D_hat" else "delay " if plant.declares_delay else "delay estimate "
        title = what + quantity(plant, name)
        span = _around([goals[:, k], *(columns[c][:, k] for c in kept)], [series[:, k] for series in columns.values()])
        panels.append(Panel(title, _alt(title, k, columns, t), partial(_over_time, t, columns, k, goals, span, time)))
    apart = _apart(evidence)
    if apart:
        title = with_unit("difference from the numerical loop", common_unit(plant, plant.states))
        panels.append(Panel(title, _alt_apart(apart), partial(_curves, t, apart, time)))
    return Figure("figure1", "The closed loop", _caption(evidence, apart), tuple(panels), keys(evidence.loops))


def figure1_bounded(evidence: EvaluationData) -> Figure | None:
    """The same of the loops with U within `figure_bounds`; None where there are none."""
    table = evidence.config.bounded
    if table is None:
        return None
    plate = figure1(replace(evidence, config=table, loops=evidence.bounded))
    return replace(plate, name="figure1_bounded", title="The closed loop, U within bounds")


def _apart(evidence: EvaluationData) -> dict[PredictorId, np.ndarray]:
    """|X - X of the numerical predictor's loop| over time, (nt,): curves on one another have a distance here."""
    exact = evidence.loops[NUMERICAL].X
    every = {c: np.linalg.norm(loop.X - exact, axis=1) for c, loop in evidence.loops.items()}
    return {c: values for c, values in every.items() if np.any((values > 0) & np.isfinite(values))}


def _alt_apart(apart: dict[PredictorId, np.ndarray]) -> str:
    largest = "; ".join(f"{c.label} {short(np.max(values))}" for c, values in apart.items())
    return f"|X − X of the numerical loop| on a logarithmic scale, at most: {largest}."


def _caption(evidence: EvaluationData, apart: dict[PredictorId, np.ndarray]) -> str:
    plant, config = evidence.plant, evidence.config
    D, D_hat0 = map(plant.time_text, (config.D, config.D_hat0))
    delay = "the delay that the plant declares" if plant.declares_delay else f"D = {D} and D̂(0) = {D_hat0}"
    goal = "the delay there" if plant.declares_delay else "the true delay"
    of = f" [{plant.figure}]" if plant.figure else ""
    where, start = "rest" if plant.rests else "the reference", ", ".join(f"{value:g}" for value in config.X0)
    near = ", ".join(f"{c.label} {short(np.max(apart[c]))}" for c in _converging(evidence) if c in apart)
    said = f" Lines that lie on each other differ from the numerical loop by at most: {near}." if near else ""
    return (
        f"One closed loop{of} from X(0) = ({start}) with {delay}, run with each "
        f"predictor{_limits(evidence)}. Grey and dotted: {where}, and {goal}. "
        f"A loop that does not converge may leave the picture.{said}"
    )


def _limits(evidence: EvaluationData) -> str:
    """The bounds of U, where a pipeline gives some; that there are none, where it draws a bounded loop too."""
    plant, bounds = evidence.plant, evidence.config.input_bounds
    if bounds is None:
        return ", U without bounds" if evidence.bounded and plant.input_bounds is None else ""
    ranges = zip(plant.inputs, bounds, strict=True)
    return "".join(
        f", {symbol(plant, name)} in [{low:g}, {high:g}]".replace("inf", "∞") for name, (low, high) in ranges
    )


def _converging(evidence: EvaluationData) -> list[PredictorId]:
    """The contenders whose loops a panel has to show whole: the numerical predictor's, and all that end settled.

    A loop that is lost may leave the picture, so that the others can be distinguished.
    """
    kept = []
    for contender, loop in evidence.loops.items():
        target, run = evidence.plant.target(loop.t), cast(Any, loop)  # t and X of Trajectories, all that a radius takes
        if contender == NUMERICAL or metrics.converged(metrics.radius(run, target), target):
            kept.append(contender)
    return kept


def ends(evidence: EvaluationData) -> tuple[Panel, ...]:
    """The distance to rest, and W(t) of the stability proof where the update law runs, along the loops of figure1."""
    plant, config = evidence.plant, evidence.config
    distance = {c: np.linalg.norm(loop.X - plant.target(loop.t), axis=1) for c, loop in evidence.loops.items()}
    proven = {c: loop for c, loop in evidence.loops.items() if np.isfinite(loop.N).any()}
    law = delay_law.resolve(config, plant)
    gamma = law.gamma if law else 1.0  # then no W is shown
    W = {c: lyapunov.W(loop.N, config.D, loop.D_hat, gamma, config.b) for c, loop in proven.items()}
    t = evidence.loops[NUMERICAL].t
    last = "; ".join(f"{c.label} {values[-1]:.1e}" for c, values in distance.items())
    falls = "; ".join(f"{c.label} from {values[0]:.3g} to {values[-1]:.3g}" for c, values in W.items())
    caption = f"D log N + (b / γ) (D − D̂)², with b = {config.b:g}, γ = {gamma:g}: {falls}."
    return (
        Panel(with_unit("distance |X − X*|", common_unit(plant, plant.states)),
              f"Over {plant.time_text(t[-1])} on a logarithmic scale; at the end: {last}.",
              partial(_curves, t, distance, timed(plant, "t"))),
        *([Panel("W(t) of the proof", caption, partial(_curves, t, W, timed(plant, "t")))] if W else []),
    )  # fmt: skip


def keys(contenders: Iterable[PredictorId]) -> tuple[LegendEntry, ...]:
    return tuple(LegendEntry(contender.label, look(contender)) for contender in contenders)


def _columns(loop: LoopSeries) -> np.ndarray:
    return np.concatenate([loop.X, loop.U, loop.D_hat[:, None]], axis=1)


def _goals(evidence: EvaluationData, t: np.ndarray) -> np.ndarray:
    """Where states and inputs are to go, the input leading by D, and the true delay, (nt, n + m + 1)."""
    plant, D = evidence.plant, np.full(len(t), evidence.config.D)
    acts = t + D
    if plant.declares_delay:
        D, acts = (t - t) + plant.delay(plant.target(t), t), t
        for _ in range(ROUNDS):  # s = t + D(target(s), s)
            acts = t + plant.delay(plant.target(acts), acts)
    X, u = (np.broadcast_to(goal, (len(t), goal.shape[-1])) for goal in (plant.target(t), plant.u_target(acts)))
    return np.concatenate([X, u, D[:, None]], axis=1)


def _over_time(
    t: np.ndarray, columns: dict[PredictorId, np.ndarray], k: int, goals: np.ndarray, span: tuple[float, float],
    time: str, axis: Axes,
) -> None:  # fmt: skip
    for contender, series in columns.items():
        axis.plot(t, series[:, k], **look(contender).line)
    axis.plot(t, goals[:, k], **GOAL)
    axis.set(xlabel=time, xlim=(t[0], t[-1]), ylim=span)


def _curves(t: np.ndarray, curves: dict[PredictorId, np.ndarray], time: str, axis: Axes) -> None:
    for contender, values in curves.items():
        positive = np.where(np.isfinite(values) & (values > 0), values, np.nan)
        axis.plot(t, positive, **look(contender).line)
    axis.set(xlabel=time, xlim=(t[0], t[-1]))
    log(axis, "y")


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


def _alt(name: str, k: int, columns: dict[PredictorId, np.ndarray], t: np.ndarray) -> str:
    ends = "; ".join(f"{c.label} {values[0, k]:.4g} to {values[-1, k]:.4g}" for c, values in columns.items())
    return f"{name} from t = 0 to {t[-1]:g}: {ends}."


def coverage(evidence: EvaluationData) -> Figure:
    """A panel per state, an input, and the delay estimate."""
    histograms = {quantity(evidence.plant, name): each for name, each in evidence.coverage.items()}
    panels = [
        Panel(f"density of {name}", f"The data cover {name} from {each.edges[0]:.4g} to {each.edges[-1]:.4g}.",
              partial(_histogram, each))
        for name, each in histograms.items()
    ]  # fmt: skip
    caption = (
        "Filled: the training data; lines: what the closed loops visit. Upwards: the share per unit of the quantity, "
        "on a logarithmic scale. A network is only "
        "reliable where it was trained."
    )
    marks = LegendEntry("data", LineStyle("fill", (), 5)), *keys(next(iter(histograms.values())).loops)
    return Figure("coverage", "Coverage of the data", caption, tuple(panels), marks)


def _histogram(histogram: Histogram, axis: Axes) -> None:
    edges = histogram.edges
    axis.stairs(histogram.data, edges, fill=True, color=ROLES["fill"][0])
    for contender, density in histogram.loops.items():
        line = look(contender).line
        axis.stairs(density, edges, color=line["color"], linestyle=line["linestyle"], linewidth=1.0)
    axis.set(xlim=(edges[0], edges[-1]))
    log(axis, "y")
