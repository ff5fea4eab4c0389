"""A certificate's part about searches: an adversary's, for errors and for blind spots of the guard, and of the bound.

`npred certify` takes it from here, by the entry point group `npred.certificates`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from npred.base.errors import required
from npred.guard.guarded import Guarded
from npred.lab.config.conditions import box
from npred.lab.config.results import PredictorId
from npred.lab.scheduler.job import Job
from npred.lab.stages.certify import rollouts
from npred.lab.stages.certify.rollouts import Calls, Rollouts
from npred.lab.training.data import shards
from npred.lab.training.data.dataset import Dataset
from npred.plants import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods import Predictor
from npred_experiments import adversary
from npred_experiments.bounds import ErrorBound
from npred_experiments.evolution import Inputs

KEPT = 1000  # the worst inputs that are kept
NEAR = 0.3, 3.0  # in tolerances: between them the estimate decides
QUANTILES = 0.01, 0.5, 0.99
BOUNDED = 1000  # rollouts whose worst samples are bounded too


def check(plant: Plant) -> None:
    """Raise MissingError where the search needs torch and there is none."""
    if adversary.climbs(plant):
        required("certify: the gradient of a network", "torch", "torch", "train")


def certify(
    job: Job, guards: Mapping[PredictorId, Guarded], exact: Predictor, fresh: Mapping[PredictorId, Rollouts]
) -> dict[PredictorId, dict[str, Any]]:
    """Fields of each network's certificate. Writes worst.h5."""
    data = shards.survey(job.inputs["generate"] / "data.h5")
    with job.threads() as pool:
        searches = {c: pool.submit(search, job, data, guard.model) for c, guard in guards.items()}
        blind = {c: pool.submit(blind_spots, job, data, guard, exact) for c, guard in guards.items()}
        calls = {c: done.result() for c, done in searches.items()}
        rows = {
            c: bounded(guard, fresh[c]) | judged(guard, exact, calls[c][0]) | blind[c].result()
            for c, guard in guards.items()
        }
    write_worst(job.folder / "worst.h5", calls)
    return rows


def write_worst(path: Path, calls: Mapping[PredictorId, tuple[Calls, np.ndarray]]) -> None:
    """Write X, u, D_hat, t and the error of the KEPT worst calls, by network."""
    with h5py.File(path, "w") as file:
        for contender, (inputs, errors) in calls.items():
            worst = np.argsort(np.nan_to_num(errors))[::-1][:KEPT]
            for name, values in zip(("X", "u", "D_hat", "t", "error"), (*inputs, errors), strict=True):
                file[f"{contender.name}/{name}"] = values[worst]


def search(job: Job, data: Dataset, network: Predictor) -> tuple[Calls, np.ndarray]:
    """The calls of a search for large errors of a network, and the errors."""
    table, inputs = job.config.optional("certify"), Inputs.of(data, box(job.plant, job.config.generate), job.plant)
    with job.progress.bar(f"adversary {network.name}", table.restarts * table.steps, "calls") as bar:
        return adversary.search(job.plant, network, data, inputs, table, job.config.seed, bar.advance)


def blind_spots(job: Job, data: Dataset, guard: Guarded, exact: Predictor) -> dict[str, Any]:
    """The calls of a search for blind spots that the guard lets pass."""
    table, inputs = job.config.optional("certify"), Inputs.of(data, box(job.plant, job.config.generate), job.plant)
    with job.progress.bar(f"blind spots of {guard.name}", table.restarts * table.steps, "calls") as bar:
        calls, _ = adversary.blind_spots(guard, exact, data, inputs, table, job.config.seed, bar.advance)
    true, _, passed = rollouts.judged(guard, exact, *calls, nearest=True)
    above = int((passed & (true > guard.tolerance)).sum())
    return {"blind_calls": len(true), "blind": above, "blind_error": true[passed].max(initial=0.0)}


def bounded(guard: Guarded, fresh: Rollouts) -> dict[str, Any]:
    """The bound of U's error over the error, at the worst samples of the first rollouts; nothing without a bound."""
    if problem_of(guard.plant).refusal("bound"):
        return {"bound": [], "bounded": None}
    calls = [a[:BOUNDED] for a in fresh.worst]
    bounds = ErrorBound.of(guard)(guard.model(*calls), *calls)
    finite = np.isfinite(bounds)
    ratio = bounds[finite] / np.maximum(fresh.errors[:BOUNDED][finite], np.finfo(float).tiny)
    return {"bound": np.quantile(ratio, QUANTILES).tolist() if finite.any() else [], "bounded": float(finite.mean())}


def judged(guard: Guarded, exact: Predictor, inputs: Calls) -> dict[str, Any]:
    """The guard's verdict on an adversary's calls. The error is that against the predictor that falls back."""
    true, estimates, passed = rollouts.judged(guard, exact, *inputs)
    above = true > guard.tolerance
    near = (true > NEAR[0] * guard.tolerance) & (true < NEAR[1] * guard.tolerance)
    ratio = np.quantile(estimates[near] / true[near], QUANTILES).tolist() if near.any() else []
    return {
        "adversarial": np.nanmax(true), "adversarial_median": np.median(true), "calls": len(true),
        "above": int(above.sum()), "unnoticed": int((above & passed).sum()), "ratio": ratio,
    }  # fmt: skip
