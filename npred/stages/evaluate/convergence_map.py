"""The convergence map of a predictor's loops over delays and first estimates."""

import numpy as np

from npred.config import Evaluate
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant
from npred.results.evaluate import DelayMap


def delay_map(plant: Plant, config: Evaluate, loops: Trajectories, reference: Trajectories) -> DelayMap:
    """The loops of the map D x D_hat(0) that converge, and their share of those that do with the numerical predictor.

    `band` is the range of D in which no loop is lost that converges with the numerical predictor.
    """
    shape = (len(config.map_D), len(config.map_D_hat0))
    converged, exact = (_converged(plant, run).reshape(shape) for run in (loops, reference))
    safe = [D for D, row, goal in zip(config.map_D, converged, exact, strict=True) if (row | ~goal).all()]
    return DelayMap(
        D=config.map_D, D_hat0=config.map_D_hat0, converged=converged.tolist(),
        share=(converged & exact).sum() / max(exact.sum(), 1), band=(min(safe), max(safe)) if safe else None,
    )  # fmt: skip


def _converged(plant: Plant, loops: Trajectories) -> np.ndarray:
    target = plant.target(loops.t)
    return metrics.converged(metrics.radius(loops, target), target)
