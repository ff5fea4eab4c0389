"""The front of accuracy, latency and radius: what no other network of a sweep beats in all of them."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from npred import figures
from npred.figures.figure import Panel, Plate
from npred.figures.loops import keys
from npred.figures.style import ROLES, log, look
from npred.results import Contender, ranked

AXES = {
    "eps_sup": "sup error ε",
    "latency_us": "µs per call",
    "radius_worst": "worst radius",
}
PAIRS = (("latency_us", "eps_sup"), ("eps_sup", "radius_worst"), ("latency_us", "radius_worst"))
NAMED = 20  # points of the front that have their row of the table beside them
SMALLEST = 1e-16  # where a radius of 0 is drawn on a logarithmic axis


def dominated(points: np.ndarray) -> np.ndarray:
    """A mask (N,) of the points (N, k) for which another is nowhere larger and somewhere smaller."""
    beaten = np.zeros(len(points), dtype=bool)
    for index, point in enumerate(points):
        beaten[index] = ((points <= point).all(axis=1) & (points < point).any(axis=1)).any()
    return beaten


def front(rows: Sequence[Mapping[str, Any]]) -> list[bool]:
    """One boolean per row: it is on the front of those of error, latency and radius that are known.

    A loop that is lost or an error that is not finite (None) is beaten by any number, and never on the front.
    """
    axes = measured_axes(rows)
    points = np.array([[np.inf if row[axis] is None else row[axis] for axis in axes] for row in rows], dtype=float)
    if not axes:
        return [False] * len(rows)
    return (~dominated(points) & np.isfinite(points).all(axis=1)).tolist()


def measured_axes(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The axes of which some row has a number."""
    return [axis for axis in AXES if any(row[axis] is not None for row in rows)]


def draw(folder: Path, rows: Sequence[Mapping[str, Any]]) -> list[Path]:
    """Write front.svg and front.png, a panel for each two axes that are known; no figure where one alone is.

    The numbers in it are the `row` of the table.
    """
    pairs = [pair for pair in PAIRS if set(pair) <= set(measured_axes(rows))]
    if not pairs:
        return []
    panels = tuple(
        Panel(f"{AXES[y]} versus {AXES[x]}", _alt(rows, x, y), partial(_panel, rows, x, y)) for x, y in pairs
    )
    caption = "One point per row of the table; the line is the front, and its numbers are the table's rows."
    figures.write(
        Plate("front", "The front", caption, panels, keys(_contenders(rows).values())),
        folder,
    )
    return [folder / "front.svg", folder / "front.png"]


def _contenders(rows: Sequence[Mapping[str, Any]]) -> dict[str, Contender]:
    contenders = ranked(Contender.parse(model) for model in dict.fromkeys(row["model"] for row in rows))
    return {contender.name: contender for contender in contenders}


def _alt(rows: Sequence[Mapping[str, Any]], x: str, y: str) -> str:
    shown = [row for row in rows if row[x] is not None and row[y] is not None]
    return f"{len(shown)} networks by {AXES[x]} and {AXES[y]}."


def _panel(rows: Sequence[Mapping[str, Any]], x: str, y: str, axis: Any) -> None:
    shown = [k for k, row in enumerate(rows) if row[x] is not None and row[y] is not None]
    points = np.maximum([[rows[k][x], rows[k][y]] for k in shown], SMALLEST).reshape(-1, 2)
    best = ~dominated(points)
    contenders = _contenders(rows)
    for model in dict.fromkeys(rows[k]["model"] for k in shown):
        of_model = np.array([rows[k]["model"] == model for k in shown])
        axis.plot(*points[of_model].T, "o", color=look(contenders[model]).colour)
    order = np.flatnonzero(best)[np.argsort(points[best, 0])]
    axis.plot(*points[order].T, color=ROLES["muted"][0], zorder=0, drawstyle="steps-post")
    for k in order[:NAMED]:
        axis.annotate(str(rows[shown[k]]["row"]), points[k], xytext=(4, 3), textcoords="offset points")
    axis.set_xlabel(AXES[x])
    log(axis, "x", "y")
