"""A regression in P's place, of which a network learns the rest: products of two inputs, by least squares."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Self

import numpy as np

from npred_experiments.network_loop import RecordedCalls

RIDGE = 1e-9  # for the normalised equations: dependent columns take no large weights


@dataclass(frozen=True)
class Quadratic:
    """P - X as a polynomial of degree two in X and u at all nodes but the last, one for each node of P.

    That is a Volterra series of order two of the plant's flow, for a delay that is the same in all rows. Where a loop
    turns small errors of P into large accelerations it takes most of the work off a network.
    """

    mean: np.ndarray
    spread: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, samples: RecordedCalls) -> Self:
        """The least squares fit to these calls."""
        inputs = _inputs(samples.X, samples.u)
        mean, spread = inputs.mean(axis=0), inputs.std(axis=0)
        spread[spread == 0.0] = 1.0
        A = _products((inputs - mean) / spread)
        moved = (samples.P - samples.X[:, None]).astype(float).reshape(len(A), -1)
        size = np.sqrt((A**2).sum(axis=0))
        gram = A.T @ A / (size[:, None] * size) + RIDGE * np.eye(len(size))
        weights = np.linalg.solve(gram, A.T @ moved / size[:, None]) / size[:, None]
        return cls(mean, spread, weights)

    def __call__(self, X: np.ndarray, u: np.ndarray) -> np.ndarray:
        """P - X (B, nx, n) of X (B, n) and u (B, nx, m)."""
        A = _products((_inputs(X, u) - self.mean) / self.spread)
        return (A @ self.weights).reshape(len(X), -1, X.shape[1])

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        """P (B, nx, n), with the call of a predictor."""
        return X[:, None] + self(X, u)

    def rest(self, samples: RecordedCalls) -> RecordedCalls:
        """The same calls with P less this fit."""
        return samples._replace(P=(samples.P - self(samples.X, samples.u)).astype(np.float32))

    def save(self, folder: Path) -> None:
        """Write the coefficients beside the network's weights."""
        np.savez(folder / "quadratic.npz", mean=self.mean, spread=self.spread, weights=self.weights)


def _inputs(X: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.concatenate([X, u[:, :-1].reshape(len(u), -1)], axis=1).astype(float)


def _products(z: np.ndarray) -> np.ndarray:
    """1, z and the products of two of them, (B, .)."""
    first, second = _pairs(z.shape[1])
    return np.concatenate([np.ones((len(z), 1)), z, z[:, first] * z[:, second]], axis=1)


@cache
def _pairs(count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.triu_indices(count)
