"""The inputs of a predictor that an adversary may choose from, and where it starts."""

from dataclasses import dataclass, replace

import numpy as np

from npred import grid
from npred.data.dataset import Dataset
from npred.plants import Plant

EDGE = 1e-3  # how near to the edges of the set a start may be, as a share of its width


@dataclass(frozen=True)
class Inputs:
    """The set: lowest and highest X (2, n), u (2, m) and D_hat (2,); times are those of [0, span] seconds."""

    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray
    span: float = 0.0

    @classmethod
    def of(cls, data: Dataset, box: np.ndarray, plant: Plant | None = None) -> "Inputs":
        """That of the data, X in the box (n, 2), and the times of the period, or of the data, where the plant reads
        a clock.
        """
        span = 0.0
        if plant is not None and plant.clocked:
            span = plant.period or float(np.nanmax(data.t))
        u, D_hat = (
            np.stack([a.min(axis=0), a.max(axis=0)]) for a in (data.u.reshape(-1, data.u.shape[-1]), data.D_hat)
        )
        return cls(box.T, u, D_hat, span)

    def widened(self, X: np.ndarray) -> "Inputs":
        """The same inputs with X in the range of states (B, n) in place of the box."""
        return replace(self, X=np.stack([X.min(axis=0), X.max(axis=0)]))

    def inside(self, a: np.ndarray, name: str) -> np.ndarray:
        """Logistic coordinates to those inputs."""
        low, high = getattr(self, name)
        return low + (high - low) * logistic(a)

    def coordinates(self, values: np.ndarray, name: str) -> np.ndarray:
        """Back, from the nearest inputs of the set."""
        low, high = getattr(self, name)
        share = np.clip((values - low) / np.where(high > low, high - low, 1.0), EDGE, 1 - EDGE)
        return np.log(share / (1 - share))

    def starts(self, rng: np.random.Generator, data: Dataset, count: int, random: int, nx: int) -> list[np.ndarray]:
        """Logistic coordinates of X, u and D_hat: of `count` rows of the data, then of `random` smooth histories."""
        rows = rng.integers(0, len(data), count)
        phases, turns = rng.uniform(0, 2 * np.pi, (2, random, 1, self.u.shape[1]))
        waves = 0.5 + 0.5 * np.cos(phases + turns * grid.nodes(nx)[:, None])
        (low, high), box, D = self.u, self.X, self.D_hat
        u = np.concatenate([grid.refine(data.u[rows], nx), low + (high - low) * waves])
        X = np.concatenate([data.X[rows], rng.uniform(box[0], box[1], (random, box.shape[1]))])
        D_hat = np.concatenate([data.D_hat[rows], rng.uniform(D[0], D[1], random)])
        return [self.coordinates(values, name) for values, name in ((X, "X"), (u, "u"), (D_hat, "D_hat"))]


def logistic(a: np.ndarray) -> np.ndarray:
    """1 / (1 + exp(-a))."""
    with np.errstate(over="ignore"):  # far below zero it is zero
        return 1 / (1 + np.exp(-a))
