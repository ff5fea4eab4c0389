"""The variables of the FMU: its inputs, parameters and outputs, with their places in the C instance."""

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from npred.errors import ConfigError
from npred.kernels.c_text import literal
from npred.loop.controller import Controller
from npred.predictors.guarded import PASSES, Guarded, bare
from npred.runtimes import c_controller
from npred.safety.filter import assumed

LARGEST, SMALLEST = sys.float_info.max, sys.float_info.min
PARAMETERS = ("tunable", "fixed")  # of the roles, which are these, input, output and independent


@dataclass(frozen=True)
class Variable:
    """A variable of the model description. Those of one `block` lie one after the other in the instance.

    `start` has the numbers of the whole array, row by row; a parameter lies within low, high.
    """

    name: str
    role: str
    block: str
    start: tuple[float, ...]
    about: str
    unit: str = ""
    shape: tuple[int, ...] = ()
    low: float = -LARGEST
    high: float = LARGEST
    boolean: bool = False


def of(controller: Controller, X0: np.ndarray, arrays: bool) -> list[Variable]:
    """All variables, a value reference being the place in this list; `arrays` where one variable may be an array.

    Raises ConfigError where two have one name.
    """
    variables = [*_inputs(controller, X0, arrays), *_outputs(controller), *_parameters(controller)]
    names = [variable.name for variable in variables]
    if doubled := sorted({name for name in names if names.count(name) > 1}):
        raise ConfigError(
            f"export fmu: expected different names of variables, got {doubled[0]!r} twice; rename that state or input"
        )
    return variables


def _inputs(controller: Controller, X0: np.ndarray, arrays: bool) -> Iterator[Variable]:
    plant, nx = controller.plant, controller.predictor.nx
    yield Variable("time", "independent", "TIME", (0.0,), "time", plant.time_unit)
    what = "measured output" if controller.observer else "measured state"
    X = X0 if controller.observer is None else controller.observer.measured(X0)
    for name, value in zip(controller.outputs, X.tolist(), strict=True):
        yield Variable(name, "input", "X", (value,), what, plant.units.get(name, ""))
    if controller.actuator == "history":
        about = "how old that is when the control step is due; below 0 for no sample"
        yield Variable("sample_age", "input", "SAMPLE_AGE", (0.0,), about, plant.time_unit)
        return
    about = "commands under way, by nodes and inputs: row 1 acts now, the last was sent just now"
    if arrays:
        start = tuple(np.tile(controller.u0, nx).tolist())
        yield Variable("actuator_state", "input", "ACTUATOR", start, about, shape=(nx, plant.m))
        return
    for j in range(nx):
        for c, value in enumerate(controller.u0.tolist()):
            unit = plant.units.get(plant.inputs[c], "")
            yield Variable(f"actuator_state[{j + 1},{c + 1}]", "input", "ACTUATOR", (value,), about, unit)


def _outputs(controller: Controller) -> Iterator[Variable]:
    plant = controller.plant
    for name, value in zip(plant.inputs, controller.u0.tolist(), strict=True):
        yield Variable(name, "output", "U", (value,), "command", plant.units.get(name, ""))
    yield Variable("D_hat", "output", "D_HAT", (controller.D_hat,), "estimated delay", plant.time_unit)
    for name in plant.states:
        about = "predicted state, when the command acts"
        yield Variable(f"predicted.{name}", "output", "P", (0.0,), about, plant.units.get(name, ""))
    if isinstance(controller.predictor, Guarded):
        about = "whether the numerical predictor answered"
        yield Variable("fallback", "output", "FALLBACK", (0.0,), about, boolean=True)
        yield Variable("error", "output", "ERROR", (0.0,), "the guard's estimate of the error of the command")
    if controller.actuator == "history":
        yield from _status(controller)


def _status(controller: Controller) -> Iterator[Variable]:
    """What npred.loop.status says of the last control step."""
    plant = controller.plant
    about = "age of the last sample that was used; -1 before the first"
    yield Variable("age", "output", "AGE", (-1.0,), about, plant.time_unit)
    yield Variable("late", "output", "LATE", (0.0,), "samples so far that came after a newer one, or were too old")
    yield Variable("refused", "output", "REFUSED", (0.0,), "samples so far that were not believed")
    if controller.observer:
        about = "how often the observer of the state was lost and began anew"
        yield Variable("renewed", "output", "RENEWED", (0.0,), about)
    if controller.parts["observe"]:
        about = "half the range of the delays that fit as well"
        yield Variable("D_hat_spread", "output", "SPREAD", (controller.status.D_hat_spread,), about, plant.time_unit)
    if controller.watchdog:
        about = "whether the watchdog has the command"
        yield Variable("handed_over", "output", "HANDED_OVER", (0.0,), about, boolean=True)
    if controller.safety:
        yield Variable("filtered", "output", "FILTERED", (0.0,), "whether the safety filter changed U", boolean=True)
        about = "whether the bounds of U left no way to keep the limits"
        yield Variable("unkept", "output", "UNKEPT", (0.0,), about, boolean=True)
        yield Variable("kept", "output", "KEPT", (0.0,), "the least limit of the predicted states, safe at 0 or above")
    if controller.settings.offsets:
        for name in plant.inputs:
            about = "estimated, added to the command before the plant"
            yield Variable(f"offset.{name}", "output", "OFFSET", (0.0,), about, plant.units.get(name, ""))


def _parameters(controller: Controller) -> Iterator[Variable]:
    """What can be set: of a network it is not the plant's parameters, for it was trained for them."""
    plant, predictor, law = controller.plant, controller.predictor, controller.adaptation
    if not plant.declares_delay:
        low, high = c_controller.D_hat_bounds(controller)
        yield Variable(
            "D_hat_start", "fixed", "D_HAT_START", (controller.D_hat,), "first estimate of the delay",
            plant.time_unit, low=low, high=min(high, LARGEST),
        )  # fmt: skip
    if law is not None and controller.settings.gamma_dt > 0:
        yield Variable("gamma", "tunable", "GAMMA", (law.gamma,), "gain of the delay law", low=SMALLEST)
    if isinstance(predictor, Guarded):
        about = "largest error of the command that passes the guard"
        yield Variable("tolerance", "tunable", "TOLERANCE", (predictor.tolerance,), about, low=SMALLEST)
    if not hasattr(bare(predictor), "operator"):
        decided = assumed(plant) if controller.safety else []
        for name, value in plant.parameters.items():
            about = "parameter of plant and law"
            about += f"; the safety filter is written for {value:g}" if name in decided else ""
            yield Variable(f"parameter.{name}", "tunable", "PARAMETERS", (float(value),), about)


def header(controller: Controller, variables: Sequence[Variable], name: str, token: str) -> str:
    """The text of variables.h: what instance.h and the functions of FMI read of this controller."""
    ends = list(accumulate(len(variable.start) for variable in variables))
    firsts = [end - len(variable.start) for end, variable in zip(ends, variables, strict=True)]
    blocks: dict[str, int] = {}
    for first, variable in zip(firsts, variables, strict=True):
        blocks.setdefault(variable.block, first)
    lines = [
        "/* The variables of this FMU. */",
        f'#include "{name}.h"',
        "",
        f'#define TOKEN "{token}"',
        f"#define STEP {controller.dt!r}",
        f"#define TIME_UNIT {json.dumps(controller.plant.time_unit.replace('%', ''))} /* of STEP and all times */",
        f"#define GUARD_PASSES {PASSES!r}",
        f"#define VARIABLES {len(variables)}",
        f"#define VALUES {ends[-1]}",
        *(f"#define AT_{block} {first}" for block, first in blocks.items()),
        "",
        "static const Variable variables[VARIABLES] = {",
        *(_entry(first, variable) for first, variable in zip(firsts, variables, strict=True)),
        "};",
        "static const double start_values[VALUES] = {",
        *(f"    {', '.join(literal(value, 'double') for value in variable.start)}," for variable in variables),
        "};",
    ]
    return "\n".join(lines) + "\n"


def _entry(first: int, variable: Variable) -> str:
    low, high = literal(variable.low, "double"), literal(variable.high, "double")
    return f"    {{{first}, {len(variable.start)}, {variable.role.upper()}, {int(variable.boolean)}, {low}, {high}}},"
