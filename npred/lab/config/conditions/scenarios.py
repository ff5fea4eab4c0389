"""A scenario of the pipeline file as a condition: the cases with sensors, parameters or delays that are others."""

import math
from collections.abc import Callable

from npred.base import randomness
from npred.lab.config import Evaluate, Pipeline, Scenario
from npred.lab.config.conditions.condition import Condition
from npred.lab.config.conditions.starts import starts
from npred.plants import Plant


def condition(plant: Plant, pipeline: Pipeline, scenario: Scenario) -> Condition:
    """The cases of [evaluate] under the scenario."""
    table = pipeline.evaluate.under(scenario)
    if scale := scenario.parameters_scale:
        scaled = {name: scale * value for name, value in (plant.parameters | table.truth).items()}
        table = table.model_copy(update={"truth": scaled})
    begin = starts(pipeline.model_copy(update={"evaluate": table}), plant)
    seed = randomness.integer(pipeline.seed, "scenarios")
    X0, D_hat = begin.X0[begin.cases], begin.D_hat0[begin.cases]
    return Condition(table, X0, delay(table, scenario), D_hat, table.case_t_end, seed)


def delay(config: Evaluate, scenario: Scenario) -> Callable[[float], float] | float:
    """The true delay in seconds: D, or a function of t."""
    D, drift, jump = config.D, scenario.drift, scenario.jump
    if drift:
        return lambda t: D + drift.amplitude * math.sin(2 * math.pi * t / drift.period)
    if jump:
        return lambda t: D if t < jump.at else jump.to
    return D
