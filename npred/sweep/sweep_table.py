"""What a sweep found, one row a trained network of a cell."""

from collections.abc import Iterator, Mapping
from typing import Any

from npred.pipeline.stage_registry import STAGES
from npred.sweep.scheduler import Progress

REFERENCES = ("numerical", "no_adaptation")


def rows(progress: Progress) -> Iterator[dict[str, Any]]:
    """The cell's values, the network, its errors, radius and latency, and the artifact that says so.

    Errors and radius are of the evaluate stage, or of the network's own training where that is all that ran; the
    latency, in µs, is the fastest runtime's for one call at the bench stage's first dx.
    """
    artifacts = {name: made.artifact for name, made in progress.made.items() if made.artifact}
    answers = {name: artifact.result() for name, artifact in artifacts.items()}
    for model, found in _models(progress, answers).items():
        figures = _figures(found) | {"latency_us": _latency(answers.get("bench", {}), model, progress)}
        source = list(artifacts)[-1] if "evaluate" in answers else model
        yield {**progress.cell.values, "model": model, **figures, "artifact": artifacts[source].name}


def _models(progress: Progress, answers: Mapping[str, Any]) -> dict[str, Any]:
    if "evaluate" in answers:
        return {name: found for name, found in answers["evaluate"]["models"].items() if name not in REFERENCES}
    return {node.name: answers[node.name] for node in progress.nodes if node.model}


def _figures(found: Mapping[str, Any]) -> dict[str, float | None]:
    radius = found.get("radius") or {}
    errors = {name: found.get(name) for name in ("mse", "eps_sup", "eps_kappa")}
    return errors | {
        "radius": radius.get("median"),
        "radius_worst": radius.get("worst"),
        "converged": radius.get("converged"),
    }


def _latency(bench: Mapping[str, Any], model: str, progress: Progress) -> float | None:
    dx = progress.cell.config.bench.dx[0]
    times = [
        row["median_us"]
        for row in bench.get("rows", ())
        if (row["predictor"], row["batch"]) == (model, 1) and abs(row["dx"] - dx) < dx / 10 and not row.get("matches")
    ]
    return min(times, default=None)


def targets(to: str) -> list[str]:
    """The stages of a sweep up to `to`: a latency is worth little without its error, so bench takes evaluate along."""
    return ["evaluate", "bench"] if to == "bench" else [to]


def stages() -> list[str]:
    """The stages that a sweep can end with."""
    return list(STAGES)
