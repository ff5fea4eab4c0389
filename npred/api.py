"""The public functions of Python and notebooks: plants, predictors, trained models and the controller, by name."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from npred import plants, progress
from npred.errors import ConfigError
from npred.parallel import devices
from npred.plants import Plant
from npred.plants.base import require
from npred.predictors import Predictor, numerical

if TYPE_CHECKING:
    from npred.pipeline.models import Stored


def plant(name: str | type, *, kappa: plants.Kappa = "", **parameters: float) -> Plant:
    """The plant of a built-in name, of a file or of a class, with parameters overridden.

    Raises ConfigError for a name, a file or a law that is not there, and for a class that declares no plant.
    """
    return plants.resolve(name, parameters, kappa)


def predictor(method: str, plant: Plant, nx: int = 101) -> Predictor:
    """The numerical predictor of a plant, on nx nodes in a loop [DAPF, eq. 10].

    Raises ConfigError for an unknown or broken method, for fewer than two nodes, or for what is no plant.
    """
    require(plant)
    return numerical(method, plant, nx)


def load(
    model: str, *, store: str | Path | None = None, nx: int = 101, device: str = "cpu", runtime: str | None = None
) -> Predictor:
    """A trained model as a predictor.

    The compiled function is made at its first use in a loop or controller and kept on the disk. On a GPU, and for a
    network of yours, torch does all. Files are verified against their digests. The plant is the pipeline's, or, for an
    artifact, the built-in one of that name: a plant's file is code and is run only when a pipeline names it.

    Raises ConfigError for a model or a runtime that is not there; StoreError for corrupt results; MissingError for a
    device or an extra that this machine lacks.
    """
    from npred.pipeline.models import load_model

    if not isinstance(model, str | Path):
        raise ConfigError(f"model: expected PIPELINE:MODEL, a path or a key, got {model!r}; write smoke:deeponet, say")
    device = devices.resolve(device)
    devices.require(device)
    return loaded(load_model(str(model), Path(store) if store else None), nx, device, runtime)


def loaded(stored: "Stored", nx: int, device: str, runtime: str | None) -> Predictor:
    """A trained model of the store as a predictor; see `load`."""
    with progress.announce(f"loading network {stored.model}", often="once per process"):
        from npred import operators, runtimes

        precision = np.float64 if runtime in (None, "torch") else np.float32
        operator = operators.read(stored.folder, stored.plant, stored.snapshot, precision, stored.config)
        return runtimes.predictor(runtime, stored.plant, operator, nx, stored.model, device)


def guarded(
    model: Predictor, tolerance: float = 0.01, by: str = "auto", *, exact: Predictor | None = None
) -> Predictor:  # fmt: skip
    """`model`, checked in every call: `exact` answers where |kappa(P̂(1)) - kappa(P(1))| is estimated to be above
    `tolerance`; see npred.predictors.guarded.

    A pass is an estimate, not a bound: docs/guard.md says what an adversary finds.

    Raises ConfigError for a tolerance that is not above 0, and for a model on fewer than five nodes.
    """
    from npred.predictors.guarded import Guarded

    return Guarded(model, tolerance, by, exact=exact)
