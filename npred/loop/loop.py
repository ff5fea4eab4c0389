"""One description of a loop: what is simulated, what a controller is made of, and what a pipeline's tables say."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Self, TypedDict

from npred.base.errors import ConfigError, similar
from npred.estimation.delay_law import DelayLaw
from npred.estimation.observers import Observer
from npred.loop.measurement import Measurement
from npred.loop.safety import SafetyFilter
from npred.loop.timing import Timing
from npred.loop.watchdog import Watchdog
from npred.plants.base import Plant
from npred.prediction.methods import Predictor

MEASURED, HISTORY = "measured", "history"  # where the controller has the actuator state from

PERFECT = Measurement()


@dataclass(frozen=True, kw_only=True)
class Loop:
    """X' = f(X, U(t - D)), U = kappa(P(1)), D_hat' = gamma Proj{D_hat, phi} [DAPF, eqs. 6-14]: all parts of it.

    The controller has `plant` as its model, `predictor`, `dt` (control step, in the plant's unit of time), `adaptation`
    and `D_hat` (law and first value of the estimate), `input_bounds` (m, 2), `u0` (commands before t = 0), `actuator`
    ("measured" or "history"), `observer`, `watchdog` and `safety`; `outlier_limit` and `max_sample_age` say which
    samples it believes and uses, `history_length` how long it keeps its commands.

    A simulation has a plant too, `truth`, with the delay `D`, the start `X0` (..., n), sensors (`measurement`), the
    clock of the calls (`timing`), a `disturbance` of the input, a function of t, and an `integrator`.
    """

    plant: Plant
    predictor: Predictor | None
    dt: float = 0.005
    adaptation: DelayLaw | None = None
    D_hat: Any = None
    input_bounds: Any = None
    u0: Any = None
    actuator: str = MEASURED
    observer: Observer | None = None
    watchdog: Watchdog | None = None
    safety: SafetyFilter | None = None
    outlier_limit: float | None = 1.0
    max_sample_age: float | None = None
    history_length: float | None = None
    D: Any = None
    X0: Any = None
    measurement: Measurement = PERFECT
    truth: Plant | None = None
    disturbance: Callable[[float], Any] | None = None
    timing: Timing | None = None
    integrator: str = "rk4"

    @property
    def real(self) -> Plant:
        """The plant that is simulated."""
        return self.truth or self.plant

    @classmethod
    def of(cls, call: str, unused: tuple[str, ...], parts: dict[str, Any]) -> Self:
        """The loop of a call's arguments. Raises ConfigError for a name that it does not have, or cannot use there."""
        known = [field.name for field in fields(cls) if field.name not in unused]
        for name in parts:
            if name not in known:
                what = f"expected a part of the loop, one of {', '.join(known)}"
                raise ConfigError(f"{call}: {what}, got {name!r}{similar(name, known) or '; leave it out'}")
        if parts.get("measurement", 0) is None:
            del parts["measurement"]
        return cls(**parts)


class ControllerParts(TypedDict, total=False):
    """The parts of a Loop that a controller takes besides the arguments that stand in its signature."""

    input_bounds: Any
    u0: Any
    actuator: str
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
    timing: Timing | None
    integrator: str


# parts that only a simulation has
REALITY = ("D", "X0", *sorted(LoopParts.__annotations__.keys() - ControllerParts.__annotations__.keys()))
