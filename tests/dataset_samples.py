"""A data set of a few random rows."""

import numpy as np

from npred.lab.training.data.dataset import Dataset


def dataset(count=6):
    random = np.random.default_rng(0)
    return Dataset(
        X=random.normal(size=(count, 2)),
        u=random.normal(size=(count, 5, 1)),
        D_hat=random.uniform(size=count),
        P=random.normal(size=(count, 5, 2)),
        D=np.ones(count),
        t=random.uniform(size=count),
        rollout=np.repeat(np.arange(count // 2, dtype=np.int32), 2),
        test=np.resize(np.array([1, 1, 0, 0, 0, 0], dtype=np.uint8), count),
    )
