"""The front of accuracy, latency and radius: what no other network of a sweep beats in all of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from npred.stages import drawing

AXES = {
    "eps_sup": "sup error ε over held-out rollouts",
    "latency_us": "latency of one call in µs",
    "radius_worst": "worst radius over the cases",
}
PAIRS = (("latency_us", "eps_sup"), ("eps_sup", "radius_worst"), ("latency_us", "radius_worst"))
NAMED = 20  # points of the front that have their row of the table beside them
SMALLEST = 1e-16  # where a radius of 0 is drawn on a logarithmic axis


def dominated(points: np.ndarray) -> np.ndarray:
    """Whether another point is nowhere larger and somewhere smaller, (N,) of points (N, k)."""
    found = np.zeros(len(points), dtype=bool)
    for index, point in enumerate(points):
        found[index] = ((points <= point).all(axis=1) & (points < point).any(axis=1)).any()
    return found


def front(rows: Sequence[Mapping[str, Any]]) -> list[bool]:
    """Whether each row is on the front of those of error, latency and radius that are known.

    A loop that is lost or an error that is not finite (None) is beaten by any number, and never on the front.
    """
    axes = known(rows)
    points = np.array([[np.inf if row[axis] is None else row[axis] for axis in axes] for row in rows], dtype=float)
    if not axes:
        return [False] * len(rows)
    return (~dominated(points) & np.isfinite(points).all(axis=1)).tolist()


def known(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The axes of which some row has a number."""
    return [axis for axis in AXES if any(row[axis] is not None for row in rows)]


def draw(folder: Path, rows: Sequence[Mapping[str, Any]]) -> list[Path]:
    """Write front.svg and front.png, a panel for each two axes that are known; no figure where one alone is.

    The numbers in it are the `row` of the table.
    """
    pairs = [pair for pair in PAIRS if set(pair) <= set(known(rows))]
    if not pairs:
        return []
    figure = drawing.figure(5.2 * len(pairs), 4.2)
    for panel, (x, y) in zip(figure.subplots(1, len(pairs), squeeze=False)[0], pairs, strict=True):
        _panel(panel, rows, x, y)
    drawing.save(figure, folder, "front")
    return [folder / "front.svg", folder / "front.png"]


def _panel(panel: Any, rows: Sequence[Mapping[str, Any]], x: str, y: str) -> None:
    shown = [k for k, row in enumerate(rows) if row[x] is not None and row[y] is not None]
    points = np.maximum([[rows[k][x], rows[k][y]] for k in shown], SMALLEST).reshape(-1, 2)
    best = ~dominated(points)
    for index, model in enumerate(dict.fromkeys(rows[k]["model"] for k in shown)):
        own = np.array([rows[k]["model"] == model for k in shown])
        panel.scatter(*points[own].T, s=22, color=drawing.COLOURS[index % len(drawing.COLOURS)], label=model)
    order = np.flatnonzero(best)[np.argsort(points[best, 0])]
    panel.plot(*points[order].T, color="0.6", zorder=0, drawstyle="steps-post")
    for k in order[:NAMED]:
        panel.annotate(str(rows[shown[k]]["row"]), points[k], fontsize=7, xytext=(4, 3), textcoords="offset points")
    panel.set(xscale="log", yscale="log", xlabel=AXES[x], ylabel=AXES[y])
    panel.tick_params(which="both", labelsize=7)
    panel.tick_params(axis="x", which="both", rotation=45)
    panel.legend(frameon=False, fontsize=8)
