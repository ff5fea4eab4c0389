"""The inputs that an adversary may choose from, and CMA-ES among them.

That is: normal distributions of inputs that move to where a score is larger [Hansen 2016, arXiv:1604.00772].
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from npred.base import grid
from npred.lab.stages.certify.rollouts import Calls
from npred.lab.training.data.dataset import Dataset
from npred.plants import Plant

EDGE = 1e-3  # how near to the edges of the set a start may be, as a share of its width
SPREAD = 0.3  # standard deviation that a distribution starts with, in logistic coordinates
POPULATION = 20  # points that a distribution is adapted by, about
FEWEST = 4  # that it can be adapted by
FULL = 200  # coordinates up to which a whole covariance is adapted; its diagonal beyond, for it costs their cube
LOWEST = -1e9  # a score for what has none: CMA-ES compares scores, and nothing else
Score = Callable[..., np.ndarray]  # (X, u, D_hat, t) -> (B,)
Progress = Callable[[int], Any]


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
        u = np.concatenate([grid.means(data.u[rows], nx), low + (high - low) * waves])
        X = np.concatenate([data.X[rows], rng.uniform(box[0], box[1], (random, box.shape[1]))])
        D_hat = np.concatenate([data.D_hat[rows], rng.uniform(D[0], D[1], random)])
        return [self.coordinates(values, name) for values, name in ((X, "X"), (u, "u"), (D_hat, "D_hat"))]


def logistic(a: np.ndarray) -> np.ndarray:
    """1 / (1 + exp(-a))."""
    with np.errstate(over="ignore"):  # far below zero it is zero
        return 1 / (1 + np.exp(-a))


def search(
    plant: Plant, inputs: Inputs, a: list[np.ndarray], steps: int, score: Score, rng: np.random.Generator,
    progress: Progress, shape: str = "waves",
) -> tuple[Calls, np.ndarray]:  # fmt: skip
    """The calls (B `steps` rows) from starts X, u, D_hat in logistic coordinates (B, ...), and the score of each.

    A plant with a clock is asked at times of the set; a delay that it declares is that of X and the time. Evolved are
    weights of `shape` in u, one of SHAPES: all of them reach every u, and the first weights count most.
    """
    nx, a = a[1].shape[1], [*a]
    basis = SHAPES[shape](nx)
    a[1] = np.linalg.inv(basis).T @ a[1]
    shapes, ends = [b.shape[1:] for b in a], np.cumsum([0, *(b[0].size for b in a)])
    calls: list[tuple[np.ndarray, ...]] = []

    def scored(points: np.ndarray) -> np.ndarray:
        parts = [points[:, i:j] for i, j in zip(ends, ends[1:], strict=False)]
        X, u, D_hat = (part.reshape(-1, *shape) for part, shape in zip(parts, shapes, strict=True))
        u = basis.T @ u
        X, u, D_hat = (inputs.inside(b, name) for b, name in ((X, "X"), (u, "u"), (D_hat, "D_hat")))
        t = inputs.span * logistic(points[:, -1]) if inputs.span else np.zeros(len(X))
        rows = X, u, plant.delay(X, t) if plant.declares_delay else D_hat, t
        calls.append((*rows, score(*rows)))
        return calls[-1][-1]

    starts = [b.reshape(len(b), -1) for b in a]
    starts += [rng.standard_normal((len(starts[0]), 1))] if inputs.span else []
    evolve(scored, np.concatenate(starts, axis=1), steps, rng, progress)
    X, u, D_hat, t, scores = (np.concatenate(column) for column in zip(*calls, strict=True))
    return (X, u, D_hat, t), scores


def waves(nx: int) -> np.ndarray:
    """cos(π k x_j) / (k + 1)² at the middles x_j of nx cells, (k, j)."""
    k = np.arange(nx)[:, None]
    return np.cos(np.pi * k * (np.arange(nx) + 0.5) / nx) / (k + 1) ** 2


def stairs(nx: int) -> np.ndarray:
    """A constant, then jumps in the middle of all nodes, of each half, … (k, j), as large as the share of nodes."""
    j = np.arange(nx)
    rows: list[Any] = [np.ones(nx)]
    for low, middle, high in _halves(nx):
        rows.append((high - low) / nx * (((low <= j) & (j < middle)) * 1.0 - ((middle <= j) & (j < high))))
    return np.array(rows)


def lines(nx: int) -> np.ndarray:
    """A constant, a line, then hats between both ends, in each half, … (k, j), as high as the share of nodes."""
    rows: list[Any] = [np.ones(nx), np.linspace(-1.0, 1.0, nx)]
    for low, middle, high in _halves(nx - 1):
        rows.append(np.interp(np.arange(nx), (low, middle, high), (0.0, (high - low) / (nx - 1), 0.0)))
    return np.array(rows)


def _halves(length: int) -> Iterator[tuple[int, int, int]]:
    """Where [0, length], its halves, their halves, … begin, are halved and end, down to a length of two."""
    parts = [(0, length)]
    for low, high in parts:
        if high - low > 1:
            middle = (low + high) // 2
            yield low, middle, high
            parts += [(low, middle), (middle, high)]


SHAPES: dict[str, Callable[[int], np.ndarray]] = {"waves": waves, "stairs": stairs, "lines": lines, "nodes": np.eye}


def evolve(
    score: Callable[[np.ndarray], np.ndarray], starts: np.ndarray, steps: int, rng: np.random.Generator,
    progress: Progress,
) -> None:  # fmt: skip
    """Call `score`, (B, k) points to (B,), `steps` times with a point for each of `starts` (B, k), or FEWEST of them.

    Each population adapts one distribution, which starts again at the next of its starts where it has converged.
    """
    groups = np.array_split(starts, max(1, round(len(starts) / POPULATION)))
    sizes, turns = [max(len(group), FEWEST) for group in groups], [0] * len(groups)
    searches = [_started(group[0], size, rng) for group, size in zip(groups, sizes, strict=True)]
    for _ in range(steps):
        asked = [np.array(search.ask()) for search in searches]
        scores = np.nan_to_num(score(np.concatenate(asked)), nan=LOWEST, neginf=LOWEST)
        parts = np.split(scores, np.cumsum(sizes)[:-1])
        for k, (points, values) in enumerate(zip(asked, parts, strict=True)):
            searches[k].tell(list(points), (-values).tolist())
            if searches[k].stop():
                turns[k] += 1
                searches[k] = _started(groups[k][turns[k] % len(groups[k])], sizes[k], rng)
        progress(len(scores))


def _started(start: np.ndarray, size: int, rng: np.random.Generator) -> Any:
    import cma  # it takes a while, and only an adversary needs it

    options = {
        "popsize": size, "CMA_diagonal": len(start) > FULL, "randn": lambda *shape: rng.standard_normal(shape),
        "seed": np.nan, "verbose": -9,
    }  # fmt: skip
    return cma.CMAEvolutionStrategy(start, SPREAD, options)
