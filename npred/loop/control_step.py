"""The control step dt beside the delay D: its default, what it may be, and when it is long.

U is held over dt, and acts dt / 2 later in the mean than a law in continuous time, so a loop is of first order in
dt / D. Of five plants, states of the loop with D known differ by 0.2 % of their largest distance from rest with
D = 300 dt, by 1 to 3 % with 20 dt, by 2 to 67 % with 5 dt, and with D = dt by 13 % or more, where loops diverge
(`python benchmarks/discretisation.py delay`).
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from npred.base.errors import ConfigError

PER_DELAY = 300.0  # control steps in a delay, before dt is rounded
PER_RATE = 0.05  # dt times the fastest rate
FEW = 20  # control steps in a delay, from which on a loop is that of a law in continuous time


def _shortest(D: ArrayLike) -> float:
    """The shortest delay above 0; infinity for none."""
    delays = np.ravel(np.asarray(D, dtype=float))
    return float(delays[delays > 0].min(initial=np.inf))


def simple(number: float) -> float:
    """The nearest of 1, 2 and 5 times a power of ten, by ratio."""
    power = 10.0 ** math.floor(math.log10(number))
    nearest = min((1, 2, 5, 10), key=lambda k: abs(math.log(number / (k * power))))
    return float(f"{nearest * power:.0e}")


def usual(D: ArrayLike, fastest: float = 0.0) -> float:
    """The control step where none is given, or infinity where neither a delay nor a rate says it.

    It is D / 300 of the shortest delay above 0, at most 0.05 / the fastest rate of the plant and its loop, to the
    nearest of 1, 2 and 5 times a power of ten, so that it has one digit: 0.005 for a delay of 1 or 2.
    """
    limit = min(_shortest(D) / PER_DELAY, PER_RATE / fastest if fastest > 0 else np.inf)
    return simple(limit) if limit < np.inf else limit


def check(name: str, dt: float, D: ArrayLike) -> None:
    """Raise ConfigError for a control step longer than a delay above 0 that is estimated: u is one command then."""
    if dt > (shortest := _shortest(D)):
        what = f"expected at most the delay, {shortest:g}, because no law can estimate it from longer commands"
        raise ConfigError(f"{name}: {what}, got {dt:g}; shorten the step, or freeze the estimate")


def doubt(name: str, dt: float, D: ArrayLike, unit: str) -> str:
    """The sentence about a control step that is long for a delay above 0 that is predicted over; else none."""
    shortest = _shortest(D)
    if shortest >= FEW * dt * (1 - 1e-9):
        return ""
    what = f"{name}: {dt:g} {unit}".rstrip() + f" is a step of D / {shortest / dt:.3g}"
    return f"{what}: the loop is not that of a law in continuous time; take D / {FEW} or less, {shortest / FEW:g}"
