"""Loops under other conditions: the map D x D_hat(0), and the cases in each scenario, the predictors beside."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from npred.figures.evaluation_data import EvaluationData
from npred.figures.figure import Figure, LegendEntry, Panel
from npred.figures.notation import common_unit, timed, with_unit
from npred.figures.style import ROLES, Axes, LineStyle, log, look, short
from npred.plants import Plant
from npred.results import NUMERICAL, PredictorId
from npred.results.evaluate import Behaviour, Conditions, DelayMap

Values = dict[PredictorId, np.ndarray]  # one per scenario
SPREAD = 0.5  # of a scenario's room, between its first and its last predictor
REACH = 1e-4  # of the largest value: further left on a logarithmic side are arrows, or they would squeeze the rest


def scenarios(plant: Plant, conditions: Sequence[Conditions]) -> Figure | None:
    """A panel each for the worst radius, the settling time and |D_hat - D|; None where there are no scenarios."""
    if not conditions:
        return None
    panels = [
        _panel(with_unit("worst radius", common_unit(plant, plant.states)), conditions, lambda b: b.radius.worst, True),
        _panel(timed(plant, "settles after"), conditions, lambda b: b.settle_time, False),
    ]
    if not plant.declares_delay:
        panels.append(_panel(timed(plant, "|D̂ − D| at the end"), conditions, lambda b: b.D_error, True))
    lost = {c: sum(one.models[c].lost for one in conditions) for c in conditions[0].models}
    caption = (
        f"The cases again under {len(conditions)} other conditions, each predictor from the same states with the same "
        "noise. An arrow points to what is still smaller; what is infinite, of a loop that diverges or does not "
        f"settle, has no mark. Lost loops: {', '.join(f'{c.label} {count}' for c, count in lost.items())}."
    )
    marks = tuple(LegendEntry(c.label, LineStyle(look(c).role, (0.01, 9), marker="o")) for c in conditions[0].models)
    return Figure("scenarios", "Other conditions", caption, tuple(panels), marks)


def _panel(
    title: str, conditions: Sequence[Conditions], value: Callable[[Behaviour], float | None], logarithmic: bool
) -> Panel:
    names, contenders = [one.name for one in conditions], list(conditions[0].models)
    by_contender = {
        c: np.array([np.nan if (v := value(one.models[c])) is None else v for one in conditions], dtype=float)
        for c in contenders
    }
    return Panel(title, _alt(names, by_contender), partial(_marks, names, by_contender, logarithmic))


def _alt(names: Sequence[str], values: Values) -> str:
    rows = [
        f"{name}: {', '.join(f'{c.label} {short(series[k])}' for c, series in values.items())}"
        for k, name in enumerate(names)
    ]
    return f"{'; '.join(rows)}."


def _marks(names: Sequence[str], values: Values, logarithmic: bool, axis: Axes) -> None:
    """A mark per predictor on the line of each scenario, the first scenario on top; an arrow where it lies far left."""
    offsets = np.linspace(-SPREAD / 2, SPREAD / 2, len(values)) if len(values) > 1 else [0.0]
    finite = {c: np.where(np.isfinite(series), series, np.nan) for c, series in values.items()}
    low = REACH * np.nanmax([0.0, *np.concatenate(list(finite.values()))]) if logarithmic else 0.0
    for offset, (contender, series) in zip(offsets, finite.items(), strict=True):
        rows, colour = np.arange(len(names)) + offset, look(contender).colour
        drawn = (series >= low) & ((series > 0) | (not logarithmic))
        axis.plot(np.where(drawn, series, np.nan), rows, "o", color=colour)
        axis.plot(np.where(series < low, low, np.nan), rows, "<", color=colour)
    axis.set(yticks=range(len(names)), yticklabels=list(names), ylim=(len(names) - 0.5, -0.5))
    if low > 0:
        log(axis, "x")
        # beside the names there is little room
        axis.xaxis.get_major_locator().set_params(numticks=4)  # type: ignore[call-arg]
    else:
        axis.set_xlim(left=0, right=axis.get_xlim()[1] * 1.03)  # no mark is cut at the edge


def delays(evidence: EvaluationData) -> Figure | None:
    """One panel per predictor; None where the pipeline asks for no map."""
    maps = {c: scores.map for c, scores in evidence.models.items() if scores.map and c.epoch is None}
    if not maps:
        return None
    exact = np.array(maps[NUMERICAL].converged)
    axes = [timed(evidence.plant, delay) for delay in ("D̂(0)", "D")]
    panels = [
        Panel(_map_title(c, cells, exact), _alt_map(c, cells, exact), partial(_cells, c, cells, exact, axes))
        for c, cells in maps.items()
    ]
    caption = (
        "Loops from the same state, for each true delay D and first estimate D̂(0). Square: the loop converges; cross: "
        "it does not; ringed: only the numerical predictor's does. A network's count is of those cells in which the "
        "numerical predictor's loop converges."
    )
    marks = (
        LegendEntry("converges", LineStyle("ink", (0.01, 9), marker="s")),
        LegendEntry("lost", LineStyle("muted", (0.01, 9), marker="x")),
    )
    return Figure("delays", "Delays and first estimates", caption, tuple(panels), marks)


def _map_title(contender: PredictorId, cells: DelayMap, exact: np.ndarray) -> str:
    converged = np.array(cells.converged)
    total = converged.size if contender == NUMERICAL else exact.sum()
    return f"{contender.label}: {(converged & exact).sum()} of {total}"


def _alt_map(contender: PredictorId, cells: DelayMap, exact: np.ndarray) -> str:
    converged = np.array(cells.converged)
    lost = int((exact & ~converged).sum())
    beside = "" if contender == NUMERICAL else f"; {lost} lost that the numerical predictor keeps"
    return f"{contender.label} converges in {int(converged.sum())} of {converged.size} cells of D by D̂(0){beside}."


def _cells(contender: PredictorId, cells: DelayMap, exact: np.ndarray, labels: list[str], axis: Axes) -> None:
    x, y = np.meshgrid(cells.D_hat0, cells.D)
    converged = np.array(cells.converged)
    size = min(90.0, 2600 / max(converged.shape) ** 1.6)
    axis.scatter(x[converged], y[converged], size, look(contender).colour, marker="s", linewidths=0)
    axis.scatter(x[~converged], y[~converged], size / 2, ROLES["muted"][0], marker="x", linewidths=1.0)
    missed = exact & ~converged
    ring = {"facecolors": "none", "edgecolors": ROLES["frozen"][0], "linewidths": 1.4}
    axis.scatter(x[missed], y[missed], 2.2 * size, marker="o", **ring)
    axis.set(xlabel=labels[0], ylabel=labels[1])
    axis.margins(0.08)
    axis.grid(False)
