"""The table [evaluate] with its scenarios and its guard."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Self, get_type_hints

from pydantic import Field, create_model, model_validator

from npred.base.registry import FROZEN
from npred.lab.config.loop import LoopTable
from npred.lab.config.section import Bounds, Count, Delay, Nodes, Number, Positive, Range, Section, Some


class Drift(Section):
    """The true delay D + amplitude sin(2π t / period)."""

    amplitude: Number  #: in the plant's unit of time
    period: Positive  #: in the plant's unit of time


class Jump(Section):
    """The true delay is D until the time `at`, then another one."""

    to: Delay  #: the new delay
    at: Delay  #: in the plant's unit of time


class _Scenario(Section):
    """Loops under other conditions, from the initial states of the cases. A key replaces that of [evaluate]."""

    name: Annotated[str, Field(min_length=1, max_length=40)]  #: in tables and figures
    case_D_hat: Some[Positive] | None = None  #: as case_D_hat
    case_t_end: Positive | None = None  #: as case_t_end
    drift: Drift | None = None  #: the true delay oscillates
    jump: Jump | None = None  #: the true delay jumps

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.drift and self.jump:
            raise ValueError("drift, jump: expected one of them, got both; drop one, or write two scenarios")
        return self

    @property
    def about_delay(self) -> list[str]:
        """The keys that are given and mean nothing where the plant declares its delay."""
        keys = ("adaptation", "gamma", "b", "bounds", "case_D_hat", "drift", "jump")
        return [key for key in keys if getattr(self, key) is not None]

    def delays(self, D: float) -> Range:
        """The smallest and the largest true delay where it is D in [evaluate]."""
        reach = abs(self.drift.amplitude) if self.drift else 0.0
        ends = (D, self.jump.to) if self.jump else (D - reach, D + reach)
        return min(ends), max(ends)


if TYPE_CHECKING:
    Scenario = _Scenario
else:  # with each key of a loop that is not that of the predictor, which is made once
    _hints = get_type_hints(LoopTable, include_extras=True)
    _keys = [key for key in LoopTable.model_fields if key not in ("nx", "predictor", "t_end")]
    _fields = {key: (_hints[key] | None, Field(None, description=f"as {key}")) for key in _keys}
    Scenario = create_model("Scenario", __base__=_Scenario, __doc__=_Scenario.__doc__, __module__=__name__, **_fields)


class GuardTable(Section):
    """The networks are checked in every call of a loop; if one may be wrong, `predictor` answers (npred.guarded)."""

    tolerance: Positive = 0.01  #: largest error of U that is accepted, in units of U; numerical answers may err by more


class Evaluate(LoopTable):
    """Errors on held-out rows, the error |P(1, t) - X(t + D)| in loops, the loop of Fig. 1, cases (initial states x
    D_hat(0)) and a map D x D_hat(0).
    """

    follows: ClassVar = ("D_hat", "case_D_hat")
    mapped: ClassVar = ("map_D", "map_D_hat")
    lasting: ClassVar = ("t_end", "case_t_end")

    t_end: Positive = 40.0  #: length of the loop of Fig. 1; times D
    nx: Nodes = 51  #: nodes of the predictors and of u; networks take any number
    D: Positive = 1.0  #: true delay
    X0: list[Number] = []  #: start of Fig. 1, one number per state; required
    D_hat: Positive = 2.0  #: D_hat(0) of Fig. 1; times D
    case_states: Count = 10  #: random initial states of the cases …
    case_D_hat: Some[Positive] = [0.3, 0.5, 1.0, 1.5, 2.0]  #: … times these D_hat(0); times D
    case_t_end: Positive = 40.0  #: length of these loops; times D
    map_D: list[Positive] = []  #: true delays of the convergence map …
    map_D_hat: list[Positive] = []  #: … times these D_hat(0), from the start of Fig. 1
    #: bounds of U, a pair per input, of a second loop of Fig. 1; by default there is none
    figure_bounds: list[Bounds] | None = None
    scenarios: list[Scenario] = []  #: other conditions
    #: the check of networks in loops; by default none
    guard: GuardTable | None = None

    def under(self, scenario: Scenario) -> Self:
        """This table with the keys that a scenario gives in their places; drifts and jumps of D aside."""
        keys = type(self).model_fields
        return self.model_copy(update={key: value for key, value in scenario if key in keys and value is not None})

    @property
    def adapts(self) -> bool:
        laws = [self.adaptation, *(self.under(scenario).adaptation for scenario in self.scenarios)]
        return any(law != FROZEN for law in laws)

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
                table.lasts("case_t_end", table.case_t_end)
                table.acting(self.adapts)
            except ValueError as error:
                raise ValueError(f"scenarios[{k}]: {error}") from None
            for value in scenario.case_D_hat or []:
                table.reached(f"scenarios[{k}].case_D_hat", (value, value))
        return self

    @model_validator(mode="after")
    def _check_delays(self) -> Self:
        keys = {"D_hat": self.D_hat, "D": self.D}
        for key in ("map_D", "case_D_hat", "map_D_hat"):
            keys |= {f"{key}[{k}]": value for k, value in enumerate(getattr(self, key))}
        for key, value in keys.items():
            self.reached(key, (value, value))
        if bool(self.map_D) != bool(self.map_D_hat):
            raise ValueError("map_D, map_D_hat: expected both or neither, got one; a map needs both axes")
        if self.t_end > self.case_t_end:
            raise ValueError(
                f"t_end: expected at most case_t_end = {self.case_t_end:g}, got {self.t_end:g}; raise that"
            )
        self.lasts("case_t_end", self.case_t_end)
        return self
