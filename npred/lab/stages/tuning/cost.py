"""What loops of [evaluate] cost, by start: the time until they settle, and a little of the control effort."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np

from npred import plants
from npred.base import randomness
from npred.base.errors import ConfigError
from npred.formulas import programs
from npred.formulas.trace import Trace
from npred.lab.config import Pipeline, Scenario, conditions
from npred.lab.config.conditions import Condition
from npred.laws.design import Design
from npred.laws.law import rounded
from npred.laws.regulator import adjustable, riccati, weights
from npred.loop import metrics
from npred.loop.trajectories import Trajectories
from npred.plants import Plant
from npred.prediction.methods import numerical

LAW = ("gamma", "b")  # numbers of the delay law, as [evaluate] calls them
ALPHA = "safety.alpha"  # of the safety filter, likewise
LETTERS = ("Q", "R")  # weights of kappa = "lqr"
CASES = Scenario(name="cases")  # [evaluate] as it stands
Progress = Callable[[int], None]


@dataclass(frozen=True)
class Settling:
    """Loops from S initial states, K of each: `time`, `effort` and whether each settles, (S, K); see `of`."""

    time: np.ndarray
    effort: np.ndarray
    settled: np.ndarray

    @classmethod
    def of(cls, loops: Trajectories, plant: Plant, states: int, limited: bool = False) -> "Settling":
        """The loops (states * K,) against the target X* and input U* of `plant`, whatever was tuned in them.

        time: of the first step from which |X - X*| stays within 1 % of size(X*) (npred.loop.metrics). A loop that does
        not settle in T = t_end has (2 + q) T with q = r / (1 + r), r = sup |X - X*| / size(X*) over the last tenth:
        from 2 T to 3 T, less where it ends nearer. One that leaves the finite numbers at t has 4 T - t, from 3 T to
        4 T. If `limited`, a loop that breaks a limit of the plant does not settle.
        effort: the mean of |U - U*|² over [0, T], by trapezia; infinite where a loop does not settle.
        """
        target, t_end = plant.target(loops.t), float(loops.t[-1])
        time, near = metrics.settle_time(loops, target), metrics.radius(loops, target) / metrics.size(target)
        finite = np.isfinite(loops.X).all(axis=-1).mean(axis=-1)
        settled = np.isfinite(time)
        if limited and loops.safety is not None:
            settled = settled & ~(loops.safety < 0).any(axis=(-2, -1))
        with np.errstate(invalid="ignore", over="ignore"):
            lost = np.where(np.isfinite(near), (2 + near / (1 + near)) * t_end, (4 - finite) * t_end)
            effort = np.trapezoid(np.sum((loops.U - plant.u_target(loops.t)) ** 2, axis=-1), loops.t) / t_end
        columns = np.where(settled, time, lost), np.where(settled, effort, np.inf), settled
        return cls(*(a.reshape(states, -1) for a in columns))

    @classmethod
    def failed(cls, like: "Settling", t_end: float) -> "Settling":
        """Loops that cannot be simulated: as lost as one that leaves the finite numbers at once."""
        return cls(np.full_like(like.time, 4 * t_end), np.full_like(like.effort, np.inf), like.settled & False)


@dataclass(frozen=True)
class Yardstick:
    """The unit of the cost: mean time T_0 and effort E_0 of the present loops from the training starts.

    The cost of a loop is time / T_0 + w E / (E + E_0), w the weight `effort`: about 1 + w / 2 at present; a loop that
    does not settle has all of w.
    """

    time: float
    effort: float
    weight: float

    @classmethod
    def of(cls, present: Settling, weight: float, dt: float) -> "Yardstick":
        """That of these loops; a time is at least dt, and an effort above 0."""
        efforts = present.effort[present.settled]
        effort = float(efforts.mean()) if efforts.size else 1.0
        return cls(max(float(present.time.mean()), dt), effort or 1.0, weight)

    def costs(self, outcome: Settling) -> np.ndarray:
        """The cost of each loop, (S, K)."""
        return outcome.time / self.time + self.weight * (1 - self.effort / (outcome.effort + self.effort))


@dataclass(frozen=True)
class Loops:
    """The cases of [evaluate] and its scenarios from `states` random initial states of the box, drawn by `purpose`."""

    pipeline: Pipeline
    plant: Plant
    states: int
    purpose: str

    @cached_property
    def conditions(self) -> list[Condition]:
        """One for the cases, then one per scenario."""
        seed = randomness.integer(self.pipeline.seed, "tune", self.purpose)
        table = self.pipeline.evaluate.model_copy(update={"case_states": self.states})
        drawn = self.pipeline.model_copy(update={"seed": seed, "evaluate": table})
        return [conditions.under(self.plant, drawn, scenario) for scenario in (CASES, *table.scenarios)]

    @property
    def steps(self) -> int:
        """Control steps of all loops together."""
        return sum(condition.steps for condition in self.conditions)

    def run(self, numbers: Mapping[str, float], progress: Progress) -> Settling:
        """The loops with these gamma, b and parameters, and the pipeline's numerical predictor."""
        plant, parts = varied(self.plant, numbers), []
        for condition in self.conditions:
            law: dict[str, Any] = {name: numbers[name] for name in LAW if name in numbers}
            safety = condition.table.safety
            if safety and ALPHA in numbers and safety == self.pipeline.evaluate.safety:  # a scenario's stays
                law["safety"] = replace(safety, alpha=numbers[ALPHA])
            table = condition.table.model_copy(update=law)
            predictor = numerical(table.predictor, plant, table.nx)
            changed = Condition(table, condition.X0, condition.D, condition.D_hat, condition.t_end, condition.seed)
            loops = changed.loops(plant, predictor, progress=progress)  # every step: a law may ripple between
            parts.append(Settling.of(loops, self.plant, self.states, limited=safety is not None))
        columns = ("time", "effort", "settled")
        return Settling(*(np.concatenate([getattr(part, name) for part in parts], axis=1) for name in columns))


@dataclass(frozen=True)
class LqrWeights:
    """The diagonals of Q and R of kappa = "lqr", as numbers that vary.

    `present` has those of the plant's law, Q.<state> … and R.<input> …; `law` is the plant whose law takes K as
    parameters, so that other weights solve a Riccati equation, and compile nothing.
    """

    design: Design
    present: Mapping[str, float]
    law: Plant

    @classmethod
    @lru_cache(maxsize=16)
    def of(cls, plant: Plant) -> Self | None:
        """None for a plant with another law. Raises ConfigError for weights that are no diagonals."""
        table = dict(plant.law_table)
        if table.pop("law", None) != "lqr":
            return None
        design = Design(plant, "lqr")
        both = weights(design, **table)
        if any(np.count_nonzero(matrix - np.diag(np.diag(matrix))) for matrix in both):
            raise design.refusal("diagonals Q and R to tune, got a matrix", "write one weight each")
        names = [*(f"Q.{name}" for name in plant.states), *(f"R.{name}" for name in plant.inputs)]
        present = dict(zip(names, np.concatenate([np.diag(matrix) for matrix in both]).tolist(), strict=True))
        return cls(design, present, adjustable(plant, riccati(*design.linearised, *both)[1]))

    def named(self, free: Sequence[str]) -> list[str]:
        """The names, with all weights for Q and R. Only ratios count: where all weights are free, the last is held."""
        names = [name for name in self.present if name in free or name[0] in free]
        names = names[:-1] if len(names) == len(self.present) else names
        return [*(name for name in free if name not in (*LETTERS, *self.present)), *names]

    def table(self, numbers: Mapping[str, float]) -> dict[str, Any]:
        """The kappa of a pipeline with these weights, and the present ones for the others."""
        numbers = {name: numbers.get(name, value) for name, value in self.present.items()}
        return {"law": "lqr"} | {letter: [x for name, x in numbers.items() if name[0] == letter] for letter in LETTERS}

    def varied(self, numbers: Mapping[str, float]) -> Plant:
        """The plant with their gains. Raises ConfigError where the Riccati equation has no solution."""
        table = self.table(numbers)
        K = riccati(*self.design.linearised, np.diag(table["Q"]), np.diag(table["R"]))[1]
        names = list(self.law.parameters)[-K.size :]
        return plants.varied(self.law, tuple(zip(names, rounded(K).ravel().tolist(), strict=True)))


def varied(plant: Plant, numbers: Mapping[str, float]) -> Plant:
    """The plant with those of the numbers that are its parameters, or weights of its law."""
    if any(name[:2] in ("Q.", "R.") for name in numbers) and (weights := LqrWeights.of(plant)):
        plant = weights.varied(numbers)
    return plants.varied(plant, tuple((k, value) for k, value in numbers.items() if k not in LAW and "." not in k))


def gains(plant: Plant) -> list[str]:
    """The parameters that kappa reads, and neither f nor the delay, the reference or the limits: a user's choice.

    Raises ConfigError for a plant whose formulas cannot be read.
    """
    if not plant.traced:
        raise ConfigError(f"plant {plant.name}: free expected a traced plant, got traced = False; leave free out")
    trace = Trace(plant)
    x, u, t = trace.symbols()
    kappa, fixed = [*trace.kappa(x, t)], [*trace.f(x, u, t), *([trace.delay(x, t)] if plant.declares_delay else [])]
    fixed += [*(trace.reference(t) if plant.tracks else []), *(trace.safe(x, t) if plant.declares_safe else [])]
    names = []
    for name, symbol in zip(plant.parameters, trace.parameters, strict=True):
        if name not in LAW and programs.depends(kappa, [symbol]) and not programs.depends(fixed, [symbol]):
            names.append(name)
    return names
