"""What a sweep found, one row a trained network of a cell."""

from collections.abc import Iterator, Mapping
from typing import Any

from npred.pipeline import CellRun
from npred.sweep.sweep_grid import Cell

REFERENCES = ("numerical", "no_adaptation")


def rows(cell: Cell, run: CellRun) -> Iterator[dict[str, Any]]:
    """The cell's values, the network, its errors, radius and latency, and the artifact that says so.

    Errors and radius are of the evaluate stage, or of the network's own training where that is all that ran; the
    latency, in µs, is the fastest runtime's for one call at the bench stage's first dx.
    """
    artifacts = {name: outcome.artifact for name, outcome in run.outcomes.items()}
    answers = {name: artifact.result() for name, artifact in artifacts.items()}
    for model, found in _models(run, answers).items():
        figures = _figures(found) | {"latency_us": _latency(answers.get("bench", {}), model, cell)}
        source = list(artifacts)[-1] if "evaluate" in answers else model
        yield {**cell.values, "model": model, **figures, "artifact": artifacts[source].name}


def _models(run: CellRun, answers: Mapping[str, Any]) -> dict[str, Any]:
    if "evaluate" in answers:
        return {name: found for name, found in answers["evaluate"]["models"].items() if name not in REFERENCES}
    return {node.name: answers[node.name] for node in run.nodes if node.model}


def _figures(found: Mapping[str, Any]) -> dict[str, float | None]:
    radius = found.get("radius") or {}
    errors = {name: found.get(name) for name in ("mse", "eps_sup", "eps_kappa")}
    return errors | {
        "radius": radius.get("median"),
        "radius_worst": radius.get("worst"),
        "converged": radius.get("converged"),
    }


def _latency(bench: Mapping[str, Any], model: str, cell: Cell) -> float | None:
    dx = cell.config.bench.dx[0]
    times = [
        row["median_us"]
        for row in bench.get("rows", ())
        if (row["predictor"], row["batch"]) == (model, 1) and abs(row["dx"] - dx) < dx / 10 and not row.get("matches")
    ]
    return min(times, default=None)
