"""Random draws of the data: starts, delays, sample times, held-out rollouts; one seed per rollout."""

from functools import lru_cache

import numpy as np

from npred import randomness
from npred.config import Generate, Range
from npred.plants import Plant


def starts(seed: int, config: Generate, plant: Plant, chunk: range) -> tuple[np.ndarray, ...]:
    """X0 (B, n), D and D_hat(0) (B,), sorted sample steps (B, S), each rollout's from its child seed."""
    box = _box(plant, config)
    drawn = []
    for r in chunk:
        rng = randomness.generator(seed, "rollout", r)
        D, D_hat = _delays(config, r)
        X0, D0, D_hat0 = rng.uniform(box[:, 0], box[:, 1]), rng.uniform(*D), rng.uniform(*D_hat)
        taken = np.sort(rng.choice(steps(config), samples(config, r), replace=False))
        drawn.append((X0, D0, D_hat0, np.pad(taken, (0, samples(config, 0) - len(taken)), mode="edge")))
    return tuple(np.array(column) for column in zip(*drawn, strict=True))


def redrawn(seed: int, config: Generate, chunk: range, D_hat: np.ndarray) -> np.ndarray:
    """D_hat (B, S) with the share `redraw` of it drawn anew, in the rollouts that are trained on."""
    D_hat, kept = D_hat.copy(), spared(seed, config)
    for row, r in zip(D_hat, chunk, strict=True):
        if config.redraw and r < config.rollouts and r not in kept:
            rng = randomness.generator(seed, "redraw", r)
            chosen = rng.random(len(row)) < config.redraw
            row[chosen] = rng.uniform(*config.explore_D_hat0, chosen.sum())
    return D_hat


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


def _delays(config: Generate, rollout: int) -> tuple[Range, Range]:
    """The ranges of D and D_hat(0) of a rollout."""
    regular = config.rollouts - config.explorers
    if rollout >= regular:
        return config.explore_D, config.explore_D_hat0
    D = config.D if isinstance(config.D, tuple) else (config.D, config.D)
    return D, config.D_hat0[rollout * len(config.D_hat0) // regular]


def _box(plant: Plant, config: Generate) -> np.ndarray:
    """The range of each initial state (n, 2): the plant's box, overridden by the pipeline's."""
    box = plant.box | config.box
    return np.array([box[name] for name in plant.states], dtype=float)
