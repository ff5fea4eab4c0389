"""Over which delays and first estimates a predictor's loops converge."""

from typing import Any

import numpy as np

from npred.config import Evaluate
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant


def delay_map(plant: Plant, config: Evaluate, loops: Trajectories, reference: Trajectories) -> dict[str, Any]:
    """Which loops of the map D x D_hat(0) converge, and what share of those that do with the numerical predictor.

    `band` is the range of D in which no loop is lost that the numerical predictor brings home.
    """
    shape = (len(config.map_D), len(config.map_D_hat0))
    found, wanted = (_home(plant, run).reshape(shape) for run in (loops, reference))
    safe = [D for D, row, goal in zip(config.map_D, found, wanted, strict=True) if (row | ~goal).all()]
    return {
        "D": config.map_D,
        "D_hat0": config.map_D_hat0,
        "converged": found.tolist(),
        "share": float((found & wanted).sum() / max(wanted.sum(), 1)),
        "band": [min(safe), max(safe)] if safe else None,
    }


def _home(plant: Plant, loops: Trajectories) -> np.ndarray:
    target = plant.target(loops.t)
    return metrics.converged(metrics.radius(loops, target), target)
