"""A case of the check of a plant, its questions, and their answers in words."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from npred.base import randomness, source_lines
from npred.base.errors import ConfigError
from npred.base.registry import WITHOUT_V
from npred.plants import inputs, speed
from npred.plants.base import Plant
from npred.prediction.delays import problem_of

Verdict = tuple[Literal["yes", "warn", "no"], str] | tuple[Literal["yes", "warn", "no"], str, dict[str, Any]]
SHOWN = 3  # states in a sentence, at most
STEP = 0.5  # a step of RK4, times the fastest rate on the box
MOST = 20_000  # steps
SPAN = 30.0  # time constants of the slowest rate at the equilibrium
MOMENTS = 16  # at which a declared delay that depends on time is looked at


class Answer(NamedTuple):
    """A question's name, whether the plant meets it, and a sentence: the finding, and the cure; its figures by name."""

    check: str
    verdict: Literal["yes", "warn", "no"]
    text: str
    figures: dict[str, Any] | None = None


class Check(NamedTuple):
    """A question: its name, its answer, and where it applies."""

    name: str
    answer: Callable[["Case"], Verdict]
    applies: Callable[["Case"], bool] = lambda case: True


@dataclass(frozen=True)
class PlannedExperiment:
    """The task for a plant: the ranges and input bounds that come before its own, the names of the delay
    laws that run, the length of the loops, the true delay of the loops, and the loops of the paper's law, if it is to
    be evaluated.
    """

    box: Mapping[str, tuple[float, float]]
    input_bounds: Any
    laws: Collection[str]
    seconds: float
    D: float | None = None
    adaptive: "Callable[[Case], Any] | None" = None  # npred.diagnosis.adaptive_loop.AdaptiveLoops


@dataclass(frozen=True)
class Case:
    """A plant, the largest delay and the nodes that it is to be predicted with, and how many samples.

    `source` says where the delay is from; u0 is the input before t = 0. The answers so far are kept by the names of
    their questions, and the loops that were simulated by their D_hat. `said` gets each as it is found.
    """

    plant: Plant
    delay: float
    nodes: int
    samples: int
    source: str = "as asked"
    u0: Any = None
    experiment: PlannedExperiment | None = None
    answers: dict[str, Answer] = field(default_factory=dict)
    ensembles: dict[float, Any] = field(default_factory=dict)  # npred.diagnosis.loops.Ensemble
    said: Callable[[Answer], object] = bool

    def ask(self, question: Check) -> Answer | None:
        """The answer, None where the question does not apply. A plant that fails meanwhile has one: no, and how."""
        if question.name not in self.answers and question.applies(self):
            try:
                verdict = question.answer(self)
            except ConfigError as error:
                verdict = "no", str(error)
            figures = verdict[2] if len(verdict) == 3 else None
            self.answers[question.name] = Answer(question.name, verdict[0], verdict[1], figures)
            self.said(self.answers[question.name])
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

    @cached_property
    def box(self) -> dict[str, tuple[float, float]]:
        """The range of each initial state, the experiment's before the plant's."""
        return self.plant.box | (dict(self.experiment.box) if self.experiment else {})

    @cached_property
    def ends(self) -> np.ndarray:
        """The box as an array, (n, 2)."""
        return np.array([self.box[name] for name in self.plant.states], dtype=float)

    @property
    def D(self) -> float:
        """The true delay of loops: the experiment's, which may predict over a longer one."""
        return self.experiment.D if self.experiment and self.experiment.D else self.delay

    @cached_property
    def width(self) -> np.ndarray:
        """The widths of the box (n,); for a state that begins at one value its size, at least 1."""
        width = np.ptp(self.ends, axis=1)
        return np.where(width > 0, width, np.maximum(np.abs(self.ends[:, 0]), 1.0))

    @cached_property
    def times(self) -> tuple[float, float, float]:
        """The step, the time to look at, and the time that is needed: SPAN time constants, or `speed.settled`."""
        plant, X = self.plant, self.X
        f_X, f_U = plant.jacobians(X, self.u)
        rates = np.abs(np.linalg.eigvals(np.concatenate([f_X, f_X + f_U @ plant.kappa_jacobian(X)]))).max()
        horizon = speed.settled(plant)
        if plant.rests:
            eigenvalues = np.linalg.eigvals(plant.linearised()[0])
            rates, horizon = max(rates, np.abs(eigenvalues).max()), SPAN / -eigenvalues.real.max()
        h = STEP / rates if rates > 0 else horizon / MOST
        return h, min(horizon, MOST * h), horizon

    @cached_property
    def limits(self) -> np.ndarray:
        """The input bounds (m, 2), the experiment's before the plant's."""
        return inputs.bounds(self.plant, self.experiment.input_bounds if self.experiment else None)

    @property
    def takes_V(self) -> bool:
        """True if an update law runs: not with a frozen estimate, nor where inputs have several delays."""
        if self.experiment is None or self.plant.declares_delay:
            return problem_of(self.plant).refusal("adaptation") is None
        return any(law not in WITHOUT_V for law in self.experiment.laws)

    @cached_property
    def delays(self) -> tuple[np.ndarray, np.ndarray]:
        """Times t (T,) over a period, and the delay that the plant declares at t and each sample, (T, samples)."""
        t = np.linspace(0.0, speed.long(self.plant), MOMENTS) if self.plant.clocked else np.zeros(1)
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

    def amounts(self, X: np.ndarray, where: np.ndarray) -> str:
        """Values of X (n,) with their units, at most SHOWN of those `where` (n,) is true."""
        names = [name for name, shown in zip(self.plant.states, where, strict=True) if shown]
        values = dict(zip(self.plant.states, X.tolist(), strict=True))
        more = ", …" if len(names) > SHOWN else ""
        return ", ".join(f"{name} {self.amount(name, values[name])}" for name in names[:SHOWN]) + more

    def amount(self, name: str, value: float) -> str:
        """A value of a state or an input with its unit."""
        return f"{value:.3g} {self.plant.units.get(name, '')}".rstrip()
