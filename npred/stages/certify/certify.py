"""The certify stage: what is known of a network's error, by fresh rollouts, by an adversary, and in loops."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from npred import figures, randomness
from npred.conditions import EVERY, Condition, box
from npred.config import GuardTable
from npred.data import shards
from npred.data.dataset import Dataset
from npred.delays import problem_of
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.parallel import devices
from npred.plants import Plant
from npred.predictors import Predictor, numerical
from npred.predictors.guarded import Guarded
from npred.results import Certified, Contender
from npred.results.certify import Certificate
from npred.stages.certify import adversary, rollouts
from npred.stages.certify.evolution import Inputs
from npred.stages.certify.rollouts import Calls, Rollouts
from npred.stages.certify.table import Certify
from npred.stages.evaluate import networks
from npred.stages.generate import sampling
from npred.stages.job import Job
from npred.terminal.console import columns

KEPT = 1000  # of the worst inputs
NEAR = 0.3, 3.0  # of the tolerance: where the estimate decides
QUANTILES = 0.01, 0.5, 0.99
BOUNDED = 1000  # of the rollouts: their worst samples are bounded too


def run(job: Job) -> Certified:
    """For each network: errors of fresh rollouts, the worst inputs of a search, and loops, with and without a guard.

    Writes errors.h5 (the largest error of U of each rollout, by network), worst.h5 (X, u, D_hat, t and the error of the
    KEPT worst calls, by network) and certified (.svg, .png). The guard is that of [evaluate], or the default one.
    """
    config = job.config.evaluate
    adversary.check(job.plant)
    devices.torch_threads(1)  # the same bits on any machine; another network takes the other cores
    exact, table = numerical(config.predictor, job.plant, config.nx), config.guard or GuardTable()
    guards = {
        contender: Guarded(networks.load(job, contender), exact=exact, **dict(table))
        for contender in map(Contender, job.config.train.models)
    }
    by_rollout = rollouts.judge(job, guards, exact)
    loops = _loops(job, exact)
    calls, blind, bare, guarded = _searches(job, guards, exact)
    models = {
        contender: Certificate(
            **_rollouts(job.config.optional("certify"), by_rollout[contender]),
            **_bounds(guard, by_rollout[contender]),
            **_calls(guard, exact, calls[contender][0]),
            **blind[contender],
            **_behaviour(job.plant, loops, bare[contender], guarded[contender]),
        )
        for contender, guard in guards.items()
    }
    errors = {contender: fresh.errors for contender, fresh in by_rollout.items()}
    with h5py.File(job.folder / "errors.h5", "w") as file:
        for contender, values in errors.items():
            file[contender.name] = values
    _write_worst(job.folder, calls)
    lost, count = int(_lost(job.plant, loops).sum()), job.config.optional("certify").loops
    result = Certified(plant=job.plant.name, loops=count, lost_numerical=lost, models=models)
    if plate := figures.certified(job.plant, result, errors):
        figures.write(plate, job.folder)
    return result


def _searches(job: Job, guards: Mapping[Contender, Guarded], exact: Predictor) -> tuple[dict[Contender, Any], ...]:
    """Of each network the adversary's calls, what a search for blind spots finds, and the loops, bare and guarded."""
    data = shards.survey(job.inputs["generate"] / "data.h5")
    with job.threads() as pool:
        tasks = (
            {c: pool.submit(_search, job, data, guard.model) for c, guard in guards.items()},
            {c: pool.submit(_blind, job, data, guard, exact) for c, guard in guards.items()},
            {c: pool.submit(_loops, job, guard.model) for c, guard in guards.items()},
            {c: pool.submit(_loops, job, guard) for c, guard in guards.items()},
        )
        return tuple({c: done.result() for c, done in by_network.items()} for by_network in tasks)


def summary(result: Certified, width: int | None = None) -> str:
    """A sentence about what holds, and a row per network."""
    first = next(iter(result.models.values()))
    head = ["network", "ε κ", "adversary", "above", "unnoticed", "blind", "lost", "guarded", "fallback"]
    rows = [
        [contender.label, f"{c.eps_kappa:.1e}", f"{c.adversarial:.1e}", f"{c.above} of {c.calls}", str(c.unnoticed),
         f"{c.blind} of {c.blind_calls}", str(c.lost), str(c.lost_guarded), f"{c.fallback:.2%}"]
        for contender, c in result.models.items()
    ]  # fmt: skip
    about = (
        f"{result.plant}: {first.rollouts} fresh rollouts, {first.samples or 'some'} random samples of each: with a "
        f"confidence of {first.confidence:.4%} at most {first.probability:.2%} of rollouts so sampled have an error of "
        f"U, in its largest component, above ε κ\n"
        f"{result.loops} loops, {result.lost_numerical} lost with the numerical predictor; tolerance "
        f"{first.tolerance:g}"
    )
    return f"{about}\n\n{columns(head, rows, width, numbers=head[1:])}"


def _search(job: Job, data: Dataset, network: Predictor) -> tuple[Calls, np.ndarray]:
    table, inputs = job.config.optional("certify"), Inputs.of(data, box(job.plant, job.config.generate), job.plant)
    with job.progress.bar(f"adversary {network.name}", table.restarts * table.steps, "calls") as bar:
        return adversary.search(job.plant, network, data, inputs, table, job.config.seed, bar.advance)


def _blind(job: Job, data: Dataset, guard: Guarded, exact: Predictor) -> dict[str, Any]:
    """What a search for blind spots finds that the guard lets pass."""
    table, inputs = job.config.optional("certify"), Inputs.of(data, box(job.plant, job.config.generate), job.plant)
    with job.progress.bar(f"blind spots of {guard.name}", table.restarts * table.steps, "calls") as bar:
        calls, _ = adversary.blind_spots(guard, exact, data, inputs, table, job.config.seed, bar.advance)
    true, _, passed = rollouts.judged(guard, exact, *calls, nearest=True)
    return {
        "blind_calls": len(true), "blind": int((passed & (true > guard.tolerance)).sum()),
        "blind_error": true[passed].max(initial=0.0),
    }  # fmt: skip


def _write_worst(folder: Path, calls: Mapping[Contender, tuple[Calls, np.ndarray]]) -> None:
    with h5py.File(folder / "worst.h5", "w") as file:
        for contender, (inputs, errors) in calls.items():
            worst = np.argsort(np.nan_to_num(errors))[::-1][:KEPT]
            for name, values in zip(("X", "u", "D_hat", "t", "error"), (*inputs, errors), strict=True):
                file[f"{contender.name}/{name}"] = values[worst]


def _rollouts(table: Certify, fresh: Rollouts) -> dict[str, Any]:
    return {
        "probability": table.probability, "confidence": table.confidence, "rollouts": len(fresh.errors),
        "samples": table.samples, "eps_kappa": fresh.errors.max(), "median": np.median(fresh.errors),
        "fallback_rollouts": fresh.fallback,
    }  # fmt: skip


def _bounds(guard: Guarded, fresh: Rollouts) -> dict[str, Any]:
    """The bound of U's error over the error, at the worst samples of the first rollouts; nothing without a bound."""
    if problem_of(guard.plant).refusal("bound"):
        return {"bound": [], "bounded": None}
    calls = [a[:BOUNDED] for a in fresh.worst]
    bounds = guard.bound(*calls)
    finite = np.isfinite(bounds)
    ratio = bounds[finite] / np.maximum(fresh.errors[:BOUNDED][finite], np.finfo(float).tiny)
    return {"bound": np.quantile(ratio, QUANTILES).tolist() if finite.any() else [], "bounded": float(finite.mean())}


def _calls(guard: Guarded, exact: Predictor, inputs: Calls) -> dict[str, Any]:
    """What the guard makes of an adversary's calls. The error is that against the predictor that falls back."""
    true, estimates, passed = rollouts.judged(guard, exact, *inputs)
    above = true > guard.tolerance
    near = (true > NEAR[0] * guard.tolerance) & (true < NEAR[1] * guard.tolerance)
    ratio = np.quantile(estimates[near] / true[near], QUANTILES).tolist() if near.any() else []
    return {
        "adversarial": np.nanmax(true), "adversarial_median": np.median(true), "calls": len(true),
        "above": int(above.sum()), "unnoticed": int((above & passed).sum()), "tolerance": guard.tolerance,
        "by": guard.by, "ratio": ratio,
    }  # fmt: skip


def _loops(job: Job, predictor: Predictor) -> Trajectories:
    """Loops from fresh starts, delays and estimates as those of [generate], with the settings of [evaluate]."""
    config, number = job.config.evaluate, job.config.optional("certify").loops
    pipeline = rollouts.fresh(job.config, job.config.optional("certify"), number)
    X0, D, D_hat, _ = sampling.starts(pipeline.seed, pipeline.generate, job.plant, range(number))
    nominal = Condition(config, X0, D, D_hat, config.case_t_end, randomness.integer(pipeline.seed, "noise"))
    with job.progress.bar(f"loops of {predictor.name}", nominal.steps, "steps") as bar:
        return nominal.loops(job.plant, predictor, every=EVERY, progress=bar.advance)


def _behaviour(plant: Plant, loops: Trajectories, bare: Trajectories, guarded: Trajectories) -> dict[str, Any]:
    """What a network's loops do beside those of the numerical predictor."""
    kept = ~_lost(plant, loops)
    return {
        "lost": int((_lost(plant, bare) & kept).sum()),
        "lost_guarded": int((_lost(plant, guarded) & kept).sum()),
        "peak": _peak(plant, bare) / _peak(plant, loops),
        "peak_guarded": _peak(plant, guarded) / _peak(plant, loops),
        "fallback": guarded.fallback_share,
    }


def _lost(plant: Plant, loops: Trajectories) -> np.ndarray:
    return metrics.lost(loops, plant.target(loops.t))


def _peak(plant: Plant, loops: Trajectories) -> float:
    gaps = np.linalg.norm(loops.X - plant.target(loops.t), axis=-1)
    return float(gaps.max()) if np.isfinite(gaps).all() else np.inf
