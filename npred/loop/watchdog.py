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

    @property
    def holds(self) -> bool:
        """Whether it keeps the last U."""
        return isinstance(self.then, str) and self.then == "hold"

    def rescue(self, m: int) -> np.ndarray:
        """The U (m,) that it declares; zeros where that is the last one or a law's. Raises ConfigError for others."""
        if isinstance(self.then, str) or callable(self.then):
            return np.zeros(m)
        U = _one_per_input("then", self.then, m)
        array_checks.finite("watchdog: then", U)
        return U

    def jumps(self, m: int) -> np.ndarray:
        """How far each input may move in a call, (m,)."""
        return np.full(m, np.inf) if self.jump is None else _one_per_input("jump", self.jump, m)

    def law(self, plant: Plant) -> Kernel | Callable[..., None] | None:
        """npred.prediction.delays.problem.CONTROL of its law, or None."""
        if not callable(self.then):
            return None
        declaration = type("Rescue", (plant.declaration,), {"kappa": staticmethod(self.then)})
        return problem_of(make(plant.name, declaration, plant.parameters)).control(RK4.step)


def _one_per_input(name: str, value: Any, m: int) -> np.ndarray:
    numbers = array_checks.floats(f"watchdog: {name}", value)
    if not array_checks.fits(numbers.shape, (m,)):
        raise ConfigError(f"watchdog: expected one number or {m} as {name}, one per input, got {value!r}; give them")
    return np.array(np.broadcast_to(numbers, (m,)))
