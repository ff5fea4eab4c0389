"""A condition of closed loops: what a table of the pipeline file says, from which states, with which delay."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from npred import plants
from npred.base.errors import ConfigError
from npred.base.registry import DELAY_LAWS, OBSERVERS
from npred.estimation import delay_law
from npred.estimation.delay_law import DelayLaw
from npred.estimation.observers import Observer as StateObserver
from npred.lab.config import FROZEN, Disturbance
from npred.lab.config import Loop as LoopTable
from npred.loop import closed_loop, simulation
from npred.loop.closed_loop import Trajectories
from npred.loop.loop import Loop
from npred.loop.measurement import Measurement, Observer
from npred.loop.timing import Timing
from npred.plants.base import Plant
from npred.prediction.methods import Predictor

EVERY = 10  # control steps between two kept states, where nothing asks for more


@dataclass(frozen=True)
class Condition:
    """Loops of a table from X0 (B, n) over t_end seconds, of delay D from the estimate D_hat.

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
    observer: Observer | None = None

    @property
    def steps(self) -> int:
        """The control steps of all loops together, those at t = 0 included."""
        return len(self.X0) * (round(self.t_end / self.table.dt) + 1)

    def part(self, rows: slice) -> Self:
        """Some of the loops, with the noise that they have among all."""
        X0, D, D_hat = (a[rows] for a in (self.X0, self.D, self.D_hat))
        disturbance = self.disturbance and _of_rows(self.disturbance, rows)
        return replace(self, X0=X0, D=D, D_hat=D_hat, first=self.first + rows.start, disturbance=disturbance)

    def loops(self, plant: Plant, predictor: Predictor, **recorded: Any) -> Trajectories:
        """The loops with this predictor; `recorded` are `every`, `samples` and `progress` of npred.simulate."""
        table, noise = self.table, {"seed": self.seed, "first": self.first, "observer": self.observer}
        loop = replace(
            described(table, plant, predictor), X0=self.X0, disturbance=self.disturbance or _push(table.disturbance),
            measurement=Measurement(**vars(table.measurement), **noise),
            timing=table.timing and Timing(**vars(table.timing), seed=self.seed), truth=truth(plant, table),
            **({} if plant.declares_delay else {"D": self.D, "D_hat": self.D_hat}),
        )  # fmt: skip
        return closed_loop.run(loop if self.adapts else replace(loop, adaptation=None), self.t_end, **recorded)


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


def described(table: LoopTable, plant: Plant, predictor: Predictor) -> Loop:
    """The controller of a table, with u0 as it stands. Raises ConfigError for a part that does not fit."""
    return Loop(
        plant=plant, predictor=predictor, dt=table.dt, adaptation=adaptation(table, plant), u0=table.u0,
        input_bounds=table.input_bounds, actuator=table.actuator, observer=observer(table, plant), safety=table.safety,
    )  # fmt: skip


def observer(table: LoopTable, plant: Plant) -> StateObserver | None:
    """The observer of the state that a table asks for. Raises ConfigError for one that does not fit."""
    if table.observer is None:
        return None
    kind = OBSERVERS.subclass("observer", table.observer.kind, StateObserver)
    return kind(plant, outputs=table.observer.outputs, offset=table.observer.offset)


def truth(plant: Plant, table: LoopTable) -> Plant | None:
    """The plant with the parameters of `truth`; None where there are none. Raises ConfigError for an unknown one."""
    return plants.varied(plant, tuple(table.truth.items())) if table.truth else None


def _of_rows(disturbance: Callable[[float], Any], rows: slice) -> Callable[[float], Any]:
    """The disturbance of some of the loops, where it differs from loop to loop."""

    def some(t: float) -> Any:
        value = np.asarray(disturbance(t))
        return value[rows] if value.ndim > 1 else value

    return some


def _push(disturbance: Disturbance) -> Callable[[float], float] | None:
    if not disturbance.amplitude:
        return None
    return lambda t: disturbance.amplitude * math.sin(disturbance.omega * t)
