"""Initial states, delays and estimates of loops."""

from dataclasses import dataclass

import numpy as np

from npred.base import randomness
from npred.lab.config import Generate, Pipeline
from npred.lab.config.results import PredictorId
from npred.plants import Plant


@dataclass(frozen=True)
class Starts:
    """The loops of an evaluation: first that of Fig. 1, then the cases, then the map D x D_hat(0)."""

    X0: np.ndarray  # (B, n)
    D: np.ndarray  # (B,)
    D_hat0: np.ndarray  # (B,)
    cases: slice
    map: slice
    repeats: int  # cases of each initial state

    def of(self, contender: PredictorId) -> int:
        """The number of loops that a contender runs: the map only with adaptation."""
        return len(self.D) if contender.adapts else self.cases.stop


def box(plant: Plant, config: Generate, data: bool = False) -> np.ndarray:
    """The range of each initial state, (n, 2).

    Experiments start in the plant's, and in the pipeline's where the plant has none. Of data the pipeline's comes
    first: it may be wider, so that a network sees what its loops lead to.
    """
    ranges = plant.box | config.box if data else config.box | plant.box
    return np.array([ranges[name] for name in plant.states], dtype=float)


def starts(pipeline: Pipeline, plant: Plant) -> Starts:
    """Fig. 1's start, random states of the plant's box x case_D_hat0 at delay D, Fig. 1's state over the map.

    Of a plant that declares its delay the random states alone: D and D_hat(0) mean nothing there.
    """
    config, ranges = pipeline.evaluate, box(plant, pipeline.generate)
    rng = randomness.generator(pipeline.seed, "evaluate", "cases")
    states = rng.uniform(ranges[:, 0], ranges[:, 1], (config.case_states, plant.n))
    D, D_hat0 = np.meshgrid(config.map_D, config.map_D_hat0, indexing="ij")
    estimates = config.case_D_hat0[: 1 if plant.declares_delay else None]
    cases, cells = config.case_states * len(estimates), D.size
    return Starts(
        np.concatenate([[config.X0], np.repeat(states, len(estimates), 0), np.tile(config.X0, (cells, 1))]),
        np.concatenate([np.full(1 + cases, config.D), D.ravel()]),
        np.concatenate([[config.D_hat0], np.tile(estimates, config.case_states), D_hat0.ravel()]),
        slice(1, 1 + cases),
        slice(1 + cases, 1 + cases + cells),
        len(estimates),
    )
