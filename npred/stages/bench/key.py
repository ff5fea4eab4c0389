"""What the key of a benchmark holds."""

from typing import Any

from npred import registry
from npred.config import Pipeline
from npred.parallel import devices
from npred.stages.configuration import box, networks, plant, table


def configuration(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    """The table, the predictors that are timed, and the machine."""
    section = table(config.bench) | {"runtimes": [*map(registry.RUNTIMES.identity, config.bench.runtimes)]}
    if config.bench.baselines:
        section["baselines"] = [*map(registry.BASELINES.identity, config.bench.baselines)]
    methods = [*map(registry.METHODS.identity, config.methods)]
    timed = {"bench": section, "methods": methods} | plant(config).mechanics_program
    return timed | networks(config) | {"hardware": devices.hardware(device)} | box(config)
