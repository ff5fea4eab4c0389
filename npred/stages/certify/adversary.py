"""A search for the inputs at which a network errs most: a lower bound of the uniform epsilon of [DAPF, Theorem 2].

Every X of the box of initial states, every u within the range of the data's inputs and every D_hat within that of the
data's estimates counts as an input; of a plant that declares its delay, every X with its D(X, t). Half of the searches
start at rows of the data, half at random ones. Where the plant is traced with one constant delay they climb the
gradient of |kappa(P̂(1)) - kappa(P(1))| through the network and RK4 (Adam, on coordinates that a logistic function
keeps in the set); elsewhere they try random steps and keep the best.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from npred import grid, randomness
from npred.config import Certify
from npred.data.dataset import Dataset
from npred.loop import metrics
from npred.plants import Plant
from npred.predictors import RK4, Predictor
from npred.stages.certify.rollouts import Calls

RATE = 0.1  # of Adam, and the spread of random steps, in logistic coordinates
EDGE = 1e-3  # how near to the edges of the set a start may be, as a share of its width


@dataclass(frozen=True)
class Inputs:
    """The set: lowest and highest X (2, n), u (2, m) and D_hat (2,)."""

    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray

    @classmethod
    def of(cls, data: Dataset, box: np.ndarray) -> "Inputs":
        """That of the data, X in the box (n, 2)."""
        u = data.u.reshape(-1, data.u.shape[-1])
        ends = (np.stack([a.min(axis=0), a.max(axis=0)]) for a in (u, data.D_hat))
        return cls(box.T, *ends)

    def inside(self, a: Tensor, name: str) -> Tensor:
        """Logistic coordinates to those inputs."""
        low, high = torch.as_tensor(getattr(self, name)).to(a)
        return low + (high - low) * torch.sigmoid(a)

    def coordinates(self, values: np.ndarray, name: str) -> Tensor:
        """Back, from the nearest inputs of the set."""
        low, high = getattr(self, name)
        share = (values - low) / np.where(high > low, high - low, 1.0)
        return torch.logit(torch.as_tensor(np.clip(share, EDGE, 1 - EDGE)))


def search(
    plant: Plant, predictor: Predictor, data: Dataset, inputs: Inputs, table: Certify, seed: int,
    progress: Callable[[int], Any],
) -> tuple[Calls, np.ndarray]:  # fmt: skip
    """The inputs of every call of every search, and |kappa(P̂(1)) - kappa(P(1))| there, (B,)."""
    rng = randomness.generator(seed, "certify", "adversary")
    a = _starts(rng, data, inputs, table.restarts, predictor.nx)
    climbs = plant.traced and plant.one_delay and not plant.declares_delay and hasattr(predictor, "operator")
    if climbs:
        calls = _climb(plant, predictor, inputs, a, table.steps, progress)
    else:
        span = (plant.period or float(np.nanmax(data.t))) if plant.clocked else 0.0
        calls = _wander(plant, predictor, inputs, a, table.steps, span, rng, progress)
    X, u, D_hat, t, error = (np.concatenate(column) for column in zip(*calls, strict=True))
    return (X, u, D_hat, t), error


def _starts(rng: np.random.Generator, data: Dataset, inputs: Inputs, count: int, nx: int) -> list[Tensor]:
    """Logistic coordinates of X, u and D_hat: of rows of the data, and of smooth random histories."""
    rows = rng.integers(0, len(data), count - count // 2)
    x = grid.nodes(nx)
    phases, turns = rng.uniform(0, 2 * np.pi, (2, count // 2, 1, inputs.u.shape[1]))
    waves = 0.5 + 0.5 * np.cos(phases + turns * x[:, None])
    (low, high), box, D = inputs.u, inputs.X, inputs.D_hat
    u = np.concatenate([grid.refine(data.u[rows], nx), low + (high - low) * waves])
    X = np.concatenate([data.X[rows], rng.uniform(box[0], box[1], (count // 2, box.shape[1]))])
    D_hat = np.concatenate([data.D_hat[rows], rng.uniform(D[0], D[1], count // 2)])
    return [inputs.coordinates(values, name) for values, name in ((X, "X"), (u, "u"), (D_hat, "D_hat"))]


def _climb(
    plant: Plant, predictor: Any, inputs: Inputs, a: list[Tensor], steps: int, progress: Callable[[int], Any]
) -> list[tuple[np.ndarray, ...]]:  # fmt: skip
    """The calls of gradient ascent."""
    a, calls = [b.requires_grad_() for b in a], []
    ascent = torch.optim.Adam(a, lr=RATE, maximize=True)
    operator = predictor.operator.double()
    for _ in range(steps):
        X, u, D_hat = (inputs.inside(b, name) for b, name in zip(a, ("X", "u", "D_hat"), strict=True))
        U = plant.kappa(operator(X, u, D_hat)[:, -1])
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


def _rk4(plant: Plant, X: Tensor, u: Tensor, D_hat: Tensor) -> Tensor:
    """P(1) (B, n) by RK4 on the nodes of u (B, nx, m), as the predictor's, but that u is linear between nodes."""
    h = (D_hat / (u.shape[1] - 1))[:, None]
    for j in range(u.shape[1] - 1):
        X = RK4.step(plant.f, X, u[:, j], (u[:, j] + u[:, j + 1]) / 2, u[:, j + 1], 0.0, h)
    return X


def _wander(
    plant: Plant, predictor: Predictor, inputs: Inputs, a: list[Tensor], steps: int, span: float,
    rng: np.random.Generator, progress: Callable[[int], Any],
) -> list[tuple[np.ndarray, ...]]:  # fmt: skip
    """The calls of random steps, of which each search keeps those that do not make the error smaller.

    Times are drawn from [0, span] seconds; a delay that the plant declares is that of X and the time.
    """
    exact, best, calls = RK4(plant, predictor.nx), np.full(len(a[0]), -np.inf), []
    for k in range(steps):
        scale = RATE * 4.0 ** rng.standard_normal((len(best), 1)) * (k > 0)
        moved = [b + torch.as_tensor(scale * rng.standard_normal((len(b), b[0].numel()))).reshape_as(b) for b in a]
        X, u, D_hat = (inputs.inside(b, name).numpy() for b, name in zip(moved, ("X", "u", "D_hat"), strict=True))
        t = rng.uniform(0, span) if span else 0.0
        D_hat = plant.delay(X, t) if plant.declares_delay else D_hat
        U, U_exact = (metrics.law(plant, p(X, u, D_hat, t), t, D_hat) for p in (predictor, exact))
        error = np.abs(U - U_exact).max(axis=-1)
        calls.append((X, u, D_hat, np.full(len(X), t), error))
        better = np.nan_to_num(error) >= best
        best = np.where(better, np.nan_to_num(error), best)
        for b, new in zip(a, moved, strict=True):
            b[better] = new[better]
        progress(len(error))
    return calls
