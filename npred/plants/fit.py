"""Whether a pipeline fits its plant: told before the first stage runs, not after an hour of training."""

from collections.abc import Collection

from npred.config import Pipeline
from npred.errors import ConfigError
from npred.plants.base import Plant


def check(plant: Plant, config: Pipeline, stages: Collection[str]) -> None:
    """Raise ConfigError, in one line, where those stages ask for what the plant does not have."""
    _box(plant, config)
    _bounds(plant, config)
    if "evaluate" not in stages:
        return
    if not plant.rests:
        raise ConfigError(
            f"evaluate: expected a plant with an equilibrium, {plant.name} has none; its loops have no radius"
        )
    if len(config.evaluate.X0) != plant.n:
        wanted, given = ", ".join(plant.states), config.evaluate.X0
        raise ConfigError(f"evaluate.X0: expected {plant.n} values ({wanted}), got {given}; give one a state")


def _box(plant: Plant, config: Pipeline) -> None:
    for name in config.generate.box:
        if name not in plant.states:
            raise ConfigError(f"generate.box: unknown state {name!r}; expected one of {', '.join(plant.states)}")
    for name in plant.states:
        if name not in plant.box | config.generate.box:
            raise ConfigError(f"generate.box: expected a range for {name!r}, found none; add {name} = [low, high]")


def _bounds(plant: Plant, config: Pipeline) -> None:
    for table in (config.generate, config.evaluate):
        if table.input_bounds is not None and len(table.input_bounds) != plant.m:
            given = len(table.input_bounds)
            raise ConfigError(f"input_bounds: expected {plant.m} pairs [low, high], one an input, got {given}")
