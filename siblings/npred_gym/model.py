"""A plant of npred, a numerical predictor or a trained network as what predicts an observation."""

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from npred.base.errors import ConfigError
from npred.plants import Plant
from npred.prediction.methods import Predictor, numerical
from npred_gym import environment
from npred_gym.path import HeldAction


class Model:
    """The observation after the pieces, by a predictor of npred, or by RK4 for a plant.

    `state(observation)` is the plant's state, `observe(X)` the observation; those of `npred_gym.plant` have both, and
    by default a plant's state is the observation. A network predicts over all pieces in one call, from their means over
    the cells of its nodes; numerical methods over one piece after another. Raises ConfigError for what is no predictor.
    """

    def __init__(
        self, predictor: Plant | Predictor, env: gym.Env, state: Callable[[Any], Any] | None = None,
        observe: Callable[[np.ndarray], Any] | None = None,
    ) -> None:  # fmt: skip
        if not isinstance(predictor, Plant | Predictor):
            raise ConfigError(f"predictor: expected a plant or a predictor, got {predictor!r}; make one with npred")
        self.predictor = numerical("rk4", predictor, 11) if isinstance(predictor, Plant) else predictor
        declared = self.predictor.plant.declaration
        self.state = state or getattr(declared, "_state", np.asarray)
        self.observe = observe or getattr(declared, "_observe", np.asarray)
        self.dt = environment.control_step(env)
        self.whole = hasattr(getattr(self.predictor, "model", self.predictor), "operator")

    def __call__(self, observation: Any, pieces: Sequence[HeldAction]) -> Any:
        X, nx = np.asarray(self.state(observation), dtype=float), self.predictor.nx
        for part in [pieces] if self.whole else ([piece] for piece in pieces):
            X = self.predictor(X, nodes(part, nx), self.dt * sum(piece.steps for piece in part))[-1]
        return self.observe(X)


def nodes(pieces: Sequence[HeldAction], nx: int) -> np.ndarray:
    """The means (nx, m) of the actions over the cells of nx nodes, as npred.base.grid.lines reads them."""
    times = np.cumsum([0.0, *(piece.steps for piece in pieces)])
    held = np.array([piece.action for piece in pieces], dtype=float)
    areas = np.concatenate([0 * held[:1], np.cumsum(held * np.diff(times)[:, None], axis=0)])
    edges = np.clip((np.arange(nx + 1) - 0.5) / (nx - 1), 0.0, 1.0) * times[-1]
    means = [np.diff(np.interp(edges, times, area)) / np.diff(edges) for area in areas.T]
    return np.stack(means, axis=-1)
