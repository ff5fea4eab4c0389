"""A search for the blind spots of a guard: inputs that it lets pass, with as large an error of U as there is.

CMA-ES, from rows of the data, of ln(error) - PENALTY (ln(estimate / threshold)⁺ + ln(beyond)⁺), with the guard's
estimate, its threshold, and how far the input is from the data as a share of how far the network is trusted. Half of
the calls evolve smooth inputs, half rough ones. It needs no derivative, so that it serves every plant and every guard.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred import randomness
from npred.data.dataset import Dataset
from npred.predictors import Predictor
from npred.predictors.guarded import Guarded
from npred.stages.certify import evolution, rollouts
from npred.stages.certify.input_set import Inputs
from npred.stages.certify.rollouts import Calls
from npred.stages.certify.table import Certify

PENALTY = 3.0  # more than the 1 that an error beyond the threshold brings, for it brings an estimate as large


def search(
    guard: Guarded, exact: Predictor, data: Dataset, inputs: Inputs, table: Certify, seed: int,
    progress: Callable[[int], Any],
) -> tuple[Calls, np.ndarray]:  # fmt: skip
    """The inputs of every call, and the score of each, (B,)."""
    rng = randomness.generator(seed, "certify", "blind spots")

    def score(X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray) -> np.ndarray:
        true, estimate, _ = rollouts.judged(guard, exact, X, u, D_hat, t)
        ratios = estimate / guard.threshold, guard.beyond(X, u, D_hat, t)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(true) - PENALTY * sum(np.log(np.maximum(ratio, 1.0)) for ratio in ratios)

    halves = []
    for count, smooth in ((table.restarts // 2, True), (table.restarts - table.restarts // 2, False)):
        a = inputs.starts(rng, data, max(count, 1), 0, guard.nx)
        halves.append(evolution.search(guard.plant, inputs, a, table.steps, score, rng, progress, smooth))
    (one, scores), (other, more) = halves
    X, u, D_hat, t = (np.concatenate(pair) for pair in zip(one, other, strict=True))
    return (X, u, D_hat, t), np.concatenate([scores, more])
