"""What is asked of a plant, and an answer in words."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from npred import randomness
from npred.errors import ConfigError
from npred.plants import blame, inputs
from npred.plants.base import Plant


@dataclass(frozen=True)
class Answer:
    """A question's name, whether the plant meets it, and a sentence: what was found, and the cure."""

    check: str
    verdict: Literal["yes", "warn", "no"]
    text: str

    def json(self) -> dict[str, str]:
        """As `--json` prints it."""
        return asdict(self)


def settled(answers: Sequence[Answer]) -> bool:
    """Whether no answer is no."""
    return all(answer.verdict != "no" for answer in answers)


@dataclass(frozen=True)
class Case:
    """A plant, the largest delay in seconds and the nodes that it is to be predicted with, and how many samples."""

    plant: Plant
    delay: float
    nodes: int
    samples: int

    def __post_init__(self) -> None:
        if not 0 < self.delay < np.inf:
            raise ConfigError(f"delay: expected a positive number of seconds, got {self.delay:g}; mend it")
        if self.nodes < 2:
            raise ConfigError(f"nodes: expected at least 2, both ends of [0, 1], got {self.nodes}; mend it")

    @property
    def h(self) -> float:
        """The predictor's step in seconds."""
        return self.delay / (self.nodes - 1)

    @cached_property
    def X(self) -> np.ndarray:
        """States drawn from the box, (samples, n)."""
        ends = np.array([self.plant.box[name] for name in self.plant.states])
        return randomness.generator(0, "plant check").uniform(ends[:, 0], ends[:, 1], (self.samples, self.plant.n))

    @cached_property
    def u(self) -> np.ndarray:
        """kappa of those states within the plant's input bounds, (samples, m)."""
        bounds = inputs.bounds(self.plant, None)
        with np.errstate(all="ignore"):  # where it is not finite, the question `finite` tells
            U = self.plant.kappa(self.X)
        return np.clip(U, bounds[:, 0], bounds[:, 1])

    def place(self, function: str) -> str:
        """Plant, file and line of a declared function."""
        return self.plant.place(function)

    def state(self, X: np.ndarray) -> str:
        """A state in words."""
        return blame.values(self.plant.states, X)
