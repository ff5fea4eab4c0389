"""The table [evaluate] with its scenarios and its guard."""

from dataclasses import replace
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, create_model, model_validator

from npred.lab.config.loop import Clock, Disturbance, Limits, LoopTable, Setpoint, StateObserver
from npred.lab.config.section import (
    Bounds,
    Count,
    Delay,
    Law,
    Nodes,
    Number,
    PerState,
    Positive,
    Range,
    Section,
    Some,
)
from npred.loop.loop import Actuator
from npred.loop.measurement import PER_STATE, Sensors

CASES = {"D_hat0": "case_D_hat0", "t_end": "case_t_end"}  # keys of [evaluate] by those of a scenario


class Drift(Section):
    """The true delay D + amplitude sin(2π t / period)."""

    amplitude: Number  #: in the plant's unit of time
    period: Positive  #: in the plant's unit of time


class Jump(Section):
    """The true delay is D until the time `at`, then another one."""

    to: Delay  #: the new delay
    at: Delay  #: in the plant's unit of time


class Named(Section):
    """A scenario's name."""

    name: Annotated[str, Field(min_length=1, max_length=40)]  #: in tables and figures


_kinds: dict[str, Any] = dict.fromkeys(Sensors.__dataclass_fields__, Number) | dict.fromkeys(PER_STATE, PerState)
_sensors: dict[str, Any] = {
    name: (kind | None, Field(None, description=f"as measurement.{name}")) for name, kind in _kinds.items()
}
Sensed: Any = create_model("Sensed", __base__=Named, **_sensors)


class Scenario(Sensed):
    """Loops under other conditions, from the initial states of the cases. A key replaces that of [evaluate]."""

    parameters_scale: Positive | None = None  #: factor of all parameters of the simulated plant
    parameters: dict[str, Number] = {}  #: as truth
    disturbance: Disturbance | None = None  #: as disturbance
    setpoints: dict[str, Setpoint] | None = None  #: as setpoints
    actuator: Actuator | None = None  #: as actuator
    timing: Clock | None = None  #: as timing
    observer: StateObserver | None = None  #: as observer
    safety: Limits | None = None  #: as safety
    adaptation: Law | None = None  #: as adaptation
    D_hat0: Some[Positive] | None = None  #: as case_D_hat0
    drift: Drift | None = None  #: the true delay oscillates
    jump: Jump | None = None  #: the true delay jumps
    t_end: Positive | None = None  #: as case_t_end

    @model_validator(mode="after")
    def _check(self) -> Self:
        for one, other in (("drift", "jump"), ("parameters", "parameters_scale")):
            if getattr(self, one) and getattr(self, other):
                raise ValueError(f"{one}, {other}: expected one of them, got both; drop one, or write two scenarios")
        return self

    @property
    def about_delay(self) -> list[str]:
        """The keys that are given and mean nothing where the plant declares its delay."""
        return [key for key in ("adaptation", "D_hat0", "drift", "jump") if getattr(self, key) is not None]

    def delays(self, D: float) -> Range:
        """The smallest and the largest true delay where it is D in [evaluate]."""
        reach = abs(self.drift.amplitude) if self.drift else 0.0
        ends = (D, self.jump.to) if self.jump else (D - reach, D + reach)
        return min(ends), max(ends)


class GuardTable(Section):
    """The networks are checked in every call of a loop; if one may be wrong, `predictor` answers (npred.guarded)."""

    tolerance: Positive = 0.01  #: largest error of U that is accepted, in units of U; numerical answers may err by more


class Evaluate(LoopTable):
    """Errors on held-out rows, the error |P(1, t) - X(t + D)| in loops, the loop of Fig. 1, cases (initial states x
    D_hat(0)) and a map D x D_hat(0).
    """

    follows: ClassVar = ("D_hat0", "case_D_hat0")
    mapped: ClassVar = ("map_D", "map_D_hat0")
    lasting: ClassVar = ("t_end", "case_t_end")

    t_end: Positive = 40.0  #: length of the loop of Fig. 1; times D
    nx: Nodes = 51  #: nodes of the predictors and of u; networks take any number
    D: Positive = 1.0  #: true delay
    X0: list[Number] = []  #: start of Fig. 1, one number per state; required
    D_hat0: Positive = 2.0  #: D_hat(0) of Fig. 1; times D
    case_states: Count = 10  #: random initial states of the cases …
    case_D_hat0: Some[Positive] = [0.3, 0.5, 1.0, 1.5, 2.0]  #: … times these D_hat(0); times D
    case_t_end: Positive = 40.0  #: length of these loops; times D
    map_D: list[Positive] = []  #: true delays of the convergence map …
    map_D_hat0: list[Positive] = []  #: … times these D_hat(0), from the start of Fig. 1
    #: bounds of U, a pair per input, of a second loop of Fig. 1; by default there is none
    figure_bounds: list[Bounds] | None = None
    scenarios: list[Scenario] = []  #: other conditions
    #: the check of networks in loops; by default none
    guard: GuardTable | None = None

    def under(self, scenario: Scenario) -> Self:
        """This table with the keys that a scenario gives in their places; drifts and jumps of D aside."""
        values = {CASES.get(key, key): value for key, value in scenario if value is not None}
        update = {key: value for key, value in values.items() if key in type(self).model_fields}
        sensors = {key: value for key, value in values.items() if key in Sensors.__dataclass_fields__}
        update |= {
            "measurement": replace(self.measurement, **sensors),
            "truth": self.truth | scenario.parameters,
        }
        return self.model_copy(update=update)

    @property
    def bounded(self) -> Self | None:
        """This table with `figure_bounds` for `input_bounds`; None where there are none."""
        bounds = self.figure_bounds
        return None if bounds is None else self.model_copy(update={"input_bounds": bounds})

    @model_validator(mode="after")
    def _check_scenarios(self) -> Self:
        names = [scenario.name for scenario in self.scenarios]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"scenarios: expected different names, got {twice!r} twice; rename one")
        for k, scenario in enumerate(self.scenarios):
            span = scenario.delays(self.D)
            if span[0] < 0:
                raise ValueError(f"scenarios[{k}].drift: expected a delay of at least 0, got {span[0]:g}; shrink it")
            try:
                table = self.under(scenario)
                table.reached("delay", span)
                table.lasts("t_end", table.case_t_end)
                table.clocked()
            except ValueError as error:
                raise ValueError(f"scenarios[{k}]: {error}") from None
            for value in scenario.D_hat0 or []:
                table.reached(f"scenarios[{k}].D_hat0", (value, value))
        return self

    @model_validator(mode="after")
    def _check_delays(self) -> Self:
        keys = {"D_hat0": self.D_hat0, "D": self.D}
        for key in ("map_D", "case_D_hat0", "map_D_hat0"):
            keys |= {f"{key}[{k}]": value for k, value in enumerate(getattr(self, key))}
        for key, value in keys.items():
            self.reached(key, (value, value))
        if bool(self.map_D) != bool(self.map_D_hat0):
            raise ValueError("map_D, map_D_hat0: expected both or neither, got one; a map needs both axes")
        if self.t_end > self.case_t_end:
            raise ValueError(
                f"t_end: expected at most case_t_end = {self.case_t_end:g}, got {self.t_end:g}; raise that"
            )
        self.lasts("case_t_end", self.case_t_end)
        return self
