"""The settings of closed loops, which the tables of several stages share."""

import math
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import model_validator

from npred.base.errors import bytes_text
from npred.base.registry import FROZEN, PAPER
from npred.lab.config.section import (
    Bounds,
    Law,
    Method,
    Nodes,
    Number,
    Observes,
    Positive,
    Range,
    Section,
    Switch,
    built,
)
from npred.loop import control_step
from npred.loop.loop import Actuator
from npred.loop.measurement import Sensors
from npred.loop.safety import SafetyFilter
from npred.loop.timing import ControlClock

LONGEST_RUN = 10**9  # control steps of a loop
STEP = 6  # numbers that are kept of a step at least: X, P, U, D_hat, N and an energy
Clock = Annotated[ControlClock, built(ControlClock)]
Limits = Annotated[SafetyFilter, built(SafetyFilter)]
StartInput = Number | list[Number] | list[list[Number]] | Literal["equilibrium", "law"]


class StateObserver(Section):
    """An observer that estimates the state from the plant's outputs."""

    kind: Observes = "ekf"  #: ekf, luenberger, one of a package, or `file.py:Class`
    outputs: list[str] | None = None  #: what is measured, of the plant's outputs and states; by default its outputs
    offset: Switch = False  #: whether it also estimates an offset of each input


class Disturbance(Section):
    """amplitude sin(omega t), added to each input of the plant."""

    amplitude: Number = 0.0  #: in units of the input
    omega: Positive = 1.0  #: in rad per unit of time; by default 1 / D


class Setpoint(Section):
    """A parameter of the plant that is set while a loop runs."""

    at: list[Number]  #: times, rising, in seconds
    to: list[Number]  #: its value from each of them on


class LoopTable(Section):
    """The settings of closed loops [DAPF, eqs. 6-14].

    With `adaptation = "frozen"` D_hat stays at its first value; start it at D for a known delay. For a plant that
    declares its delay, leave out all keys about delays, estimates and laws.

    Times are in the plant's unit. The defaults are for D = 1. For another D, estimates, bounds, delays, t_end without a
    value are multiplied by D (or by the middle of its range), and dt is that of npred.loop.control_step.usual for the
    middle too. Bounds without a value contain all delays and estimates.
    """

    follows: ClassVar[tuple[str, ...]] = ()  # keys that are multiples of D
    mapped: ClassVar[tuple[str, ...]] = ()  # further delays and estimates that the bounds hold
    lasting: ClassVar[tuple[str, ...]] = ("t_end",)

    dt: Positive = 0.005  #: control step; by default about D / 300
    nx: Nodes = 101  #: nodes of the predictor and of u, both ends of [0, 1]; dx = 0.01 is 101
    t_end: Positive = 40.0  #: length of a loop; times D
    #: a method, as rk4 or rosenbrock, one of a package, or `file.py:Class`
    predictor: Method = "rk4"
    adaptation: Law = PAPER  #: the delay law: the paper's, frozen, one of a package, or `file.py:Class`
    gamma: Positive | None = None  #: adaptation gain [DAPF, eq. 11]; by default one that suits the plant and D
    b: Positive = 1.0  #: weight of w in phi [DAPF, eq. 12]
    bounds: Range = (0.1, 4.0)  #: the range of D_hat; by default 0.1 D to 4 D
    input_bounds: list[Bounds] | None = None  #: the range of U, a pair per input; by default the plant's
    #: the input before t = 0: numbers, "equilibrium", "law" (κ of the start), or rows over [-D, 0], the oldest first;
    #: by default that of the plant's rest, where it has one within input_bounds, else 0
    u0: StartInput | None = None
    #: whether u is measured, or computed from past commands and D_hat
    actuator: Actuator = "measured"
    #: parameters of the simulated plant that differ from the controller's model
    truth: dict[str, Number] = {}
    measurement: Annotated[Sensors, built(Sensors)] = Sensors()  #: the sensors
    #: the clock of the control loop, with actuator = "history"
    timing: Clock | None = None
    #: an observer of the state, with actuator = "history"
    observer: StateObserver | None = None
    #: a filter of U that keeps the plant's limits, `safe`; by default U is not filtered
    safety: Limits | None = None
    #: set-points while the loop runs: a parameter's times and values, as `{ aim = { at = [10.0], to = [2.0] } }`
    setpoints: dict[str, Setpoint] = {}
    #: a disturbance of the input
    disturbance: Disturbance = Disturbance()

    @model_validator(mode="before")
    @classmethod
    def _follow(cls, data: Any) -> Any:
        """The table with the defaults that follow D."""
        ends = _ends(data.get("D", 1.0)) if isinstance(data, dict) else []
        if not ends or not 0 < min(ends) <= max(ends) < math.inf:
            return data  # its own check refuses that D
        D, fields, bounds = (min(ends) + max(ends)) / 2, cls.model_fields, _ends(data.get("bounds", []))
        low, high = bounds if len(bounds) == 2 else (0.0, math.inf)
        filled = {key: _times(D, fields[key].default, low, high) for key in cls.follows}
        filled |= {key: D * fields[key].default for key in cls.lasting}
        filled |= {"dt": min([control_step.usual(D), *(end for end in _ends((filled | data)["t_end"]) if end > 0)])}
        data = _with_omega(filled | data, D)
        if isinstance(data.get("scenarios"), list):
            data["scenarios"] = [_with_omega(scenario, D) for scenario in data["scenarios"]]
        if "bounds" not in data and data.get("adaptation") != FROZEN:
            delays = [end for key in ("D", *cls.follows, *cls.mapped) for end in _ends(data.get(key, []))]
            low, high = (D * bound for bound in fields["bounds"].default)
            data["bounds"] = (min(low, *delays), max(high, *delays))
        return data

    @model_validator(mode="after")
    def _check(self) -> Self:
        self.lasts("t_end", self.t_end)
        self.clocked()
        return self

    @property
    def longest(self) -> float:
        """The longest true delay, jumps and drifts of scenarios aside."""
        return max(_ends(getattr(self, "D", 1.0)))

    @property
    def simulated(self) -> bool:
        """True if loops are run: data may come from a file."""
        return not getattr(self, "data", "")

    def clocked(self) -> None:
        """Raise ValueError for parts that read the controller's own commands where it is given u."""
        parts = {"timing": self.timing, "observer": self.observer, "safety.delay": self.safety and self.safety.delay}
        for key, value in parts.items():
            if value and self.actuator != "history":
                raise ValueError(f'{key}: expected actuator = "history", got {self.actuator!r}; give it, or no {key}')

    def lasts(self, key: str, time: float) -> None:
        """Raise ValueError for loops shorter than a control step, or with more steps than a record can hold."""
        if self.dt > time:
            raise ValueError(f"dt: expected at most {key} = {time:g}, got {self.dt:g}; shorten the step")
        if time > LONGEST_RUN * self.dt:
            steps = time / self.dt
            room = f"{steps:.3g} steps of {self.dt:g}, whose record takes {bytes_text(8 * STEP * steps)} for each loop"
            raise ValueError(f"{key}: expected at most {LONGEST_RUN} steps, got {room}; shorten {key} or lengthen dt")

    def reached(self, key: str, span: Range) -> None:
        """Raise ValueError for a delay or an estimate of it outside the bounds, where the estimate adapts."""
        (low, high), bounds = span, self.bounds
        if self.adaptation != FROZEN and (low < bounds[0] or high > bounds[1]):
            came = [low, high] if low < high else f"{low:g}"
            raise ValueError(f"{key}: expected within bounds = {list(bounds)}, got {came}; widen bounds or move {key}")


def _with_omega(table: Any, D: float) -> Any:
    """A table whose disturbance, where one is written, has an omega."""
    wave = table.get("disturbance") if isinstance(table, dict) else None
    return table | {"disturbance": {"omega": 1 / D} | wave} if isinstance(wave, dict) else table


def _times(D: float, value: Any, low: float, high: float) -> Any:
    """A number, or each one of a list, times D, clipped to [low, high]."""
    several = isinstance(value, list | tuple)
    return [_times(D, item, low, high) for item in value] if several else min(max(D * value, low), high)


def _ends(value: Any) -> list[float]:
    """The numbers of a value as it is written: a number, a list of numbers or of pairs; not those of anything else."""
    if isinstance(value, list | tuple):
        return [end for item in value for end in _ends(item)]
    return [float(value)] if isinstance(value, int | float) and not isinstance(value, bool) else []
