"""What is asked of a plant, and an answer in words."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from npred import randomness
from npred.config import Pipeline
from npred.delays import family_of
from npred.diagnosis import pipeline_fit
from npred.errors import ConfigError
from npred.plants import inputs
from npred.plants.base import Plant
from npred.symbolic import source_lines


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


def asked(name: str, question: Callable[["Case"], Answer], case: "Case") -> Answer:
    """The answer to a question; a plant that fails on the way has one too: no, and how it failed."""
    try:
        return question(case)
    except ConfigError as error:
        return Answer(name, "no", str(error))


@dataclass(frozen=True)
class Case:
    """A plant, the largest delay in seconds and the nodes that it is to be predicted with, and how many samples.

    A pipeline changes the box, the input bounds and the input before t = 0, and says whether an update law runs.
    """

    plant: Plant
    delay: float
    nodes: int
    samples: int
    pipeline: Pipeline | None = None

    def __post_init__(self) -> None:
        if not 0 < self.delay < np.inf:
            raise ConfigError(f"delay: expected a positive number of seconds, got {self.delay:g}; fix it")
        if self.nodes < 2:
            raise ConfigError(f"nodes: expected at least 2, both ends of [0, 1], got {self.nodes}; fix it")

    @property
    def h(self) -> float:
        """The predictor's step in seconds."""
        return self.delay / (self.nodes - 1)

    @cached_property
    def box(self) -> dict[str, tuple[float, float]]:
        """The range of each initial state, the pipeline's before the plant's."""
        return self.plant.box | (self.pipeline.generate.box if self.pipeline else {})

    @cached_property
    def ends(self) -> np.ndarray:
        """The box as an array, (n, 2)."""
        return np.array([self.box[name] for name in self.plant.states], dtype=float)

    @cached_property
    def limits(self) -> np.ndarray:
        """The input bounds (m, 2), the pipeline's before the plant's."""
        return inputs.bounds(self.plant, self.pipeline.generate.input_bounds if self.pipeline else None)

    @property
    def u0(self) -> Any:
        """What the pipeline says of the input before t = 0."""
        return self.pipeline.generate.u0 if self.pipeline else None

    @property
    def takes_V(self) -> bool:
        """Whether an update law runs: not with a frozen estimate, nor where inputs have delays of their own."""
        return (
            family_of(self.plant).refusal("adaptation") is None
            if self.pipeline is None
            else pipeline_fit.adapts(self.pipeline, ("generate", "evaluate"))
        )

    @cached_property
    def X(self) -> np.ndarray:
        """States drawn from the box, (samples, n)."""
        ends, shape = self.ends, (self.samples, self.plant.n)
        return randomness.generator(0, "plant check").uniform(ends[:, 0], ends[:, 1], shape)

    @cached_property
    def u(self) -> np.ndarray:
        """kappa of those states within the input bounds, (samples, m)."""
        with np.errstate(all="ignore"):  # where it is not finite, the question `finite` tells
            U = self.plant.kappa(self.X)
        return np.clip(U, *self.limits.T)

    def place(self, function: str) -> str:
        """Plant, file and line of a declared function."""
        return self.plant.place(function)

    def state(self, X: np.ndarray) -> str:
        """A state in words."""
        return source_lines.values(self.plant.states, X)
