"""A bound of a network's error that holds with a stated confidence, from fresh, independent rollouts.

The largest error of N independent rollouts is exceeded by a fresh one with a probability of at most beta, with
confidence 1 - alpha, where N >= ln(1/alpha) / ln(1/(1 - beta)). Rows of one rollout are dependent, so that a rollout
counts as one: its error is the largest over its samples. It holds for the distribution that rollouts are drawn from.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from npred import grid, randomness
from npred.config import Certify, Pipeline
from npred.loop import metrics
from npred.predictors import Predictor
from npred.predictors.guarded import Guarded
from npred.results import Contender
from npred.stages import Job
from npred.stages.evaluate.accuracy import ROWS
from npred.stages.generate import generate


def count(probability: float, confidence: float) -> int:
    """N, the fewest rollouts whose largest error a share `probability` of all exceeds at most, with `confidence`."""
    return math.ceil(math.log(1 - confidence) / math.log1p(-probability))


def errors(
    job: Job, guarded: Mapping[Contender, Guarded], exact: Predictor
) -> tuple[dict[Contender, np.ndarray], dict[Contender, float]]:
    """The largest |kappa(P̂(1)) - kappa(P(1))| of each rollout (N,), and the share of samples that a guard answers."""
    table = job.config.certify_table
    number = count(table.probability, table.confidence)
    largest = {contender: np.zeros(number) for contender in guarded}
    answered = dict.fromkeys(guarded, 0)
    for _, rows in generate.batches(job, fresh(job.config, table, number), "certify"):
        X, u, D_hat, t = (rows[name] for name in ("X", "u", "D_hat", "t"))
        u = grid.refine(u, exact.nx)
        for contender, guard in guarded.items():
            true, _, passed = judged(guard, exact, X, u, D_hat, t)
            np.maximum.at(largest[contender], rows["rollout"], true)
            answered[contender] += int((~passed).sum())
    return largest, {contender: count / (number * table.samples) for contender, count in answered.items()}


def judged(
    guard: Guarded, exact: Predictor, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Of each call the true error of U, the guard's estimate, and whether it lets the network answer, (B,) each.

    An error that is not a number is infinite.
    """
    t, parts = np.broadcast_to(t, len(X)), []
    for i in range(0, len(X), ROWS):
        rows = X[i : i + ROWS], u[i : i + ROWS], D_hat[i : i + ROWS], t[i : i + ROWS]
        P_hat = guard.model(*rows)
        U, U_exact = (metrics.law(guard.plant, P, rows[3], rows[2]) for P in (P_hat, exact(*rows)))
        true = np.abs(U - U_exact).max(axis=-1)
        estimate, fallback = guard.judge(P_hat, *rows)
        parts.append((np.where(np.isnan(true), np.inf, true), estimate, ~fallback))
    errors, estimates, passed = (np.concatenate(column) for column in zip(*parts, strict=True))
    return errors, estimates, passed


def fresh(pipeline: Pipeline, table: Certify, number: int) -> Pipeline:
    """The pipeline whose data are `number` nominal rollouts that nobody has seen."""
    update = {"rollouts": number, "samples": number * table.samples, "explore": 0.0, "redraw": 0.0, "data": ""}
    seed = randomness.integer(pipeline.seed, "certify")
    return pipeline.model_copy(update={"generate": pipeline.generate.model_copy(update=update), "seed": seed})
