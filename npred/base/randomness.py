"""Child seeds by name: a result depends on the seed and on its purpose, never on the number of jobs."""

import zlib

import numpy as np


def child(seed: int, *path: str | int) -> np.random.SeedSequence:
    """The seed of `path` under `seed`, for example child(0, "rollout", 17)."""
    words = [part if isinstance(part, int) else zlib.crc32(part.encode()) for part in path]
    return np.random.SeedSequence(entropy=seed, spawn_key=tuple(words))


def generator(seed: int, *path: str | int) -> np.random.Generator:
    """A NumPy generator seeded by child(seed, *path)."""
    return np.random.default_rng(child(seed, *path))


def integer(seed: int, *path: str | int) -> int:
    """A 63-bit integer seed for libraries that want one (torch)."""
    return int(child(seed, *path).generate_state(1, np.uint64)[0] >> 1)
