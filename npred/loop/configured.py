"""The loops of a pipeline's stages: simulate, with what a table of the pipeline file says."""

import math
from collections.abc import Callable
from typing import Any

from npred import plants
from npred.config import Disturbance, Loop
from npred.loop import closed_loop, delay_law
from npred.loop.closed_loop import Trajectories, simulate
from npred.loop.measurement import Measurement
from npred.plants.base import Plant
from npred.predictors import Predictor


def loops(
    plant: Plant, predictor: Predictor, table: Loop, *, D: Any, D_hat: Any, seed: int, first: int = 0,
    adapts: bool = True, **arguments: Any,
) -> Trajectories:  # fmt: skip
    """Loops of delay D from the estimate D_hat, both left out where the plant declares its delay.

    `seed` is that of the sensors' noise, `first` the number of the batch's first loop, where it is a part of a larger
    batch; without `adapts` the estimate is held. Other arguments are those of npred.simulate.
    """
    delays = {} if plant.declares_delay else {"D": D, "D_hat": D_hat}
    return simulate(
        plant, predictor, dt=table.dt, input_bounds=table.input_bounds, u0=table.u0, actuator=table.actuator,
        adaptation=delay_law.resolve(table, plant) if adapts else None, truth=truth(plant, table),
        measurement=Measurement(**dict(table.measurement), seed=seed, first=first),
        disturbance=_push(table.disturbance), **delays, **arguments,
    )  # fmt: skip


def compiled(plant: Plant, predictor: Predictor, table: Loop) -> bool:
    """True if `loops` of this table, where they adapt, are kernels throughout: no table names an observer in Python."""
    law = delay_law.part(plant, delay_law.resolve(table, plant), table.dt)
    return closed_loop.compiled(plant, predictor, law)


def truth(plant: Plant, table: Loop) -> Plant | None:
    """The plant with the parameters of `truth`; None where there are none. Raises ConfigError for an unknown one."""
    return plants.varied(plant, tuple(table.truth.items())) if table.truth else None


def _push(disturbance: Disturbance) -> Callable[[float], float] | None:
    if not disturbance.amplitude:
        return None
    return lambda t: disturbance.amplitude * math.sin(disturbance.omega * t)
