"""The settings of closed loops, which the tables of several stages share."""

import math
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import model_validator

from npred.base.errors import bytes_text
from npred.base.registry import FROZEN, PAPER
from npred.lab.config.section import (
    Bounds,
    Delay,
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
from npred.loop import acts, control_step
from npred.loop.loop import Actuator
from npred.loop.measurement import Sensors
from npred.loop.safety import SafetyFilter
from npred.loop.timing import ControlClock
from npred.loop.watchdog import Watchdog

LONGEST_RUN = 10**9  # control steps of a loop
STEP = 6  # numbers that are kept of a step at least: X, P, U, D_hat, N and an energy
Clock = Annotated[ControlClock, built(ControlClock)]
Limits = Annotated[SafetyFilter, built(SafetyFilter)]
StartInput = Number | list[Number] | list[list[Number]] | Literal["equilibrium", "law"]


class ObserverTable(Section):
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

    at: list[Number]  #: times, rising, in the plant's unit
    to: list[Number]  #: its value from each of them on


class LoopTable(Section):
    """The settings of closed loops [DAPF, eqs. 6-14].

    With `adaptation = "frozen"` D_hat stays at its first value; start it at D for a known delay. For a plant that
    declares its delay, leave out all keys about delays, estimates and laws.

    What npred.Loop has too means what it means there, and is refused where it cannot act. Times are in the plant's
    unit. The defaults are for D = 1. For another D, estimates, bounds, delays, t_end without a
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
    #: adaptation gain [DAPF, eq. 11]; by default one that suits the plant and D. Needs a law
    gamma: Positive | None = None
    b: Positive = 1.0  #: weight of w in phi [DAPF, eq. 12]. Needs a law
    bounds: Range = (0.1, 4.0)  #: the range of D_hat; by default 0.1 D to 4 D. Needs a law
    input_bounds: list[Bounds] | None = None
    u0: StartInput | None = None
    actuator: Actuator = "measured"
    observer: ObserverTable | None = None
    watchdog: Annotated[Watchdog, built(Watchdog)] | None = None
    safety: Limits | None = None
    outlier_limit: Positive = 1.0
    max_sample_age: Delay | None = None
    measurement: Annotated[Sensors, built(Sensors)] = Sensors()
    #: parameters of the simulated plant that differ from the controller's model
    truth: dict[str, Number] = {}
    truth_scale: Positive = 1.0  #: factor of all parameters of the simulated plant
    disturbance: Disturbance = Disturbance()
    #: a parameter's times and values, as `{ aim = { at = [10.0], to = [2.0] } }`
    setpoints: dict[str, Setpoint] = {}
    timing: Clock | None = None
    integrator: Method = "rk4"

    alone: ClassVar = False  # as npred.loop.acts asks a loop

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
        self.acting(self.adapts)
        return self

    @property
    def adapts(self) -> bool:
        """True if a law moves D_hat in some of its loops."""
        return self.adaptation != FROZEN

    @property
    def longest(self) -> float:
        """The longest true delay, jumps and drifts of scenarios aside."""
        return max(_ends(getattr(self, "D", 1.0)))

    @property
    def simulated(self) -> bool:
        """True if loops are run: data may come from a file."""
        return not getattr(self, "data", "")

    @property
    def on_a_clock(self) -> bool:
        """True if calls, samples and commands each have their times."""
        return any((self.timing, self.observer, self.watchdog))

    def acting(self, adapts: bool) -> None:
        """Raise ValueError for keys that cannot act, whatever the plant; those of a law where no loop adapts D_hat."""
        fields = type(self).model_fields
        names = [key for key in fields if getattr(self, key) != fields[key].default]
        acts.refuse(self, names, whole=False)
        for key in () if adapts else ("gamma", "b", "bounds"):
            if key in names:
                came = f'got adaptation = "{FROZEN}"'
                raise ValueError(f"{key}: expected a law that adapts D_hat, {came}; name one, or leave {key} out")

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
