"""A case of the check of a plant, its questions, and their answers in words."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from npred import randomness, source_lines
from npred.config import FROZEN, Loop, Pipeline, Scenario
from npred.delays import problem_of
from npred.errors import ConfigError
from npred.plants import inputs
from npred.plants.base import Plant

Verdict = tuple[Literal["yes", "warn", "no"], str]
STAGES = ("generate", "train", "evaluate", "bench")
LOOPS = ("generate", "evaluate")  # those that simulate
ANY = "any stage"
SPAN, MOMENTS = 100.0, 16  # s, and how many times: where a declared delay that depends on time is looked at
OBSERVER = "delay-observer"
WITHOUT_V = (FROZEN, "l1", OBSERVER)  # laws that take no V


class Answer(NamedTuple):
    """A question's name, whether the plant meets it, and a sentence: what was found, and the cure."""

    check: str
    verdict: Literal["yes", "warn", "no"]
    text: str


@dataclass(frozen=True)
class Case:
    """A plant, the largest delay in seconds and the nodes that it is to be predicted with, and how many samples.

    A pipeline changes the box, the input bounds and the input before t = 0, and says whether an update law runs in its
    `stages`. The answers so far are kept by the names of their questions.
    """

    plant: Plant
    delay: float
    nodes: int
    samples: int
    pipeline: Pipeline | None = None
    stages: Collection[str] = STAGES
    source: str = ""  # of the delay
    commands: Any = None  # the input before t = 0, where it is not the pipeline's
    answers: dict[str, Answer] = field(default_factory=dict)

    def ask(self, question: "Check") -> Answer | None:
        """The answer, None where the question does not apply. A plant that fails meanwhile has one: no, and how."""
        if question.name not in self.answers and question.applies(self):
            try:
                verdict = question.answer(self) or ("yes", "")
            except ConfigError as error:
                verdict = "no", str(error)
            self.answers[question.name] = Answer(question.name, *verdict)
        return self.answers.get(question.name)

    def verdict(self, name: str) -> str | None:
        """The answer to that question so far: yes, warn, no, or None where it was not asked."""
        return self.answers[name].verdict if name in self.answers else None

    @property
    def leads(self) -> str | None:
        """True if kappa without delay leads somewhere: the verdict, so far, on stability or on a reference."""
        return self.verdict("stability" if self.plant.rests else "reference")

    @property
    def sound(self) -> bool:
        """True if f and kappa, and V where a law takes it, were evaluated on the box, and are finite there."""
        return self.verdict("finite") == "yes"

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
        """The input before t = 0."""
        return self.pipeline.generate.u0 if self.pipeline and self.commands is None else self.commands

    @property
    def settings(self) -> Pipeline:
        """The pipeline, for questions about one."""
        assert self.pipeline is not None
        return self.pipeline

    @property
    def loops(self) -> dict[str, Loop]:
        """The loops of the pipeline's stages that are to run."""
        return {stage: getattr(self.pipeline, stage) for stage in LOOPS if self.pipeline and stage in self.stages}

    @property
    def takes_V(self) -> bool:
        """True if an update law runs: not with a frozen estimate, nor where inputs have several delays."""
        if self.pipeline is None or self.plant.declares_delay:
            return problem_of(self.plant).refusal("adaptation") is None
        laws = [loop.adaptation for loop in self.loops.values()] + [s.adaptation for s in self.scenarios]
        return any(law is not None and law not in WITHOUT_V for law in laws)

    @property
    def scenarios(self) -> list[Scenario]:
        return self.pipeline.evaluate.scenarios if self.pipeline and "evaluate" in self.stages else []

    @cached_property
    def delays(self) -> tuple[np.ndarray, np.ndarray]:
        """Times t (T,) over a period, and the delay that the plant declares at t and each sample, (T, samples)."""
        t = np.linspace(0.0, self.plant.period or SPAN, MOMENTS) if self.plant.clocked else np.zeros(1)
        with np.errstate(all="ignore"):
            return t, np.array([self.plant.delay(self.X, moment) for moment in t])

    @cached_property
    def X(self) -> np.ndarray:
        """States drawn from the box, (samples, n)."""
        ends, shape = self.ends, (self.samples, self.plant.n)
        return randomness.generator(0, "plant check").uniform(ends[:, 0], ends[:, 1], shape)

    @cached_property
    def u(self) -> np.ndarray:
        """kappa of those states within the input bounds, (samples, m)."""
        with np.errstate(all="ignore"):  # where it is not finite, the question `finite` reports it
            U = self.plant.kappa(self.X)
        return np.clip(U, *self.limits.T)

    def state(self, X: np.ndarray) -> str:
        return source_lines.values(self.plant.states, X)


class Check(NamedTuple):
    """A question: its name, its answer, and where it applies.

    It is asked before a run of the stage `before`, or of ANY; it is `shown` among the answers about a plant.
    """

    name: str
    answer: Callable[[Case], Verdict | None]  # None is yes
    applies: Callable[[Case], bool] = lambda case: True
    before: str | None = None
    shown: bool = True
