"""The inputs of a plant: the range of each, and what they are before t = 0."""

from typing import Any

import numpy as np

from npred import array_checks
from npred.config import Loop
from npred.errors import ConfigError
from npred.plants.base import Plant
from npred.symbolic import source_lines

EQUILIBRIUM, LAW = "equilibrium", "law"  # the inputs before t = 0 that have a name
ROUNDING = 1e-9  # of an input: this close to a bound it is on it


def bounds(plant: Plant, bounds: Any) -> np.ndarray:
    """The range of each input, (m, 2): those given, else the plant's, else none. One input's pair may stand alone."""
    pairs = plant.input_bounds if bounds is None else bounds
    if pairs is None:
        pairs = [(-np.inf, np.inf)] * plant.m
    array = array_checks.floats("input_bounds", pairs)
    array = array[None] if array.shape == (2,) else array
    if array.shape != (plant.m, 2) or not (array[:, 0] <= array[:, 1]).all():
        raise ConfigError(f"input_bounds: expected {plant.m} pairs (low, high), got {pairs}; give one pair per input")
    return array


def start(plant: Plant, u0: Any, limits: np.ndarray) -> np.ndarray | str:
    """u0, the input before t = 0, with its default filled in: numbers (m,), "equilibrium" or "law".

    By default the input is 0 where the limits (m, 2) allow 0 for every input, else that of the equilibrium.
    Raises ConfigError for other words, a wrong count, values that are not finite or that lie outside the limits.
    """
    if u0 is None:
        u0 = np.zeros(plant.m) if _inside(np.zeros(plant.m), limits) else EQUILIBRIUM
    if isinstance(u0, str):
        if u0 not in (EQUILIBRIUM, LAW):
            raise ConfigError(f'u0: expected numbers, "{EQUILIBRIUM}" or "{LAW}", got {u0!r}; choose one')
        return u0
    array = array_checks.floats("u0", u0)
    if not array_checks.fits(array.shape, (plant.m,)) or not np.isfinite(array).all():
        raise ConfigError(f"u0: expected a finite number per input ({', '.join(plant.inputs)}), got {u0}; give as many")
    return _accepted(plant, np.broadcast_to(array, (plant.m,)), limits, "")


def configured(plant: Plant, loop: Loop, stage: str) -> np.ndarray | str:
    """The `start` of a stage's loops. Raises ConfigError, naming the stage's table, also where nothing rests."""
    try:
        limits = bounds(plant, loop.input_bounds)
        commands = start(plant, loop.u0, limits)
        if isinstance(commands, str) and commands == EQUILIBRIUM:
            _at_rest(plant, limits)
    except ConfigError as error:
        raise ConfigError(f"{stage}.{error}") from None
    return commands


def before(plant: Plant, u0: Any, limits: np.ndarray, X0: np.ndarray) -> np.ndarray:
    """The input of each loop before t = 0, (B, m), for starts X0 (B, n) and limits (m, 2); it fills the delay.

    It is constant: the numbers of u0; kappa(X*), or kappa of the reference at t = 0, for "equilibrium"; for "law"
    kappa(X0, 0) within the limits, as if the controller had been on with the plant held at X0.
    Raises ConfigError as `start` does, and where there is no equilibrium.
    """
    value = start(plant, u0, limits)
    if isinstance(value, str):
        value = _at_rest(plant, limits) if value == EQUILIBRIUM else _of_law(plant, limits, X0)
    return np.array(np.broadcast_to(value, (len(X0), plant.m)))


def sentence(plant: Plant, u0: Any, limits: np.ndarray) -> str:
    """u0 in words: q = 0, or q = 0.5 of the equilibrium, or kappa(X0, 0)."""
    value = start(plant, u0, limits)
    if isinstance(value, str):
        return (
            "kappa(X0, 0)"
            if value == LAW
            else f"{source_lines.values(plant.inputs, _at_rest(plant, limits))} of the equilibrium"
        )
    return source_lines.values(plant.inputs, value)


def _of_law(plant: Plant, limits: np.ndarray, X0: np.ndarray) -> np.ndarray:
    with np.errstate(all="ignore"):  # a loop that starts where kappa is undefined is NaN from the start
        return np.clip(plant.kappa(X0, 0.0), *limits.T)


def _at_rest(plant: Plant, limits: np.ndarray) -> np.ndarray:
    """The input at the equilibrium, or at the reference at t = 0, (m,)."""
    try:
        u = plant.u_target(0.0)
    except ConfigError as error:
        raise ConfigError(f"u0: expected an equilibrium to take it from, got: {error}; or give u0 as numbers") from None
    return _accepted(plant, u, limits, "that of the equilibrium, ")


def _accepted(plant: Plant, u: np.ndarray, limits: np.ndarray, which: str) -> np.ndarray:
    """u (m,), rounding errors beyond the limits removed."""
    if not _inside(u, limits):
        values, pairs = source_lines.values(plant.inputs, u), limits.tolist()
        raise ConfigError(
            f"u0: expected within input_bounds {pairs}, got {which}{values}; give u0, the input at t < 0, within"
        )
    return np.clip(u, *limits.T)


def _inside(u: np.ndarray, limits: np.ndarray) -> bool:
    slack = ROUNDING * np.abs(u)
    return bool((u >= limits[:, 0] - slack).all() and (u <= limits[:, 1] + slack).all())
