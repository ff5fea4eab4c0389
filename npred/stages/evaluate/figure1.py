"""Fig. 1 of [DAPF]: states, input and delay estimate of one loop with each predictor."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from npred.config import Evaluate
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant
from npred.results import Contender
from npred.results.evaluate import LoopEnd

SERIES = ("t", "X", "U", "D_hat", "N")


def first(config: Evaluate, loops: Trajectories) -> Trajectories:
    """The loop of Fig. 1, the first of the batch, up to t_end."""
    rows = slice(0, int(np.searchsorted(loops.t, config.t_end + 1e-9)))
    series = {name: getattr(loops, name)[0, rows] for name in ("X", "P", "U", "D_hat", "N", "energy")}
    return replace(loops, t=loops.t[rows], escaped=loops.escaped[0], **series)


def numbers(plant: Plant, loop: Trajectories) -> LoopEnd:
    """The end of the loop of Fig. 1: state, delay estimate, radius, and when it settled."""
    target = plant.target(loop.t)
    radius, settle_time = float(metrics.radius(loop, target)), float(metrics.settle_time(loop, target))
    return LoopEnd(X_end=loop.X[-1].tolist(), D_hat_end=loop.D_hat[-1], radius=radius, settle_time=settle_time)


def write(path: Path, loops: Mapping[Contender, Trajectories]) -> None:
    """The loops as HDF5: by contender t, X, U, D_hat, and N of the stability proof."""
    with h5py.File(path, "w") as file:
        for contender, loop in loops.items():
            for series in SERIES:
                file[f"{contender.name}/{series}"] = getattr(loop, series)
