"""A search for the blind spots of a guard: inputs that it lets pass, with as large an error of U as there is.

CMA-ES, from rows of the data, of ln(error) - PENALTY (ln(estimate / threshold)⁺ + ln(beyond)⁺), with the guard's
estimate, its threshold, and how far the input is from the data as a share of how far the network is trusted. The calls
evolve waves, stairs, lines and single nodes of u, each with X in the box and with X in the range of the data. It needs
no derivative, and so it works for every plant and every guard.
"""

from collections.abc import Callable
from itertools import product
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

    kinds, parts = list(product(evolution.SHAPES, (inputs, inputs.widened(data.X)))), []
    for k, (shape, among) in enumerate(kinds):
        count = (table.restarts + k) // len(kinds)
        if count > 0:
            a = among.starts(rng, data, count, 0, guard.nx)
            parts.append(evolution.search(guard.plant, among, a, table.steps, score, rng, progress, shape))
    calls, scores = zip(*parts, strict=True)
    X, u, D_hat, t = (np.concatenate(column) for column in zip(*calls, strict=True))
    return (X, u, D_hat, t), np.concatenate(scores)
