"""How fast a plant's loop is: defaults that are times, or that have one in them, follow from it."""

from functools import cache
from typing import NamedTuple

import numpy as np

from npred.base.errors import ConfigError
from npred.plants.base import Plant

NONE = 1e-6  # share of the fastest rate, and of that of crossing the box: what rounding makes of a 0
DRAWN = 64  # states of the box
MOMENTS, STEP = 256, 1e-6  # times along a reference; the step of a difference, as a share of them
FAILURES = (ConfigError, ArithmeticError, ValueError)  # of functions that are called; LinAlgError is a ValueError
LONG = 100.0  # usual time constants


class Rates(NamedTuple):
    """Rates in 1 / time where the plant works at t = 0: `fastest`, the largest |eigenvalue| of f_X and of the loop of
    kappa without delay; `usual`, the geometric mean of those of that loop that are not 0; `slowest`, at which that loop
    settles, 0 or less where it does not.
    """

    fastest: float
    usual: float
    slowest: float


def operating_point(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    """X and U where the plant works at t = 0: its equilibrium, else its reference, else its guess."""
    if plant.rests or plant.tracks:
        return plant.target(0.0), plant.u_target(0.0)
    return plant.guess, plant.kappa(plant.guess)


@cache
def rates(plant: Plant) -> Rates:
    """The rates of a plant. Where no eigenvalue is left, all are that at which f of kappa crosses half the box; and 1,
    the one rate that is not the same in another unit of time, where nothing moves or a function fails.
    """
    crossing = _crossing(plant)
    try:
        with np.errstate(all="ignore"):
            X, u = operating_point(plant)
            f_X, f_U = plant.jacobians(X, u)
            values = np.linalg.eigvals([f_X + f_U @ plant.kappa_jacobian(X), f_X])
        sizes = np.abs(values)
        among = sizes[0][sizes[0] > NONE * max(sizes.max(), crossing)]
        if among.size:
            return Rates(float(sizes.max()), float(np.exp(np.log(among).mean())), float(-values[0].real.max()))
    except FAILURES:  # no law, no equilibrium, or no derivative there
        pass
    return Rates(*[crossing or 1.0] * 3)


def _crossing(plant: Plant) -> float:
    """The median of |f| with kappa over half the box, of what moves; 0 where it is not known."""
    if not plant.declares_kappa:
        return 0.0
    X, width = plant.drawn("rates", DRAWN), np.ptp(plant.ranges(), axis=1)
    try:
        with np.errstate(all="ignore"):
            speeds = np.abs(plant.f(X, plant.kappa(X))) / np.where(width > 0, width / 2, 1.0)
    except FAILURES:  # the check of the plant, or the loop, reports it
        return 0.0
    moving = speeds[np.isfinite(speeds) & (speeds > 0)]
    return float(np.median(moving)) if moving.size else 0.0


@cache
def of_reference(plant: Plant) -> float:
    """How fast the reference moves, the root of the mean of (r' / its standard deviation)² over states and time; 0 for
    a plant that rests, or a reference that does.
    """
    if not plant.tracks:
        return 0.0
    t, h = np.linspace(0.0, long(plant), MOMENTS, endpoint=False), STEP * long(plant)
    spread = plant.target(t).std(axis=0)
    moving = spread > NONE * np.abs(plant.target(t)).max(axis=0)
    speeds = (plant.target(t + h) - plant.target(t - h))[:, moving] / (2 * h * spread[moving])
    return float(np.sqrt((speeds**2).mean())) if moving.any() else 0.0


def settled(plant: Plant) -> float:
    """A time in which a loop has come to its target: LONG usual time constants."""
    return LONG / rates(plant).usual


def long(plant: Plant) -> float:
    """A time in which a law or a delay that depends on time does all that it does: the period, else `settled`."""
    return plant.period or settled(plant)
