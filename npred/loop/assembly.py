"""What runs a loop, made of its description here alone: the law, the kernels, the settings and the sizes of its state,
for loops in lanes and on a clock, for a controller and its exports.
"""

import math
from typing import Any

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.estimation import delay_law
from npred.estimation.delay_law import DelayLaw, Part
from npred.estimation.observers.base import SIGMAS
from npred.loop import engine, signals
from npred.loop.loop import Loop
from npred.loop.signals import Settings
from npred.plants import inputs
from npred.prediction.delays import problem_of
from npred.prediction.delays.constant import ConstantDelay
from npred.prediction.methods import RK4

DELAYS = 5.0  # times the delay at a plant's target, where it declares one, are commands kept
OLDEST = 50  # control steps, by default the largest age of a sample


def first_estimate(loop: Loop) -> tuple[DelayLaw | None, float | None]:
    """The law, complete, for a delay of D_hat or else of the middle of its bounds; and the first D_hat, None for that
    of a declared delay. Raises ConfigError where nothing says what it is.
    """
    plant, law, D_hat = loop.plant, loop.adaptation, loop.D_hat
    D_hat = None if D_hat is None else array_checks.number("D_hat", D_hat)
    if D_hat is None and law is not None and law.bounds is None:
        what = "expected a first estimate, for the law has no bounds, got none"
        raise ConfigError(f"D_hat: {what}; give D_hat")
    if D_hat is None and law is None and not plant.declares_delay:
        what = f"expected a delay in {plant.time_unit}, for nothing adapts it, got none"
        raise ConfigError(f"D_hat: {what}; give D_hat")
    if law is None:
        return None, D_hat
    D_hat = sum(law.bounds) / 2 if D_hat is None else D_hat
    array_checks.delays("D_hat", D := np.array(D_hat))
    return law.suited(plant, D, D), D_hat


def law(loop: Loop) -> Part:
    """The kernels of U and of the estimate of the delay; the open loop has U = 0."""
    if loop.predictor is None:
        return delay_law.part(loop.plant, None, loop.dt)._replace(control=None)
    laws = delay_law.part(loop.plant, loop.adaptation, loop.dt, loop.observer)
    return laws._replace(control=ConstantDelay(loop.plant).control(RK4.step)) if loop.blind else laws


def outputs(loop: Loop) -> tuple[str, ...]:
    """The names of a sample's numbers: the states, or the outputs of its observer."""
    return tuple(loop.observer.outputs) if loop.observer else loop.plant.states


def oldest(loop: Loop) -> int:
    """How old a sample may be, in control steps."""
    if not loop.reads_commands:
        return 0
    return OLDEST if loop.max_sample_age is None else math.floor(loop.max_sample_age / loop.dt * (1 + 1e-12))


def history_length(loop: Loop, bounds: np.ndarray) -> float:
    """How long commands are kept, by default the largest delay of the estimate. Raises ConfigError for less."""
    needed = 0.0 if loop.plant.declares_delay else loop.D_hat
    needed = max(needed, float(bounds[1]) if loop.adaptation else 0.0)
    if loop.history_length is None:
        declared = loop.reads_commands and loop.plant.declares_delay and not loop.blind
        return float(DELAYS * loop.plant.delay(loop.plant.target(0.0), 0.0)) if declared else needed
    if loop.history_length < needed:
        what = f"expected at least the largest delay, {loop.plant.time_text(needed)}"
        raise ConfigError(f"history_length: {what}, got {loop.history_length!r}; raise it")
    return float(loop.history_length)


def _with_kernels(loop: Loop) -> list[Any]:
    """Its parts that bring kernels, settings and signals."""
    return [part for part in (loop.observer, loop.watchdog, loop.safety) if part]


def kernels(loop: Loop, laws: Part) -> dict[str, Any]:
    """The sentences of a control step on lanes by npred.loop.signals.PARTS, None for those that it does not have."""
    plant, predictor = loop.plant, loop.predictor
    model = ConstantDelay(plant) if loop.blind else problem_of(plant)
    goes_on = loop.reads_commands or loop.safety or not loop.measurement.perfect
    sentences = {
        "observe": laws.observe,
        "model_delay": model.horizon(),  # None too where D_hat = 0
        "predict": predictor and (model.sweep(RK4.step) if loop.blind else predictor.lanes()),
        "guard": None if loop.blind else getattr(predictor, "guard", None),
        "control": laws.control,
        "update": laws.update,
        "model": engine.advance_kernel(plant, RK4) if goes_on else None,
    }
    for part in _with_kernels(loop):
        sentences |= part.kernels(plant)
    return sentences


def settings(loop: Loop, laws: Part, **simulated: Any) -> Settings:
    """What the kernels of a loop that is complete are set to; `simulated` is that of what is around the controller."""
    plant, guard, gate = loop.plant, getattr(loop.predictor, "settings", None), loop.outlier_limit
    limits, watches = loop.input_bounds, laws.memory > 1
    box = plant.ranges(half=0.0)
    half, numbers = np.ptp(box, axis=1) / 2, {"anew": box.mean(axis=1)}
    for part in _with_kernels(loop):
        numbers |= part.numbers(plant, loop.dt, limits)
    return signals.settings(
        dt=loop.dt, b=laws.b, gamma_dt=laws.gamma * loop.dt,
        reads_commands=loop.reads_commands, stores_commands=loop.reads_commands,
        gate=(gate or 1.0) * (SIGMAS if loop.observer else 1.0), gated=loop.reads_commands and gate is not None,
        reach=(gate or 1.0) * np.where(half > 0, half, np.inf), oldest=float(oldest(loop)),
        observer_count=laws.memory if watches else 0, judges_outputs=bool(loop.observer) and watches,
        output_count=len(outputs(loop)), bounds=laws.bounds, p=plant.p.copy(), truth_p=loop.real.p.copy(),
        ratios=plant.ratios, input_bounds=np.ascontiguousarray(inputs.widest(plant, limits), dtype=float),
        law=laws.settings, guard=np.zeros(0) if guard is None or loop.blind else guard, **numbers, **simulated,
    )  # fmt: skip


def sizes(loop: Loop, laws: Part) -> dict[str, int]:
    """The axes of the signals of its state, but those of the history and of the clock."""
    plant, predictor = loop.plant, loop.predictor
    axes = {"n": plant.n, "m": plant.m, "nx": predictor.nx if predictor else 2, "observer": laws.memory}
    axes |= dict.fromkeys(("past", "filter", "ends", "plan"), 0) | {"outputs": len(outputs(loop))}
    for part in _with_kernels(loop):
        axes |= part.axes(plant)
    return axes
