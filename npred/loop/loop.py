"""One description of a loop: for simulation, for a controller, and for a pipeline's tables."""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, Self, TypedDict

import numpy as np

from npred.base.errors import ConfigError, similar
from npred.estimation.delay_law import DelayLaw, by_name
from npred.estimation.observers import Observer
from npred.loop import acts
from npred.loop.measurement import Measurement
from npred.loop.safety import SafetyFilter
from npred.loop.timing import Timing, on_steps
from npred.loop.watchdog import Watchdog
from npred.plants.base import Plant
from npred.prediction.methods import Predictor

Actuator = Literal["measured", "history"]  # how the controller knows the commands under way, u

PERFECT = Measurement()


@dataclass(frozen=True, kw_only=True)
class Loop:
    """X' = f(X, U(t - D)), U = kappa(P(1)), D_hat' = gamma Proj{D_hat, phi} [DAPF, eqs. 6-14]: all parts of it.

    The parts down to `history_length` are the controller's; those that follow are of the simulated plant, its sensors
    and its clock. Times are in the plant's unit. A part that is given without what it needs has no use, and is refused
    in one line (npred.loop.acts). A clock is timing, an observer, a watchdog, or samples
    that a controller with actuator="history" gets between its steps, or late.
    """

    plant: Plant  #: the controller's model, from npred.plant
    predictor: Predictor | None  #: from npred.predictor, npred.load or npred.guarded; None is the open loop U = 0
    dt: float = None  # type: ignore[assignment]  #: control step; U is held over it; by default it follows D
    #: law of the estimate D_hat, also by name, as a pipeline; None freezes it. Needs a predictor, and no declared delay
    adaptation: DelayLaw | None = None
    D_hat: Any = None  #: first estimate of the delay, (...). Of a declared delay only 0, in a simulation
    #: pairs (low, high) to which U is clipped, (m, 2); by default the plant's. Needs a predictor
    input_bounds: Any = None
    #: inputs before t = 0, by default the rest's: (m,), "equilibrium", "law", rows (k, m), a function. Needs a delay;
    #: of a controller alone actuator="history", or a law that reads the commands
    u0: Any = None
    #: "measured": u is; "history": u is read at D_hat from the controller's commands, as always where a simulated plant
    #: declares its delay. Needs a predictor
    actuator: Actuator = "measured"
    #: estimates X from the plant's outputs, which then are sampled: EKF, Luenberger. Needs a predictor,
    #: actuator="history", and no declared delay in a simulation
    observer: Observer | None = None
    watchdog: Watchdog | None = None  #: gives U if no sample comes. Needs what an observer needs
    #: keeps the limits that the plant declares. Needs a predictor; alone, or with a `delay`, actuator="history"
    safety: SafetyFilter | None = None
    #: samples farther from the model than this times half the box are refused; None takes all. Needs a predictor, and
    #: actuator="history"
    outlier_limit: float | None = 1.0
    #: largest age of a sample that is used; by default 50 control steps. Needs a predictor, actuator="history", and in
    #: a simulation a delay of the measurement, or its period and a clock
    max_sample_age: float | None = None
    #: how long commands are kept; by default the largest D_hat. Needs a controller alone, with actuator="history", or a
    #: law that reads the commands
    history_length: float | None = None
    #: true delay, (...) or a function of t; where inputs have several the longest. Needs no declared delay
    D: Any = None
    X0: Any = None  #: states at t = 0, (..., n); without them a controller alone is described
    #: what the controller sees of X. Needs a predictor, or an observer in it, which cannot be beside a clock
    measurement: Measurement = PERFECT
    truth: Plant | None = None  #: the simulated plant, if it is not the controller's model
    disturbance: Callable[[float], Any] | None = None  #: added to the plant's input, (m,) or (..., m), by the time
    #: {parameter: (times, values)}, set from the first control step at or after each time on. Needs a predictor
    setpoints: Any = None
    #: clock of the calls and commands. Needs a predictor, actuator="history", and no declared delay
    timing: Timing | None = None
    integrator: str = "rk4"  #: the method that advances the plant: "euler", "heun", "rk4", …

    def __post_init__(self) -> None:
        """A law by name is the law with its defaults. Raises ConfigError as npred.loop.acts.check does."""
        if isinstance(self.adaptation, str):
            object.__setattr__(self, "adaptation", by_name(self.adaptation))
        acts.check(self)

    def filled(self, **values: Any) -> Self:
        """The same with what was left out filled in, which is not checked again."""
        other = copy.copy(self)
        vars(other).update(values)
        return other

    @property
    def given(self) -> list[str]:
        """The parts that are not their defaults."""
        values = [(field.name, getattr(self, field.name), field.default) for field in fields(self)]
        plain = str | float | Measurement | Mapping
        return [
            name for name, value, default in values
            if not (value is default or (isinstance(value, plain) and value in (default, {})))
        ]  # fmt: skip

    @property
    def alone(self) -> bool:
        """True for a controller without a simulated plant."""
        return self.X0 is None

    @property
    def keeps_commands(self) -> bool:
        """True if the controller remembers its own commands."""
        return self.reads_commands or not (self.adaptation is None or self.adaptation.integrates)

    @property
    def real(self) -> Plant:
        """The plant that is simulated."""
        return self.truth or self.plant

    @property
    def blind(self) -> bool:
        """True if the controller of a plant that declares its delay takes it for 0: it does not predict."""
        return self.plant.declares_delay and self.D_hat is not None and not np.any(self.D_hat)

    @property
    def reads_commands(self) -> bool:
        """True if the controller reads the actuator state from its own commands."""
        return self.actuator == acts.HISTORY

    @property
    def on_a_clock(self) -> bool:
        """True if calls, samples and commands each have their times, as where the controller judges samples that do
        not come at its steps.
        """
        sees, alone = self.measurement, self.predictor is None or self.plant.declares_delay
        judges = self.reads_commands and sees.observer is None and not alone and not on_steps(sees, self.dt)
        return judges or any(part is not None for part in (self.timing, self.observer, self.watchdog))

    @classmethod
    def of(cls, call: str, unused: tuple[str, ...], parts: dict[str, Any]) -> Self:
        """The loop of a call's arguments. Raises ConfigError for a name that it does not have, or cannot use there."""
        names = [field.name for field in fields(cls) if field.name not in unused]
        for name in parts:
            if name not in names:
                what = f"expected a part of the loop, one of {', '.join(names)}"
                raise ConfigError(f"{call}: {what}, got {name!r}{similar(name, names) or '; leave it out'}")
        if parts.get("measurement", 0) is None:
            del parts["measurement"]
        return cls(**parts)


class ControllerParts(TypedDict, total=False):
    """The parts of a Loop that a controller takes besides the arguments that stand in its signature."""

    input_bounds: Any
    u0: Any
    actuator: Actuator
    observer: Observer | None
    watchdog: Watchdog | None
    safety: SafetyFilter | None
    outlier_limit: float | None
    max_sample_age: float | None
    history_length: float | None


class LoopParts(ControllerParts, total=False):
    """The parts of a Loop that a simulation takes besides the arguments that stand in its signature."""

    measurement: Measurement | None
    truth: Plant | None
    disturbance: Callable[[float], Any] | None
    setpoints: Any
    timing: Timing | None
    integrator: str
