"""The table of a sweep's results, one row per trained network of a cell."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from npred.pipeline import CellRun
from npred.results import Benched, Contender, Evaluated, Trained
from npred.results.evaluate import Scores
from npred.sweep.sweep_grid import Cell


def rows(cell: Cell, run: CellRun) -> Iterator[dict[str, Any]]:
    """The cell's values, the network, its errors, radius and latency, and the artifact that says so.

    Errors and radius are of the evaluate stage, or of the network's training where that is all that ran; the
    latency, in µs, is the fastest runtime's for one call at the bench stage's first dx.
    """
    artifacts = {name: outcome.artifact for name, outcome in run.outcomes.items()}
    folders = {name: artifact.folder for name, artifact in artifacts.items()}
    benched = Benched.read(folders["bench"]) if "bench" in folders else None
    for contender, measured in _measured(run, folders).items():
        figures = _figures(measured) | {"latency_us": _latency(benched, contender, cell.config.bench.dx[0])}
        source = list(artifacts)[-1] if "evaluate" in artifacts else contender.model
        yield {**cell.values, "model": contender.name, **figures, "artifact": artifacts[source].name}


def _measured(run: CellRun, folders: dict[str, Path]) -> dict[Contender, Scores] | dict[Contender, Trained]:
    if "evaluate" in folders:
        models = Evaluated.read(folders["evaluate"]).models
        return {contender: scores for contender, scores in models.items() if contender.is_network}
    return {Contender(node.model): Trained.read(folders[node.name]) for node in run.nodes if node.model}


def _figures(measured: Scores | Trained) -> dict[str, float | None]:
    """By column; None for what is not known, and for what is not finite."""
    numbers = {"mse": measured.mse, "eps_sup": measured.eps_sup}
    if isinstance(measured, Scores):
        radius = measured.radius
        numbers |= {"eps_kappa": measured.eps_kappa, "radius": radius.median, "radius_worst": radius.worst}
        numbers |= {"converged": radius.converged}
    keys = ("mse", "eps_sup", "eps_kappa", "radius", "radius_worst", "converged")
    return {key: number if math.isfinite(number := numbers.get(key, math.nan)) else None for key in keys}


def _latency(benched: Benched | None, contender: Contender, dx: float) -> float | None:
    rows = benched.table if benched and contender.epoch is None else []
    times = [row.median_us for row in rows if row.predictor == contender.model and abs(row.dx - dx) < dx / 10]
    return min(times, default=None)
