"""Fig. 1 of [DAPF]: states, input and delay estimate of one loop with each predictor."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from npred.config import Evaluate
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant

SERIES = ("t", "X", "U", "D_hat", "N")


def first(config: Evaluate, loops: Trajectories) -> Trajectories:
    """The loop of Fig. 1, the first of the batch, up to t_end."""
    rows = slice(0, int(np.searchsorted(loops.t, config.t_end + 1e-9)))
    series = {name: getattr(loops, name)[0, rows] for name in ("X", "P", "U", "D_hat", "N", "energy")}
    return replace(loops, t=loops.t[rows], escaped=loops.escaped[0], **series)


def numbers(plant: Plant, loop: Trajectories) -> dict[str, Any]:
    """Where the loop of Fig. 1 ends: state, delay estimate, radius, and when it settled."""
    return {
        "X_end": [metrics.number(x) for x in loop.X[-1]],
        "D_hat_end": metrics.number(loop.D_hat[-1]),
        "radius": metrics.number(metrics.radius(loop, plant.target(loop.t))),
        "settle_time": metrics.number(metrics.settle_time(loop, plant.target(loop.t))),
    }


def write(path: Path, loops: dict[str, Trajectories]) -> None:
    """The loops as HDF5: by contender t, X, U, D_hat, and N of the stability proof."""
    with h5py.File(path, "w") as file:
        for name, loop in loops.items():
            for series in SERIES:
                file[f"{name}/{series}"] = getattr(loop, series)
