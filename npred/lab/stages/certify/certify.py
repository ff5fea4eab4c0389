"""The certify stage: the error of a network in fresh rollouts, in loops, and in the searches of packages."""

from typing import Any

import h5py
import numpy as np

from npred.base import devices, randomness, registry
from npred.guard.guarded import Guarded
from npred.lab.config import GuardTable
from npred.lab.config.conditions import EVERY, Condition
from npred.lab.config.results import Certified, PredictorId
from npred.lab.config.results.evaluate import Certificate
from npred.lab.report import figures
from npred.lab.scheduler.job import Job
from npred.lab.stages.certify import rollouts
from npred.lab.stages.certify.rollouts import Rollouts
from npred.lab.stages.certify.table import Certify
from npred.lab.stages.evaluate.evaluate import load_network
from npred.lab.stages.generate import sampling
from npred.lab.stages.report import tables
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
        network: Guarded(load_network(job, network), exact=exact, **dict(guard_table))
        for network in map(PredictorId, job.config.train.models)
    }
    by_rollout = rollouts.judge(job, guards, exact)
    loops = _loops(job, exact)
    with job.threads() as pool:
        bare = {network: pool.submit(_loops, job, guard.model) for network, guard in guards.items()}
        guarded = {network: pool.submit(_loops, job, guard) for network, guard in guards.items()}
        rows: dict[PredictorId, dict[str, Any]] = {
            network: {"tolerance": guard.tolerance}
            | _rollouts(table, by_rollout[network])
            | _behaviour(job.plant, loops, bare[network].result(), guarded[network].result())
            for network, guard in guards.items()
        }
    for module in more:
        for network, fields in module.certify(job, guards, exact, by_rollout).items():
            rows[network] |= fields
    errors = {network: fresh.errors for network, fresh in by_rollout.items()}
    with h5py.File(job.folder / "errors.h5", "w") as file:
        for network, values in errors.items():
            file[network.name] = values
    models = {network: Certificate(**row) for network, row in rows.items()}
    far = int(metrics.far(loops, metrics.target(job.plant, loops)).sum())
    result = Certified(plant=job.plant.name, loops=table.loops, far_numerical=far, models=models)
    if plate := figures.certified(job.plant, result, errors):
        figures.write(plate, job.folder)
    return result


def summary(result: Certified, width: int | None = None) -> str:
    """A sentence about the statement, and a row per network."""
    first = next(iter(result.models.values()))
    about = (
        f"{result.plant}: {first.rollouts} fresh rollouts, {first.samples or 'some'} random samples of each: with a "
        f"confidence of {first.confidence:.4%} at most {first.probability:.2%} of rollouts so sampled have an error of "
        f"U, in its largest component, above ε_κ\n"
        f"{result.loops} loops, of which {result.far_numerical} end far from rest with the numerical predictor; the "
        f"guard's tolerance is {first.tolerance:g}"
    )
    return f"{about}\n\n{tables.certified(result).terminal(width)}"


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
    """A network's loops, bare and guarded, beside those of the numerical predictor."""
    target = metrics.target(plant, loops)
    numerical, alone, checked = (metrics.far(each, target) for each in (loops, bare, guarded))
    gaps = (np.linalg.norm(each.X - target, axis=-1) for each in (loops, bare, guarded))
    peak, peak_bare, peak_guarded = (float(gap.max()) if np.isfinite(gap).all() else np.inf for gap in gaps)
    return {
        "far": int((alone & ~numerical).sum()), "far_guarded": int((checked & ~numerical).sum()),
        "peak": peak_bare / peak, "peak_guarded": peak_guarded / peak, "fallback": guarded.fallback_share,
    }  # fmt: skip
