"""Plants, predictors and trained models by name: what a script or notebook starts from."""

from pathlib import Path

from npred import plants
from npred.errors import ConfigError
from npred.plants import Plant
from npred.predictors import METHODS, Compiled
from npred.predictors.neural import Neural


def plant(name: str, **parameters: float) -> Plant:
    """The plant of a built-in name or of `my_plant.py:Tank`, with parameters overridden; see npred.plants.resolve."""
    return plants.resolve(name, parameters)


def predictor(method: str, plant: Plant, nx: int = 101) -> Compiled:
    """The numerical predictor `euler`, `heun`, `rk4` or `picard` of a plant, nx nodes in a loop [DAPF, eq. 10].

    Raises ConfigError for an unknown method, for fewer than two nodes, or for what is no plant.
    """
    if not isinstance(plant, Plant):
        raise ConfigError(f"plant: expected a Plant, got {plant!r}; make one with npred.plant")
    if method not in tuple(METHODS):
        raise ConfigError(f"predictor: expected one of {', '.join(METHODS)}, got {method!r}")
    return METHODS[method](plant, nx)


def load(model: str, *, store: str | Path | None = None, nx: int = 101, device: str = "cpu") -> Neural:
    """A trained model as a predictor: `pipeline/paper.toml:deeponet`, `…:deeponet@107`, or an artifact's path or key.

    Files are verified against their digests. The plant is the pipeline's, or, for an artifact, the built-in one of that
    name: a plant's file is code and is run only when a pipeline names it. Raises ConfigError, StoreError, and
    MissingError for a device that this machine lacks.
    """
    from npred import devices, operators
    from npred.pipeline.models import load_model

    device = devices.resolve(device)
    devices.require(device)
    stored = load_model(str(model), Path(store) if store else None)
    operator = operators.load(stored.folder, stored.plant, stored.snapshot)
    return Neural(stored.plant, operator, nx, device, stored.model)
