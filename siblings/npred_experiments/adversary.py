"""Searches for the inputs at which a network errs most, and for the blind spots of its guard.

The first is a lower bound of sup |kappa(P̂(1)) - kappa(P(1))| over these inputs: what an epsilon of [DAPF, Theorem 2],
an error of P, becomes in U.

Every X of the box of initial states, every u within the range of the data's inputs and every D_hat within that of the
data's estimates counts as an input; of a plant that declares its delay, every X with its D(X, t). Half of the searches
start at rows of the data, half at random ones. Where the plant is traced with one constant delay and without a clock
they climb the gradient of |kappa(P̂(1)) - kappa(P(1))| through the network and RK4 (Adam, on coordinates that a logistic
function keeps in the set); elsewhere CMA-ES evolves them.

Blind spots are inputs that a guard lets pass, with as large an error of U as there is. There CMA-ES climbs, from rows
of the data, ln(error) - PENALTY (ln(estimate / threshold)⁺ + ln(beyond)⁺), with the guard's estimate, its threshold,
and how far the input is from the data as a share of how far the network is trusted. The calls evolve waves, stairs,
lines and single nodes of u, each with X in the box and with X in the range of the data. It needs no derivative, and so
it works for every plant and every guard.
"""

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from npred.base import randomness
from npred.formulas import array_math
from npred.guard.guarded import Guarded
from npred.lab.stages.certify import rollouts
from npred.lab.stages.certify.rollouts import Calls
from npred.lab.stages.certify.table import Certify
from npred.lab.training.data.dataset import Dataset
from npred.loop import metrics
from npred.plants import Plant
from npred.prediction.methods import RK4, Predictor
from npred_experiments import evolution
from npred_experiments.evolution import Inputs, Progress

if TYPE_CHECKING:
    from torch import Tensor

RATE = 0.1  # Adam's, in logistic coordinates
PENALTY = 3.0  # more than the 1 that an error beyond the threshold brings, for it brings an estimate as large


def search(
    plant: Plant, predictor: Predictor, data: Dataset, inputs: Inputs, table: Certify, seed: int, progress: Progress
) -> tuple[Calls, np.ndarray]:
    """The inputs of every call of every search, and |kappa(P̂(1)) - kappa(P(1))| there, (B,)."""
    rng, count = randomness.generator(seed, "certify", "adversary"), table.restarts // 2
    a = inputs.starts(rng, data, table.restarts - count, count, predictor.nx)
    if climbs(plant) and hasattr(predictor, "operator"):
        calls = _climb(plant, predictor, inputs, a, table.steps, progress)
        X, u, D_hat, t, errors = (np.concatenate(column) for column in zip(*calls, strict=True))
        return (X, u, D_hat, t), errors
    exact = RK4(plant, predictor.nx)

    def error(X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray) -> np.ndarray:
        U, U_exact = (metrics.law(plant, p(X, u, D_hat, t), t, D_hat) for p in (predictor, exact))
        return np.abs(U - U_exact).max(axis=-1)

    return evolution.search(plant, inputs, a, table.steps, error, rng, progress)


def climbs(plant: Plant) -> bool:
    """True if the search of a network climbs its gradient, which takes torch."""
    return plant.traced and plant.one_delay and not plant.declares_delay and not plant.clocked


def _climb(
    plant: Plant, predictor: Any, inputs: Inputs, starts: list[np.ndarray], steps: int, progress: Progress
) -> list[tuple[np.ndarray, ...]]:
    """The calls of gradient ascent."""
    import torch

    a, calls = [torch.as_tensor(start).requires_grad_() for start in starts], []
    ascent = torch.optim.Adam(a, lr=RATE, maximize=True)
    operator = predictor.operator.module(plant).double()
    device = operator.X_rest.device
    ranges = [torch.as_tensor(ends) for ends in (inputs.X, inputs.u, inputs.D_hat)]
    for _ in range(steps):
        X, u, D_hat = (low + (high - low) * torch.sigmoid(b) for b, (low, high) in zip(a, ranges, strict=True))
        U = plant.kappa(operator(X.to(device), u.to(device), D_hat.to(device))[:, -1].cpu())
        error = (U - plant.kappa(_rk4(plant, X, u, D_hat))).abs().amax(dim=-1)
        t = torch.zeros_like(D_hat)
        calls.append(tuple(value.numpy(force=True) for value in (X, u, D_hat, t, error)))
        ascent.zero_grad()
        torch.nan_to_num(error, 0.0).sum().backward()
        for b in a:
            b.grad = torch.nan_to_num(b.grad) if b.grad is not None else None
        ascent.step()
        progress(len(error))
    return calls


def _rk4(plant: Plant, X: "Tensor", u: "Tensor", D_hat: "Tensor") -> "Tensor":
    """P(1) (B, n) by RK4 on the nodes of u (B, nx, m), as the predictor's, but that u is linear between nodes."""
    h = (D_hat / (u.shape[1] - 1))[:, None]
    for j in range(u.shape[1] - 1):
        X = RK4.step(plant.f, X, u[:, j], (u[:, j] + u[:, j + 1]) / 2, u[:, j + 1], 0.0, h)
        if plant.state_bounds:
            X = array_math.stack(plant.stopped(X.unbind(-1), array_math.of(X)), like=X[..., 0])
    return X


def blind_spots(
    guard: Guarded, exact: Predictor, data: Dataset, inputs: Inputs, table: Certify, seed: int, progress: Progress
) -> tuple[Calls, np.ndarray]:
    """The inputs of every call, and the score of each, (B,)."""
    rng = randomness.generator(seed, "certify", "blind spots")

    def score(X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray) -> np.ndarray:
        true, estimate, _ = rollouts.judged(guard, exact, X, u, D_hat, t, nearest=True)
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
