"""The plant's own simulator, rolled forward over the delay, for a plant that is a black box."""

import numpy as np

from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods.base import Predictor


class Rollout(Predictor):
    """P by the function `rollout` that a black box declares: the simulator's steps, one per interval of nodes.

    The order is the simulator's. Raises ConfigError for a plant that declares no rollout.
    """

    name = "rollout"

    def __init__(self, plant: Plant, nx: int = 101):
        super().__init__(plant, nx)
        problem_of(plant).needs(self.name)

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray | float) -> np.ndarray:
        return self.plant.rollout(X, u, D_hat, t)
