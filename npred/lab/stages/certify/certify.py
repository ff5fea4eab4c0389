"""The certify stage: what is known of a network's error, by fresh rollouts, in loops, and by what packages search."""

from typing import Any

import h5py
import numpy as np

from npred.base import devices, randomness, registry
from npred.guard.guarded import Guarded
from npred.lab.config import GuardTable
from npred.lab.config.conditions import EVERY, Condition
from npred.lab.config.results import Certified, PredictorId
from npred.lab.config.results.certify import Certificate
from npred.lab.report import figures
from npred.lab.report.terminal.console import columns
from npred.lab.scheduler.job import Job
from npred.lab.stages.certify import rollouts
from npred.lab.stages.certify.rollouts import Rollouts
from npred.lab.stages.certify.table import Certify
from npred.lab.stages.evaluate import networks
from npred.lab.stages.generate import sampling
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant
from npred.prediction.methods import Predictor, numerical


def run(job: Job) -> Certified:
    """For each network: errors of fresh rollouts, the worst inputs of a search, and loops, with and without a guard.

    Writes errors.h5 (the largest error of U of each rollout, by network) and certified (.svg, .png). The guard is that
    of [evaluate], or the default one. Modules of the group `npred.certificates` say more of each network.
    """
    config, table = job.config.evaluate, job.config.optional("certify")
    more = [registry.CERTIFICATES.installed(name) for name in registry.CERTIFICATES.names()]
    for module in more:
        module.check(job.plant)
    devices.torch_threads(1)  # the same bits on any machine; another network takes the other cores
    exact, guard_table = numerical(config.predictor, job.plant, config.nx), config.guard or GuardTable()
    guards = {
        contender: Guarded(networks.load(job, contender), exact=exact, **dict(guard_table))
        for contender in map(PredictorId, job.config.train.models)
    }
    by_rollout = rollouts.judge(job, guards, exact)
    loops = _loops(job, exact)
    with job.threads() as pool:
        bare = {contender: pool.submit(_loops, job, guard.model) for contender, guard in guards.items()}
        guarded = {contender: pool.submit(_loops, job, guard) for contender, guard in guards.items()}
        rows: dict[PredictorId, dict[str, Any]] = {
            contender: {"tolerance": guard.tolerance}
            | _rollouts(table, by_rollout[contender])
            | _behaviour(job.plant, loops, bare[contender].result(), guarded[contender].result())
            for contender, guard in guards.items()
        }
    for module in more:
        for contender, fields in module.certify(job, guards, exact, by_rollout).items():
            rows[contender] |= fields
    errors = {contender: fresh.errors for contender, fresh in by_rollout.items()}
    with h5py.File(job.folder / "errors.h5", "w") as file:
        for contender, values in errors.items():
            file[contender.name] = values
    models = {contender: Certificate(**row) for contender, row in rows.items()}
    lost = int(_lost(job.plant, loops).sum())
    result = Certified(plant=job.plant.name, loops=table.loops, lost_numerical=lost, models=models)
    if plate := figures.certified(job.plant, result, errors):
        figures.write(plate, job.folder)
    return result


def summary(result: Certified, width: int | None = None) -> str:
    """A sentence about what holds, and a row per network."""
    first = next(iter(result.models.values()))
    head = ["network", "ε κ", "lost", "guarded", "fallback"]
    rows = [
        [c.label, f"{row.eps_kappa:.1e}", str(row.lost), str(row.lost_guarded), f"{row.fallback:.2%}"]
        for c, row in result.models.items()
    ]
    if first.adversarial is not None:
        head[2:2] = ["adversary", "above", "unnoticed", "blind"]
        for cells, c in zip(rows, result.models.values(), strict=True):
            cells[2:2] = [f"{c.adversarial:.1e}", f"{c.above} of {c.calls}", str(c.unnoticed),
                          f"{c.blind} of {c.blind_calls}"]  # fmt: skip
    about = (
        f"{result.plant}: {first.rollouts} fresh rollouts, {first.samples or 'some'} random samples of each: with a "
        f"confidence of {first.confidence:.4%} at most {first.probability:.2%} of rollouts so sampled have an error of "
        f"U, in its largest component, above ε κ\n"
        f"{result.loops} loops, {result.lost_numerical} lost with the numerical predictor; tolerance "
        f"{first.tolerance:g}"
    )
    return f"{about}\n\n{columns(head, rows, width, numbers=head[1:])}"


def _rollouts(table: Certify, fresh: Rollouts) -> dict[str, Any]:
    return {
        "probability": table.probability, "confidence": table.confidence, "rollouts": len(fresh.errors),
        "samples": table.samples, "eps_kappa": fresh.errors.max(), "median": np.median(fresh.errors),
        "fallback_rollouts": fresh.fallback,
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
