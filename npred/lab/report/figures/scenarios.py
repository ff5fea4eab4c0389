"""Loops under other conditions: the map D x D_hat(0), and the cases in each scenario, the predictors beside."""

from collections.abc import Callable, Sequence

import numpy as np

from npred.lab.config.results import NUMERICAL, PredictorId
from npred.lab.config.results.evaluate import Behaviour, Conditions, DelayMap
from npred.lab.report.figures.evaluation_data import EvaluationData
from npred.lab.report.figures.figure import Figure, LegendEntry, Panel
from npred.lab.report.figures.notation import common_unit, timed, with_unit
from npred.lab.report.figures.style import ROLES, Axes, LineStyle, line_of, log, short
from npred.plants import Plant

MARK = (0.01, 9)  # a dash that leaves a legend's marker alone
SPREAD = 0.5  # of a scenario's room, between its first and its last predictor
REACH = 1e-4  # of the largest value: further left on a logarithmic side are arrows, or they would squeeze the rest


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
    lost = ", ".join(f"{each.label} {sum(one.models[each].lost for one in conditions)}" for each in predictors)
    caption = (
        f"The cases again under {len(conditions)} other conditions, each predictor from the same states with the same "
        "noise. An arrow points to what is still smaller; what is infinite, of a loop that diverges or does not "
        f"settle, has no mark. Lost loops: {lost}."
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
            x, y = np.meshgrid(cells.D_hat0, cells.D)
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
        beside = "" if predictor == NUMERICAL else f"; {missed.sum()} lost that the numerical predictor keeps"
        alt = f"{predictor.label} converges in {converged.sum()} of {converged.size} cells of D by D̂(0){beside}."
        panels.append(Panel(f"{predictor.label}: {(converged & exact).sum()} of {total}", alt, draw))
    caption = (
        "Loops from the same state, for each true delay D and first estimate D̂(0). Square: the loop converges; cross: "
        "it does not; ringed: only the numerical predictor's does. A network's count is of those cells in which the "
        "numerical predictor's loop converges."
    )
    entries = [
        LegendEntry("converges", LineStyle("ink", MARK, marker="s")),
        LegendEntry("lost", LineStyle("muted", MARK, marker="x")),
    ]
    return Figure("delays", "Delays and first estimates", caption, panels, entries)
