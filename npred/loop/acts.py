"""Where the parts of a loop act: what each field of npred.Loop may be, and what it needs.

A part that is given where it cannot act is refused, whichever way the loop is made.
"""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import is_dataclass
from typing import Any, NamedTuple

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError, unlisted
from npred.estimation.delay_law import DelayLaw
from npred.estimation.observers import Observer
from npred.loop.measurement import Measurement
from npred.loop.safety import SafetyFilter
from npred.loop.timing import Timing
from npred.loop.watchdog import Watchdog
from npred.plants import inputs
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods import OneStep, Predictor, method

MEASURED, HISTORY = "measured", "history"


KINDS = {  # by field: the kind of a part, in words, and the cure
    "plant": (Plant, "a Plant", "make one with npred.plant"),
    "predictor": (Predictor, "a Predictor", "make one with npred.predictor or npred.load"),
    "adaptation": (
        DelayLaw, "a DelayLaw",
        "make one, as npred.DelayObserver(bounds=(0.1, 4.0)), name one, or give None, which freezes D_hat",
    ),
    "measurement": (Measurement, "an npred.Measurement", "make one"),
    "safety": (SafetyFilter, "npred.SafetyFilter", "make one"),
    "observer": (Observer, "one of npred.observers", "make one"),
    "watchdog": (Watchdog, "npred.Watchdog", "make one"),
    "timing": (Timing, "an npred.Timing", "make one"),
    "truth": (Plant, "a plant", "make one with npred.plant"),
    "disturbance": (Callable, "a function of t", "write lambda t: [0.1]"),
    "setpoints": (Mapping, "{parameter: (times, values)}", 'write {"aim": ([0.0, 5.0], [1.0, 2.0])}, say'),
}  # fmt: skip
ABOVE, FROM = (lambda value: 0 < value < math.inf), (lambda value: 0 <= value < math.inf)
NUMBERS = {  # by field: the range of a number, in words, and the cure
    "dt": (ABOVE, "a control step above 0", "give a time in {unit}"),
    "outlier_limit": (ABOVE, "a number above 0, or None for no limit", "1 is the default"),
    "max_sample_age": (FROM, "how old a sample may be, at least 0", "give a time in {unit}"),
    "history_length": (ABOVE, "a time above 0", "leave it out for the largest D_hat"),
}


class Need(NamedTuple):
    """What a part needs to act: whether a loop has it; in words; what came in its place, and how to get it."""

    has: Callable[[Any], Any]
    words: str
    came: Callable[[Any], Any]
    cure: str = ""
    whole: bool = False  # whether it asks what a pipeline's table, which names no plant, does not have


COMMANDS = Need(lambda of: of.actuator == HISTORY, f'actuator="{HISTORY}"', lambda of: repr(of.actuator), "give it")
FEEDBACK = Need(lambda of: of.predictor is not None, "a predictor", lambda of: "None, the open loop", "give one")
SEEN = FEEDBACK._replace(has=lambda of: of.predictor is not None or of.measurement.observer is not None)
SIMULATED = Need(lambda of: not of.alone, "a simulated loop", lambda of: "a controller alone")
ALONE = Need(lambda of: of.alone, "a controller alone", lambda of: "a simulated loop", "take npred.controller")
UNDECLARED = Need(
    lambda of: not of.plant.declares_delay, "a plant that does not declare its delay", lambda of: of.plant.name,
    whole=True,
)  # fmt: skip
SERVED = UNDECLARED._replace(has=lambda of: of.alone or not of.plant.declares_delay)
ESTIMATED = UNDECLARED._replace(has=lambda of: not of.plant.declares_delay or of.blind, cure="give 0 for no prediction")
LATE = Need(
    lambda of: of.alone or of.measurement.delay or (of.measurement.period and of.on_a_clock)
    or (of.timing and of.timing.sample_latency),
    "samples that may come late", lambda of: "those of control steps, at once", "give the measurement a delay",
)  # fmt: skip
KEPT = COMMANDS._replace(has=lambda of: not of.alone or of.keeps_commands)
DELAYED = Need(
    lambda of: of.alone or of.plant.declares_delay or callable(of.D) or np.any(of.D)
    or (of.timing and of.timing.command_latency) or (of.actuator == HISTORY and np.any(of.D_hat)),
    "a delay", lambda of: "D = 0", "give D above 0", whole=True,
)  # fmt: skip
FILTERED = COMMANDS._replace(has=lambda of: of.actuator == HISTORY or not (of.alone or of.safety.delay))
LIMITED = Need(
    lambda of: of.plant.declares_safe, "a plant with safe(x, t, p, M), which is at least 0 where it is safe",
    lambda of: f"{of.plant.name} without", "write it", whole=True,
)  # fmt: skip
FORESEEN = Need(
    lambda of: of.safety.serves(of.plant), "a traced plant with one constant delay", lambda of: of.plant.name,
    "enforce its limits in kappa", whole=True,
)  # fmt: skip
COMPILED = Need(
    lambda of: of.measurement.observer is None or not of.on_a_clock, "no observer in Python on a clock",
    lambda of: "one", "give the loop an observer of npred.observers", whole=True,
)  # fmt: skip

NEEDS: dict[str, tuple[Need, ...]] = {  # by field; those without a need always act
    "plant": (), "predictor": (), "dt": (), "X0": (),
    "D": (SIMULATED, UNDECLARED),
    "D_hat": (ESTIMATED,),
    "adaptation": (FEEDBACK, UNDECLARED),
    "input_bounds": (FEEDBACK,),
    "u0": (KEPT, DELAYED),
    "observer": (FEEDBACK, SERVED, COMMANDS),
    "watchdog": (FEEDBACK, SERVED, COMMANDS),
    "safety": (FEEDBACK, FILTERED, LIMITED, FORESEEN),
    "outlier_limit": (FEEDBACK, COMMANDS),
    "max_sample_age": (FEEDBACK, COMMANDS, LATE),
    "history_length": (ALONE, KEPT),
    "measurement": (SIMULATED, SEEN, COMPILED),
    "truth": (SIMULATED,),
    "disturbance": (SIMULATED,),
    "setpoints": (SIMULATED, FEEDBACK),
    "timing": (SIMULATED, FEEDBACK, SERVED, COMMANDS),
    "integrator": (SIMULATED,),
    "actuator": (FEEDBACK,),
}  # fmt: skip


def refuse(of: Any, names: Collection[str], whole: bool = True) -> None:
    """Raise ConfigError where one of the parts that are given cannot act in a loop, or in a pipeline's table of one."""
    for name, needs in NEEDS.items():
        for need in needs if name in names else ():
            if (whole or not need.whole) and not need.has(of):
                cure = f"{need.cure}, or no {name}" if need.cure else f"leave {name} out"
                raise ConfigError(f"{name}: expected {need.words}, got {need.came(of)}; {cure}")


def check(loop: Any) -> None:
    """Raise ConfigError for a part of the wrong kind, out of range, made for another plant, or that cannot act."""
    plant, truth = loop.plant, loop.truth
    for name, (kind, expected, cure) in KINDS.items():
        value = getattr(loop, name)
        if not isinstance(value, kind) and (value is not None or name in ("plant", "measurement")):
            raise ConfigError(f"{name}: expected {expected}, got {value!r}; {cure}")
    for name, (fits, expected, cure) in NUMBERS.items():
        value = getattr(loop, name)
        if value is not None and not fits(array_checks.number(name, value)):
            raise ConfigError(f"{name}: expected {expected}, got {value!r}; {cure.format(unit=plant.time_unit)}")
    for name in ("D", "D_hat"):
        value = getattr(loop, name)
        if value is None and not (loop.alone or plant.declares_delay):
            raise ConfigError(f"{name}: expected a delay in {plant.time_unit}, got none; give {name}")
        if value is not None and not callable(value):
            array_checks.delays(name, array_checks.floats(name, value))
    if loop.actuator not in (MEASURED, HISTORY):
        raise ConfigError(unlisted("actuator", loop.actuator, (MEASURED, HISTORY)))
    names = loop.given
    refuse(loop, names)
    for name in names:  # and what it is made of: the law of a watchdog, say
        part = getattr(loop, name)
        inner = vars(part).items() if is_dataclass(part) else ()
        for label, each in ((name, part), *((f"{name}: {key}", value) for key, value in inner)):
            plant.own(label, each)
    if loop.adaptation is not None:
        loop.adaptation.check(plant)
    if loop.safety is not None:
        loop.safety.kernels(plant)
    inputs.bounds(plant, loop.input_bounds)
    loop.measurement.check(plant, loop.observer and len(loop.observer.outputs))
    if truth is not None and (truth.n, truth.m) != (plant.n, plant.m):
        what = f"expected a plant with {plant.n} states and {plant.m} inputs"
        raise ConfigError(f"truth: {what}, got {truth!r}; give one")
    if truth is not None and truth.declares_delay != plant.declares_delay:
        raise ConfigError("truth: expected a delay that both plants declare, or none, got that of one; declare both")
    integrator(loop.integrator, plant, loop.real)


def integrator(name: Any, *plants: Plant) -> type[OneStep]:
    """The one-step method of that name, or of a file. Raises ConfigError for any other, or where a plant lacks it."""
    kind = method(name, "integrator") if isinstance(name, str) else None
    if kind is None or not issubclass(kind, OneStep):
        raise ConfigError(f"integrator: expected a one-step method, as euler, heun or rk4, got {name!r}; choose one")
    for plant in plants:
        problem_of(plant).needs(kind.name)
    return kind
