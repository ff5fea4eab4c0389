"""Random draws of the data: starts, delays, sample times, held-out rollouts; one seed per rollout."""

from functools import lru_cache

import numpy as np

from npred.base import grid, randomness
from npred.lab.config import Generate
from npred.lab.config.conditions import box
from npred.plants import Plant

NEAREST = 0.01  # of `spread`: the smallest displacement of a row
SMOOTH = 6  # Legendre polynomials in a displacement of u


def starts(seed: int, config: Generate, plant: Plant, chunk: range) -> tuple[np.ndarray, ...]:
    """X0 (B, n), D and D_hat(0) (B,), sorted sample steps (B, S), each rollout's from its child seed."""
    low, high = box(plant, config, data=True).T
    regular, drawn = config.rollouts - config.explorers, []
    for r in chunk:
        rng = randomness.generator(seed, "rollout", r)
        D, D_hat = config.explore_D, config.explore_D_hat0
        if r < regular:
            D = config.D if isinstance(config.D, tuple) else (config.D, config.D)
            D_hat = config.D_hat0[r * len(config.D_hat0) // regular]
        X0, D0, D_hat0 = rng.uniform(low, high), rng.uniform(*D), rng.uniform(*D_hat)
        taken = np.sort(rng.choice(steps(config), samples(config, r), replace=False))
        drawn.append((X0, D0, D_hat0, np.pad(taken, (0, samples(config, 0) - len(taken)), mode="edge")))
    return tuple(np.array(column) for column in zip(*drawn, strict=True))


def redrawn(
    seed: int, config: Generate, chunk: range, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """X (B, S, n), u (B, S, nx, m), D_hat (B, S), the share `redraw` anew in the rollouts that are trained on."""
    X, u, D_hat, kept = X.copy(), u.copy(), D_hat.copy(), spared(seed, config)
    for k, r in enumerate(chunk):
        if config.redraw and r < config.rollouts and r not in kept:
            rng = randomness.generator(seed, "redraw", r)
            chosen = rng.random(len(D_hat[k])) < config.redraw
            D_hat[k, chosen] = rng.uniform(*config.explore_D_hat0, chosen.sum())
            if config.spread:
                (aside, push), rows = spread(rng, config, X[k], u[k]), chosen[:, None]
                X[k] += rows * aside
                u[k] += rows[..., None] * push
    return X, u, D_hat


def spread(rng: np.random.Generator, config: Generate, X: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacements of X (S, n) and of u (S, nx, m), in units of the standard deviations of their columns.

    Each row has one size, from `spread` down to a hundredth of it, all orders of magnitude alike: the network is to be
    accurate near the loop, and not lost off it. That of u is a smooth function of x: its Legendre moments are normal,
    the k-th of standard deviation 1 / (1 + k).
    """
    size = config.spread * NEAREST ** rng.random((len(X), 1))
    shapes = np.polynomial.legendre.legvander(2 * grid.nodes(u.shape[1]) - 1, SMOOTH - 1)  # (nx, SMOOTH)
    moments = rng.standard_normal((len(u), SMOOTH, u.shape[2])) / (1 + np.arange(SMOOTH))[:, None]
    aside = size * X.std(axis=0) * rng.standard_normal(X.shape)
    return aside, size[..., None] * u.std(axis=(0, 1)) * (shapes @ moments)


def held_out(seed: int, config: Generate) -> np.ndarray:
    """The numbers of the data's held-out rollouts: at least one, never all, and no explorer."""
    return np.array(sorted(spared(seed, config)))


def explorers(config: Generate, most: int) -> range:
    """The numbers of explorers beyond those of the data, as large a share of them as is held out of the others.

    At most `most`, at least one; none where none is trained on.
    """
    count = min(max(round(config.test_share * config.explorers), 1), most) if config.explorers else 0
    return range(config.rollouts, config.rollouts + count)


def spared(seed: int, config: Generate) -> frozenset[int]:
    """The same as a set."""
    return _spared(seed, config.rollouts - config.explorers, config.test_share)


def samples(config: Generate, rollout: int) -> int:
    """The samples of a rollout: an equal share, one more for the first ones where the division leaves a remainder."""
    share, remainder = divmod(config.samples, config.rollouts)
    return share + (rollout < remainder)


def steps(config: Generate) -> int:
    """The control steps of a rollout, the one at t = 0 included."""
    return round(config.t_end / config.dt) + 1


@lru_cache(maxsize=8)  # every chunk of rollouts asks
def _spared(seed: int, regular: int, share: float) -> frozenset[int]:
    count = min(max(round(share * regular), 1), regular - 1)
    return frozenset(randomness.generator(seed, "held out").permutation(regular)[:count].tolist())
