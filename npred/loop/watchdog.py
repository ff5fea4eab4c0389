"""A controller that gets no sample: how long it waits, and the law that it hands over to."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError, unlisted
from npred.kernels.kernel import Kernel
from npred.plants import Plant, make
from npred.prediction.delays import problem_of
from npred.prediction.methods import RK4


@dataclass(frozen=True)
class Watchdog:
    """U is given by `then` while the last used sample is older than `after`.

    Until then, and as long as the watchdog gives U, the model predicts the state.

    Raises ConfigError for a time, numbers or a word that make no sense.
    """

    after: float  #: age of the last used sample, in the plant's unit of time, from which on it acts
    #: "hold", the last U; "zero"; numbers (m,); or a law (x, t, p, M) of the predicted state, compiled and exported too
    then: Any = "hold"
    jump: Any = None  #: how far an input moves in a call while it takes or returns U, or (m,); by default any

    def __post_init__(self) -> None:
        if not 0 < array_checks.number("watchdog: after", self.after) < math.inf:
            raise ConfigError(f"watchdog: expected a time above 0 as after, got {self.after!r}; give a time")
        if isinstance(self.then, str) and self.then not in ("hold", "zero"):
            kind = "numbers, a law or one of"
            raise ConfigError(unlisted("watchdog: then", self.then, ("hold", "zero"), kind))
        if self.jump is not None and not (array_checks.floats("watchdog: jump", self.jump) > 0).all():
            raise ConfigError(f"watchdog: expected numbers above 0 as jump, got {self.jump!r}; None is any distance")

    def numbers(self, plant: Plant, dt: float, input_bounds: np.ndarray) -> dict[str, Any]:
        """The settings of a loop with it. Raises ConfigError for numbers that are not one per input."""
        jump = np.full(plant.m, np.inf) if self.jump is None else _one_per_input("jump", self.jump, plant.m)
        rescue = np.zeros(plant.m)
        if not (isinstance(self.then, str) or callable(self.then)):
            array_checks.finite("watchdog: then", rescue := _one_per_input("then", self.then, plant.m))
        holds = isinstance(self.then, str) and self.then == "hold"
        return {"watched": True, "after": self.after, "holds": holds, "rescue": rescue, "jump": jump}

    def axes(self, plant: Plant) -> dict[str, int]:
        """It has no signals but those of all loops."""
        return {}

    def kernels(self, plant: Plant) -> dict[str, Kernel | Callable[..., None]]:
        """npred.prediction.delays.problem.CONTROL of its law, if it has one."""
        if not callable(self.then):
            return {}
        declaration = type("Rescue", (plant.declaration,), {"kappa": staticmethod(self.then)})
        return {"watchdog_law": problem_of(make(plant.name, declaration, plant.parameters)).control(RK4.step)}


def _one_per_input(name: str, value: Any, m: int) -> np.ndarray:
    numbers = array_checks.floats(f"watchdog: {name}", value)
    if not array_checks.fits(numbers.shape, (m,)):
        raise ConfigError(f"watchdog: expected one number or {m} as {name}, one per input, got {value!r}; give them")
    return np.array(np.broadcast_to(numbers, (m,)))
