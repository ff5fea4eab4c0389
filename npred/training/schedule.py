"""The learning rate over a training, and where a training may end."""

import math
from itertools import pairwise

from npred.config import Training

WARM_UP = 0.05  # share of the steps in which the one-cycle rate climbs
CYCLES = 4  # of that rate in a training that may end before its last epoch, each twice as long as the one before


def rate(config: Training, epochs: float) -> float:
    """The learning rate after so many epochs, a fraction allowed.

    one-cycle [Smith and Topin 2018]: up in a straight line, down along a cosine; with config.eps several times, each
    twice as long [warm restarts, Loshchilov and Hutter 2017]. step: halved every 50 epochs [DAPF].
    """
    if config.schedule == "step":
        return config.lr * 0.5 ** (int(epochs) // 50)
    ends = [0, *cycle_ends(config)]
    start, end = next(pair for pair in pairwise(ends) if epochs < pair[1] or pair[1] == ends[-1])
    done = (epochs - start) / (end - start)
    if done < WARM_UP:
        return config.lr * (0.04 + 0.96 * done / WARM_UP)
    return config.lr * (1e-4 + 0.5 * (1 + math.cos(math.pi * (done - WARM_UP) / (1 - WARM_UP))))


def cycle_ends(config: Training) -> list[int]:
    """The epochs after which the one-cycle rate has come down: the last one, or with config.eps also some before."""
    count = CYCLES if config.eps else 1
    return sorted({math.ceil(config.epochs * (2**k - 1) / (2**count - 1)) for k in range(1, count + 1)})
