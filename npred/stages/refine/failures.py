"""The inputs at which a network failed, as rows to train on: P is the numerical predictor's."""

from dataclasses import dataclass

import numpy as np

from npred import array_checks, grid, randomness
from npred.config import Certify
from npred.data.dataset import Dataset
from npred.predictors import numerical
from npred.predictors.guarded import Guarded
from npred.stages import Job
from npred.stages.certify import adversary
from npred.stages.certify.input_set import Inputs
from npred.stages.certify.rollouts import Calls
from npred.stages.evaluate.initial_conditions import box
from npred.stages.evaluate.scenarios import EVERY
from npred.stages.refine import hostile

STEPS = 40  # calls of a search: each starts near the data, and is soon far off


@dataclass(frozen=True)
class Failures:
    """Rows X (N, n), u (N, nx, m), D_hat, t (N,), P (N, nx, n), on the nodes of the data."""

    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray
    t: np.ndarray
    P: np.ndarray

    @classmethod
    def of(cls, job: Job, calls: Calls, nx: int) -> "Failures":
        """Those of the calls whose P is finite."""
        X, u, D_hat, t = calls
        u = grid.refine(u, nx)
        finite_inputs = array_checks.finite_rows(X, u, D_hat)
        X, u, D_hat, t = (a[finite_inputs] for a in (X, u, D_hat, t))
        P = numerical(job.config.generate.predictor, job.plant, nx)(X, u, D_hat, t)
        finite = np.isfinite(P).all(axis=(1, 2))
        return cls(*(a[finite] for a in (X, u, D_hat, t, P)))

    def __len__(self) -> int:
        return len(self.X)


def adversarial(job: Job, guard: Guarded, data: Dataset) -> Failures:
    """The calls of an adversary's searches, with other seeds than those of a certificate."""
    count, seed = job.config.refine_table.adversary, randomness.integer(job.config.seed, "refine", "adversary")
    table = Certify(restarts=-(-max(count, 1) // STEPS), steps=STEPS)
    inputs = Inputs.of(data, box(job.plant, job.config), job.plant)
    with job.progress.bar(f"adversary {guard.model.name}", table.restarts * STEPS, "calls") as bar:
        calls, _ = adversary.search(job.plant, guard.model, data, inputs, table, seed, bar.advance)
    return Failures.of(job, _some(calls, count, seed), data.u.shape[1])


def refused(job: Job, guard: Guarded, data: Dataset) -> Failures:
    """Inputs of hostile loops with the guarded network at which the numerical predictor answered."""
    config, count = job.config.evaluate, job.config.refine_table.fallbacks
    every = np.arange(0, hostile.steps(config), EVERY)
    samples, parts = np.tile(every, (job.config.refine_table.loops, 1)), []
    for _, loops in hostile.loops(job, guard, data, "train", samples):
        at_samples = (loops.samples.X, loops.samples.u, loops.samples.D_hat, samples * config.dt)
        X, u, D_hat, t = (a.reshape(-1, *a.shape[2:]) for a in at_samples)
        finite_inputs = array_checks.finite_rows(X, u, D_hat)
        rows = X[finite_inputs], u[finite_inputs], D_hat[finite_inputs], t[finite_inputs]
        answered = guard.fallback(*rows)
        parts.append(tuple(a[answered] for a in rows))
    X, u, D_hat, t = (np.concatenate(column) for column in zip(*parts, strict=True))
    seed = randomness.integer(job.config.seed, "refine", "fallbacks")
    return Failures.of(job, _some((X, u, D_hat, t), count, seed), data.u.shape[1])


def _some(calls: Calls, count: int, seed: int) -> Calls:
    """At most so many of the calls, at random."""
    order = np.sort(np.random.default_rng(seed).permutation(len(calls[0]))[:count])
    X, u, D_hat, t = (a[order] for a in calls)
    return X, u, D_hat, t
