"""The map D x D_hat(0): which loops converge, each network beside the numerical predictor."""

from functools import partial
from typing import Any

import numpy as np

from npred.figures.evaluation_data import Evidence
from npred.figures.figure import Key, Panel, Plate
from npred.figures.notation import timed
from npred.figures.style import ROLES, Look, look
from npred.results import NUMERICAL, Contender
from npred.results.evaluate import DelayMap


def delays(evidence: Evidence) -> Plate | None:
    """One panel per predictor; None where the pipeline asks for no map."""
    maps = {c: scores.map for c, scores in evidence.models.items() if scores.map and c.epoch is None}
    if not maps:
        return None
    exact = np.array(maps[NUMERICAL].converged)
    axes = [timed(evidence.plant, delay) for delay in ("D̂(0)", "D")]
    panels = [
        Panel(_title(c, cells, exact), _alt(c, cells, exact), partial(_cells, c, cells, exact, axes))
        for c, cells in maps.items()
    ]
    caption = (
        "Loops from the same state, for each true delay D and first estimate D̂(0). Square: the loop converges; cross: "
        "it does not; ringed: only the numerical predictor's does. A network's count is of those cells in which the "
        "numerical predictor's loop converges."
    )
    marks = (Key("converges", Look("ink", (0.01, 9), marker="s")), Key("lost", Look("muted", (0.01, 9), marker="x")))
    return Plate("delays", "Delays and first estimates", caption, tuple(panels), marks)


def _title(contender: Contender, cells: DelayMap, exact: np.ndarray) -> str:
    converged = np.array(cells.converged)
    total = converged.size if contender == NUMERICAL else exact.sum()
    return f"{contender.label}: {(converged & exact).sum()} of {total}"


def _alt(contender: Contender, cells: DelayMap, exact: np.ndarray) -> str:
    converged = np.array(cells.converged)
    lost = int((exact & ~converged).sum())
    beside = "" if contender == NUMERICAL else f"; {lost} lost that the numerical predictor keeps"
    return f"{contender.label} converges in {int(converged.sum())} of {converged.size} cells of D by D̂(0){beside}."


def _cells(contender: Contender, cells: DelayMap, exact: np.ndarray, labels: list[str], axis: Any) -> None:
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
