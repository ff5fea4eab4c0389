"""Closed loops under stated conditions, of every stage alike: starts, delays, sensors, parameters and disturbances."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from npred import plants
from npred.base import randomness
from npred.base.errors import ConfigError
from npred.base.registry import DELAY_LAWS, FROZEN, OBSERVERS
from npred.estimation import delay_law
from npred.estimation.delay_law import DelayLaw
from npred.estimation.observers import Observer
from npred.lab.config.evaluate import Evaluate, Scenario
from npred.lab.config.loop import LoopTable
from npred.lab.config.pipeline import Generate, Pipeline
from npred.lab.config.results import PredictorId
from npred.loop import closed_loop, settable, simulation
from npred.loop.closed_loop import Trajectories
from npred.loop.loop import Loop
from npred.loop.measurement import Estimate, Measurement
from npred.loop.timing import Timing
from npred.plants.base import Plant
from npred.prediction.methods import Predictor

EVERY = 10  # control steps between two kept states, where nothing asks for more


@dataclass(frozen=True)
class Condition:
    """Loops of a table from X0 (B, n) over t_end, of delay D from the estimate D_hat.

    D and D_hat are a number or (B,), D also a function of t; they mean nothing where the plant declares its delay.
    `seed` is that of the sensors' noise, `first` the number of the first loop, where they are part of a larger batch;
    without `adapts` the estimate is held. What no table can say: a `disturbance` that is any function of t, instead of
    the table's, and an `observer` of the sensors (npred.Measurement).
    """

    table: LoopTable
    X0: Any
    D: Any
    D_hat: Any
    t_end: float
    seed: int
    first: int = 0
    adapts: bool = True
    disturbance: Callable[[float], Any] | None = None
    observer: Estimate | None = None

    @property
    def steps(self) -> int:
        """The control steps of all loops together, those at t = 0 included."""
        return len(self.X0) * (round(self.t_end / self.table.dt) + 1)

    def part(self, rows: slice) -> Self:
        """Some of the loops, with the noise that they have among all."""
        X0, D, D_hat = (a[rows] for a in (self.X0, self.D, self.D_hat))
        whole = self.disturbance

        def some(t: float) -> Any:
            value = np.asarray(whole and whole(t))
            return value[rows] if value.ndim > 1 else value  # where it differs from loop to loop

        disturbance = some if whole else None
        return replace(self, X0=X0, D=D, D_hat=D_hat, first=self.first + rows.start, disturbance=disturbance)

    def loops(self, plant: Plant, predictor: Predictor, **recorded: Any) -> Trajectories:
        """The loops with this predictor; `recorded` are `every`, `samples` and `progress` of npred.simulate."""
        return closed_loop.run(self.loop(plant, predictor), self.t_end, **recorded)

    def loop(self, plant: Plant, predictor: Predictor) -> Loop:
        """Their description. Raises ConfigError for a part that does not fit, or cannot act."""
        table, noise = self.table, {"seed": self.seed, "first": self.first, "observer": self.observer}
        push = table.disturbance

        def sine(t: float) -> float:
            return push.amplitude * math.sin(push.omega * t)

        return described(
            table, plant, predictor, self.adapts, X0=self.X0, u0=table.u0, integrator=table.integrator,
            disturbance=self.disturbance or (sine if push.amplitude else None),
            measurement=Measurement(**vars(table.measurement), **noise),
            timing=table.timing and Timing(**vars(table.timing), seed=self.seed), truth=truth(plant, table),
            setpoints=setpoints(table),
            **({} if plant.declares_delay else {"D": self.D, "D_hat": self.D_hat}),
        )  # fmt: skip


def compiled(plant: Plant, predictor: Predictor, table: LoopTable) -> bool:
    """True if loops of this table that adapt are kernels throughout: no table names an observer in Python."""
    law = delay_law.part(plant, adaptation(table, plant), table.dt)
    return simulation.compiled(plant, predictor, law)


def adaptation(loop: LoopTable, plant: Plant) -> DelayLaw | None:
    """The law of a stage's loops, made with their gamma, b and bounds, gamma suited to the plant where it is left out;
    None for frozen, for a plant that declares its delay, and for data that are not simulated.

    Raises ConfigError, in one line, for a name, file or class that is missing, broken or no law.
    """
    if plant.declares_delay or loop.adaptation == FROZEN or not loop.simulated:
        return None
    kind = DELAY_LAWS.subclass("adaptation", loop.adaptation, DelayLaw)
    try:
        gain = {} if loop.gamma is None else {"gamma": loop.gamma}
        law = kind(**gain, b=loop.b, bounds=loop.bounds)
    except TypeError as error:
        what = f"adaptation {loop.adaptation}: expected a law that takes gamma, b and bounds"
        raise ConfigError(f"{what}, got: {error}; take them") from None
    law.check(plant)
    return law.suited(plant, loop.longest, loop.longest)


def described(table: LoopTable, plant: Plant, predictor: Predictor, adapts: bool = True, **more: Any) -> Loop:
    """The controller of a table, and `more` of the loop. Raises ConfigError for a part that does not fit, or cannot
    act.
    """
    return Loop(**{
        "plant": plant, "predictor": predictor, "dt": table.dt, "input_bounds": table.input_bounds,
        "adaptation": adaptation(table, plant) if adapts else None, "actuator": table.actuator,
        "observer": observer(table, plant), "watchdog": table.watchdog, "safety": table.safety,
        "outlier_limit": table.outlier_limit, "max_sample_age": table.max_sample_age,
    } | more)  # fmt: skip


def observer(table: LoopTable, plant: Plant) -> Observer | None:
    """The observer of the state that a table asks for. Raises ConfigError for one that does not fit."""
    if table.observer is None:
        return None
    kind = OBSERVERS.subclass("observer", table.observer.kind, Observer)
    return kind(plant, outputs=table.observer.outputs, offset=table.observer.offset)


def setpoints(table: LoopTable) -> dict[str, Any]:
    """The set-points of a table as npred.simulate takes them."""
    return {name: (course.at, course.to) for name, course in table.setpoints.items()}


def targets(plant: Plant, table: LoopTable, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """X* and U* of a table's loops at times t (T,), (n,) and (m,), or (T, n) and (T, m) where they move."""
    if not table.setpoints:
        return plant.target(t), plant.u_target(t)
    return settable.targets(plant, settable.course(plant, setpoints(table)), t)


def truth(plant: Plant, table: LoopTable) -> Plant | None:
    """The plant with the parameters of `truth`, times `truth_scale`; None where it is the same. Raises ConfigError for
    an unknown one.
    """
    named = table.truth
    if (scale := table.truth_scale) != 1.0:
        named = {name: scale * value for name, value in (plant.parameters | named).items()}
    return plants.varied(plant, tuple(named.items())) if named else None


@dataclass(frozen=True)
class Starts:
    """The loops of an evaluation: first that of Fig. 1, then the cases, then the map D x D_hat(0)."""

    X0: np.ndarray  # (B, n)
    D: np.ndarray  # (B,)
    D_hat: np.ndarray  # (B,)
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
    """Fig. 1's start, random states of the plant's box x case_D_hat at delay D, Fig. 1's state over the map.

    Of a plant that declares its delay the random states alone: D and D_hat(0) mean nothing there.
    """
    config, ranges = pipeline.evaluate, box(plant, pipeline.generate)
    rng = randomness.generator(pipeline.seed, "evaluate", "cases")
    states = rng.uniform(ranges[:, 0], ranges[:, 1], (config.case_states, plant.n))
    D, D_hat = np.meshgrid(config.map_D, config.map_D_hat, indexing="ij")
    estimates = config.case_D_hat[: 1 if plant.declares_delay else None]
    cases, cells = config.case_states * len(estimates), D.size
    return Starts(
        np.concatenate([[config.X0], np.repeat(states, len(estimates), 0), np.tile(config.X0, (cells, 1))]),
        np.concatenate([np.full(1 + cases, config.D), D.ravel()]),
        np.concatenate([[config.D_hat], np.tile(estimates, config.case_states), D_hat.ravel()]),
        slice(1, 1 + cases),
        slice(1 + cases, 1 + cases + cells),
        len(estimates),
    )


def under(plant: Plant, pipeline: Pipeline, scenario: Scenario) -> Condition:
    """The cases of [evaluate] under the scenario."""
    table = pipeline.evaluate.under(scenario)
    begin = starts(pipeline.model_copy(update={"evaluate": table}), plant)
    seed = randomness.integer(pipeline.seed, "scenarios")
    X0, D_hat = begin.X0[begin.cases], begin.D_hat[begin.cases]
    return Condition(table, X0, true_delay(table, scenario), D_hat, table.case_t_end, seed)


def true_delay(config: Evaluate, scenario: Scenario) -> Callable[[float], float] | float:
    """The true delay: D, or a function of t."""
    D, drift, jump = config.D, scenario.drift, scenario.jump
    if drift:
        return lambda t: D + drift.amplitude * math.sin(2 * math.pi * t / drift.period)
    if jump:
        return lambda t: D if t < jump.at else jump.to
    return D
