"""A bound of a network's error that holds with a stated confidence, from fresh, independent rollouts.

The largest error of N independent rollouts is exceeded by a fresh one with a probability of at most beta, with
confidence 1 - alpha, where N >= ln(1/alpha) / ln(1/(1 - beta)). Rows of one rollout are dependent, so that a rollout
counts as one: its error is the largest over its samples. These are certify.samples random times of it, 50 by default,
and not all of its steps, among which a larger error may be. It holds for the distribution that rollouts, and their
samples, are drawn from. The error of U is that of its largest component, for so the guard's tolerance has it.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from npred.base import grid, randomness
from npred.guard.guarded import Guarded
from npred.lab.config import Pipeline
from npred.lab.config.results import PredictorId
from npred.lab.scheduler.job import Job
from npred.lab.stages.certify.table import Certify
from npred.lab.stages.evaluate.accuracy import ROWS
from npred.lab.stages.generate import generate
from npred.loop import metrics
from npred.prediction.delays import problem_of
from npred.prediction.methods import OneStep, Predictor

FINER = 4  # intervals in one, on which u is read by straight lines


def count(probability: float, confidence: float) -> int:
    """N, the fewest rollouts whose largest error a share `probability` of all exceeds at most, with `confidence`."""
    return math.ceil(math.log(1 - confidence) / math.log1p(-probability))


Calls = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # X (B, n), u (B, nx, m), D_hat (B,), t (B,)


class Rollouts(NamedTuple):
    """N fresh rollouts as one network sees them."""

    errors: np.ndarray  # (N,), the largest |kappa(P̂(1)) - kappa(P(1))| of each's samples, over components too
    worst: Calls  # the calls of these errors
    fallback: float  # share of the samples that a guard answers


def judge(job: Job, guarded: Mapping[PredictorId, Guarded], exact: Predictor) -> dict[PredictorId, Rollouts]:
    """Fresh rollouts, N of them, by network."""
    table = job.config.optional("certify")
    number = count(table.probability, table.confidence)
    parts: dict[PredictorId, list[tuple[int, Rollouts]]] = {network: [] for network in guarded}
    for start, rows in generate.batches(job, fresh(job.config, table, number), "certify"):
        X, u, D_hat, t = (rows[name] for name in ("X", "u", "D_hat", "t"))
        calls = X, grid.means(u, exact.nx), D_hat, t
        for network, guard in guarded.items():
            true, _, passed = judged(guard, exact, *calls)
            worst = _largest(true, rows["rollout"])
            part = Rollouts(true[worst], tuple(a[worst] for a in calls), 1 - passed.mean())  # type: ignore[arg-type]
            parts[network].append((start, part))
    return {network: _joined([part for _, part in sorted(batch)]) for network, batch in parts.items()}


def _largest(errors: np.ndarray, rollout: np.ndarray) -> np.ndarray:
    """The row of the largest error of each rollout."""
    order = np.lexsort((errors, rollout))
    last = np.append(np.diff(rollout[order]) > 0, True)
    return order[last]


def _joined(parts: list[Rollouts]) -> Rollouts:
    errors = np.concatenate([part.errors for part in parts])
    worst = tuple(np.concatenate(column) for column in zip(*(part.worst for part in parts), strict=True))
    fallback = np.average([part.fallback for part in parts], weights=[len(part.errors) for part in parts])
    return Rollouts(errors, worst, float(fallback))  # type: ignore[arg-type]


def judged(
    guard: Guarded, exact: Predictor, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any = 0.0,
    *, nearest: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """For each call the true error of U, the guard's estimate, and whether it lets the network answer, (B,) each.

    With `nearest` it is by the nearer of two readings of u, that of `exact` and straight lines through the nodes: what
    the nodes do not say is no error of the network. An error that is not a number is infinite.
    """
    t, parts = np.broadcast_to(t, len(X)), []
    by_lines = nearest and isinstance(exact, OneStep) and problem_of(exact.plant).reads_cells
    for i in range(0, len(X), ROWS):
        rows = X[i : i + ROWS], u[i : i + ROWS], D_hat[i : i + ROWS], t[i : i + ROWS]
        P_hat, exacts = guard.model(*rows), [exact(*rows)]
        if by_lines:
            fine = grid.straight(rows[1], FINER * (u.shape[1] - 1) + 1)
            exacts.append(type(exact)(exact.plant, fine.shape[1])(rows[0], fine, *rows[2:])[:, ::FINER])
        U, *readings = (metrics.law(guard.plant, P, rows[3], rows[2]) for P in (P_hat, *exacts))
        true = np.fmin.reduce([np.abs(U - reading).max(axis=-1) for reading in readings])
        estimate, fallback = guard.judge(P_hat, *rows)
        parts.append((np.where(np.isnan(true), np.inf, true), estimate, ~fallback))
    errors, estimates, passed = (np.concatenate(column) for column in zip(*parts, strict=True))
    return errors, estimates, passed


def fresh(pipeline: Pipeline, table: Certify, number: int) -> Pipeline:
    """The pipeline whose data are `number` nominal rollouts that nobody has seen."""
    update = {"rollouts": number, "samples": number * table.samples, "explore": 0.0, "redraw": 0.0, "data": ""}
    seed = randomness.integer(pipeline.seed, "certify")
    return pipeline.model_copy(update={"generate": pipeline.generate.model_copy(update=update), "seed": seed})
