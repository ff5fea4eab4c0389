"""Time a call of each predictor, and put its error beside it."""

from typing import Any

from npred.base import registry
from npred.lab.scheduler.declaration import Slices, Stage

STAGE = Stage(__name__, version=13, upstream=("generate", "train"), result_class="npred.lab.config.results:Benched")


def key(slices: Slices) -> dict[str, Any]:
    """The table, the predictors that are timed, and the machine."""
    from npred.base import devices
    from npred.lab.scheduler.configuration import table

    bench = slices.config.bench
    section = table(bench) | {
        "runtimes": [*map(registry.RUNTIMES.identity, bench.runtimes)],
        "baselines": [*map(registry.BASELINES.identity, bench.baselines)],
    }
    methods = [*map(registry.METHODS.identity, slices.config.methods)]
    timed = {"bench": section, "methods": methods, "hardware": devices.hardware(slices.device)}
    return timed | slices.mechanics | slices.networks | slices.box
