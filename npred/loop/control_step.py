"""The control step dt: its default, what it may be, and when it is long for the law or for the estimate of a delay.

U is held over dt. What that costs the loop is a matter of the law's pace (npred.loop.hold), and what the estimate of a
delay needs is some steps in the delay. The default was chosen by `python benchmarks/discretisation.py default`: five
plants, each with a tenth, a third and all of a usual delay, loops with D known against the same with dt / 8, and D_hat
at the end of loops with DelayObserver from 2 D.

                                    D / 300            default            D / 20
    largest difference of a state   0.00 to 0.18 %     0.01 to 0.72 %     0.05 to 2.3 %
    |D_hat / D - 1|                 6e-6 to 1e-3       6e-7 to 4e-4       4e-6 to 4e-4
    time, ms (a shared core)        45 to 1400         18 to 430          7 to 91

So many steps as D / 300 are not worth their time, for that estimate either. With D / 10 it errs by 1 % at most, with
D / 5, D / 3 and D / 2 by up to 2, 8 and 20 % where the loop itself stands. A law that integrates a rate of D_hat keeps
D / 300: L1Adaptation settles the chemostat, D = 1.6, with dt = 0.01 and 0.005, and with 0.02 it does not.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from npred.base.errors import ConfigError
from npred.loop import hold
from npred.plants.base import Plant
from npred.plants.speed import rates

MANY = 300.0  # control steps in a delay where no plant is known, or a rate of D_hat is integrated, before dt is rounded
PER_DELAY = 80.0  # else
LOSS = 0.01  # what the law may lose by the default
PER_RATE = 0.05  # dt times the fastest rate: the plant is integrated by a step of RK4 per dt
LONG = 0.1  # a law that loses more than this is said to
CURED = 0.02  # what it loses with the step that is advised
FEW = 10  # control steps in a delay that is estimated, below which the estimate suffers


def _shortest(D: ArrayLike) -> float:
    """The shortest delay above 0; infinity for none."""
    delays = np.ravel(np.asarray(D, dtype=float))
    return float(delays[delays > 0].min(initial=np.inf))


def simple(number: float) -> float:
    """The nearest of 1, 2 and 5 times a power of ten, by ratio."""
    power = 10.0 ** math.floor(math.log10(number))
    nearest = min((1, 2, 5, 10), key=lambda k: abs(math.log(number / (k * power))))
    return float(f"{nearest * power:.0e}")


def usual(D: ArrayLike, plant: Plant | None = None, integrates: bool = False) -> float:
    """The control step where none is given, or infinity where neither a delay nor a rate says it.

    Of a plant: 1 / 80 of the shortest delay above 0, at most 0.05 / its fastest rate, and such that the law loses 1 %
    at most. Without one, as while a pipeline is read, and where a delay law integrates a rate of D_hat, 1 / 300 of that
    delay. To the nearest of 1, 2 and 5 times a power of ten, so that it has one digit: with a delay of 1 it is 0.01 for
    `scalar`, 0.005 for the paper's plant and in a pipeline.
    """
    limit = _shortest(D) / (MANY if integrates or plant is None else PER_DELAY)
    if plant is not None:
        paces = (PER_RATE, rates(plant).fastest), (LOSS, hold.per_time(plant))
        limit = min(limit, *(most / per for most, per in paces if per > 0))
    return simple(limit) if limit < np.inf else limit


def check(name: str, dt: float, D: ArrayLike) -> None:
    """Raise ConfigError for a control step longer than a delay above 0 that is estimated: u is one command then."""
    if dt > (shortest := _shortest(D)):
        what = f"expected at most the delay, {shortest:g}, because no law can estimate it from longer commands"
        raise ConfigError(f"{name}: {what}, got {dt:g}; shorten the step, or freeze the estimate")


def doubt(name: str, dt: float, D: ArrayLike, plant: Plant, estimated: bool) -> str:
    """The sentence about a control step that is long for the law, or for a delay that is estimated; else none."""
    texts, shortest = [], _shortest(D)
    if (lost := hold.loss(plant, dt)) > LONG:
        ends = "states near rest do not settle"
        if lost < np.inf:
            ends = f"states near rest differ by {lost:.0%} from those of kappa in continuous time"
        shorter = f"take {simple(CURED / per):g} or less" if (per := hold.per_time(plant)) > 0 else "take a shorter one"
        texts.append(f"with U held so long, {ends}; {shorter}, unless kappa is designed for held commands")
    if estimated and shortest < FEW * dt * (1 - 1e-9):
        what = f"a delay of {shortest / dt:.3g} control steps is estimated to some percent only"
        texts.append(f"{what}; take D / {FEW} or less, {shortest / FEW:.3g}")
    return f"{name}: {plant.time_text(dt)}: {'; '.join(texts)}" if texts else ""
