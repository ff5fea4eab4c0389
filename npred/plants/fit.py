"""Whether a pipeline fits its plant: told before the first stage runs, not after an hour of training."""

from collections.abc import Collection

import numpy as np

from npred.config import Pipeline
from npred.errors import ConfigError
from npred.plants.base import Plant
from npred.plants.declaration import span


def check(plant: Plant, config: Pipeline, stages: Collection[str]) -> None:
    """Raise ConfigError, in one line, where those stages ask for what the plant does not have."""
    _box(plant, config)
    _bounds(plant, config)
    if not plant.autonomous:
        raise ConfigError(f"plant {plant.name}: expected f without time, for a network knows X, u, D_hat; simulate it")
    if plant.rests:
        _ = plant.equilibrium  # every loop wants it, and it says so where it finds none
    if "evaluate" not in stages:
        return
    if not plant.rests:
        raise ConfigError(
            f"evaluate: expected a plant with an equilibrium, {plant.name} has none; its loops have no radius"
        )
    if len(config.evaluate.X0) != plant.n:
        wanted, given = ", ".join(plant.states), config.evaluate.X0
        raise ConfigError(f"evaluate.X0: expected {plant.n} values ({wanted}), got {given}; give one a state")
    if not np.isfinite(config.evaluate.X0).all():
        raise ConfigError(f"evaluate.X0: expected finite values, got {config.evaluate.X0}; mend it")


def _box(plant: Plant, config: Pipeline) -> None:
    for name in config.generate.box:
        if name not in plant.states:
            raise ConfigError(f"generate.box: unknown state {name!r}; expected one of {', '.join(plant.states)}")
    for name, ends in config.generate.box.items():
        if not np.isfinite(span(f"generate.box.{name}", ends)).all():
            raise ConfigError(f"generate.box.{name}: expected finite ends, got {list(ends)}; mend it")
    for name in plant.states:
        if name not in plant.box | config.generate.box:
            raise ConfigError(f"generate.box: expected a range for {name!r}, found none; add {name} = [low, high]")


def _bounds(plant: Plant, config: Pipeline) -> None:
    for name, table in (("generate", config.generate), ("evaluate", config.evaluate)):
        given = table.input_bounds or []
        if table.input_bounds is not None and len(given) != plant.m:
            raise ConfigError(
                f"{name}.input_bounds: expected {plant.m} pairs [low, high], one an input, got {len(given)}; mend it"
            )
        for k, pair in enumerate(given):
            span(f"{name}.input_bounds[{k}]", pair)
