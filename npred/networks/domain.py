"""Where the training data were: a score of (X, u, D_hat) that is cheap enough for every call of a network."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file, save_file

from npred.base import grid
from npred.networks import matrices

FILE = "domain.safetensors"
MOMENTS = 3  # moments of each input
KEPT = 256  # rows that are kept as examples
FLOOR = 1e-3  # least spread of a feature, as a share of its mean, so that a constant one has an inside
MARGIN = 0.25  # share of a feature's range in the data by which it may be outside of it, as by a sensor's noise
ROUNDING = 1e-9  # share of the limit that is added, so that the farthest row is inside
Phase = Callable[[np.ndarray], np.ndarray | None]


@dataclass(frozen=True)
class Domain:
    """Mahalanobis' distance d of the features of (X, u, D_hat) from the data's mean; inside is d <= limit, with each
    feature within `half` of `middle`.

    The features, k in all, are asinh(X / bend), D_hat, the first three Legendre moments of each input over x, and the
    phase in the plant's period as cosine and sine where P depends on the time. d = |whiten (features - mean)|,
    whiten' whiten the inverse of their covariance; limit is the largest d of a row that the network was trained on.
    A joint range: a state and an input that both occur, but never together, are outside. Where a few rows are far from
    the others, limit is large: so `middle` and `half`, the range of each feature with a MARGIN, bound it too. Shapes:
    bend (n,), mean, middle and half (k,), whiten (k, k), limit (); X, u, D_hat, t are some rows of the data: examples.
    """

    bend: np.ndarray
    mean: np.ndarray
    whiten: np.ndarray
    limit: np.ndarray
    middle: np.ndarray
    half: np.ndarray
    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray
    t: np.ndarray

    @classmethod
    def of_parts(cls, parts: Callable[[], Iterable[Any]], bend: np.ndarray, phase: Phase) -> "Domain":
        """The domain of rows that come in parts, each with X, u, D_hat and P: `parts` is called three times."""
        count, total, square, low, high = 0, np.zeros(()), np.zeros(()), np.full((), np.inf), np.full((), -np.inf)
        kept: list[list[np.ndarray]] = []

        def features(part: Any) -> np.ndarray:
            return _features(part.X, part.u, part.D_hat, phase(part.t), bend)

        for part in parts():
            rows = features(part)
            count, total = count + len(rows), total + rows.sum(axis=0)
            low = np.minimum(low, rows.min(axis=0, initial=np.inf))
            high = np.maximum(high, rows.max(axis=0, initial=-np.inf))
            thinned = slice(None, None, max(1, len(part.X) // KEPT))
            kept.append([getattr(part, name)[thinned] for name in ("X", "u", "D_hat", "t")])
        mean = total / count
        for part in parts():
            gap = features(part) - mean
            square = square + gap.T @ gap
        covariance = square / count + np.diag((FLOOR * (np.abs(mean) + FLOOR)) ** 2)
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        gaps = (features(part) - mean for part in parts())
        limit = max(np.linalg.norm(gap @ whiten.T, axis=1).max(initial=0.0) for gap in gaps)
        half = (0.5 + MARGIN) * (high - low) + FLOOR * (np.abs(mean) + FLOOR)
        examples = [np.concatenate(arrays) for arrays in zip(*kept, strict=True)]
        spread = np.linspace(0, len(examples[0]) - 1, min(KEPT, len(examples[0]))).astype(int)
        limit = np.array(limit * (1 + ROUNDING))
        return cls(bend, mean, whiten, limit, (low + high) / 2, half, *(a[spread] for a in examples))

    def distance(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, angle: np.ndarray | None) -> np.ndarray:
        """How far X (B, n), u (B, nx, m), D_hat (B,) and the phase in the plant's period (B,), where it has one, are
        from the data, (B,): the largest of d / limit and |feature - middle| / half. Inside it is 1 at most.
        """
        rows = _features(X, u, D_hat, angle, self.bend)
        d = np.linalg.norm((rows - self.mean) @ self.whiten.T, axis=1)
        return np.maximum(d / self.limit, (np.abs(rows - self.middle) / self.half).max(axis=1))

    def save(self, folder: Path) -> None:
        arrays = {f.name: np.array(getattr(self, f.name), dtype=float, order="C") for f in fields(self)}
        save_file(arrays, folder / FILE)

    @classmethod
    def load(cls, folder: Path) -> "Domain | None":
        """The saved domain; None beside a network that has none."""
        if not (folder / FILE).exists():
            return None
        tensors = load_file(folder / FILE)
        if "half" not in tensors:  # written before there were ranges
            tensors |= {"middle": tensors["mean"], "half": np.full_like(tensors["mean"], np.inf)}
        return cls(**{f.name: tensors[f.name] for f in fields(cls)})


def legendre(nx: int) -> np.ndarray:
    """Weights (MOMENTS, nx) of the integrals of u P_k(2x - 1) over [0, 1] on nx nodes."""
    return matrices.legendre(nx, MOMENTS).T * grid.trapezoid(nx)


def _features(
    X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, angle: np.ndarray | None, bend: np.ndarray
) -> np.ndarray:
    """(N, k)."""
    moments = np.einsum("kj,bjm->bmk", legendre(u.shape[1]), u)
    columns = [np.arcsinh(X / bend), D_hat[:, None], *np.moveaxis(moments, 1, 0)]
    if angle is not None:
        columns.append(np.stack([np.cos(2 * np.pi * angle), np.sin(2 * np.pi * angle)], axis=1))
    return np.concatenate(columns, axis=1)
