"""What every law for the delay estimate is: a rate D_hat', kept within bounds."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from npred import array_checks
from npred.errors import ConfigError
from npred.plants.base import Plant
from npred.symbolic import source_lines


@dataclass(frozen=True)
class DelayLaw(ABC):
    """D_hat' = Proj_[bounds]{D_hat, rate}: a law of one's own is a subclass with `rate`, in NumPy.

    gamma > 0 is the adaptation gain, b > 0 weighs w, bounds are in seconds: a pipeline's, of which `rate` uses what it
    needs. simulate, controller and the stages of a pipeline take it; it runs in Python, batch by batch.
    Raises ConfigError for a gain, b or bounds that make no sense.
    """

    gamma: float = 1.0
    b: float = 1.0
    bounds: tuple[float, float] = (0.1, 4.0)

    def __post_init__(self) -> None:
        gains = array_checks.floats("adaptation: gamma, b", (self.gamma, self.b))
        if not (gains > 0).all() or not np.isfinite(gains).all():
            raise ConfigError(f"adaptation: expected gamma > 0 and b > 0, got gamma = {self.gamma}, b = {self.b}")
        bounds = array_checks.floats("adaptation: bounds", self.bounds)
        if bounds.shape != (2,) or not 0 <= bounds[0] <= bounds[1] < np.inf:
            raise ConfigError(f"adaptation: expected bounds 0 <= low <= high, got {self.bounds}; swap or fix them")

    def check(self, plant: Plant) -> None:  # noqa: B027  a law that serves every plant has nothing to refuse
        """Raise ConfigError where the law is not for this plant; asked before anything runs."""

    @abstractmethod
    def rate(
        self, plant: Plant, X: np.ndarray, u: np.ndarray, P: np.ndarray, D_hat: np.ndarray, t: float
    ) -> Any:  # fmt: skip
        """D_hat' (B,) of B loops side by side: X (B, n), u (B, nx, m), P (B, nx, n), D_hat (B,), t in seconds.

        u has its values at the nodes. plant.f, plant.kappa and plant.V work on these arrays. The estimate is clipped
        to the bounds after each step.
        """


def interpreted(law: DelayLaw, plant: Plant) -> Callable[..., None]:
    """The law on the loop's memory: phi = rate, N unknown."""

    def step(P: Any, X: Any, u: Any, D_hat: Any, t: float, p: Any, b: float, phi: Any, N: Any) -> None:
        seen = [X.T, u.transpose(2, 0, 1), P.transpose(2, 0, 1), D_hat.view()]
        for view in seen:
            view.flags.writeable = False  # it is the loop's own memory
        phi[:] = _rates(law, plant, seen, t)

    return step


def _rates(law: DelayLaw, plant: Plant, seen: list[np.ndarray], t: float) -> np.ndarray:
    """D_hat' (B,) or one for all. Raises ConfigError, with the line of the law's file, where the law fails."""
    X, u, P, D_hat = seen
    try:
        given = law.rate(plant, X, u, P, D_hat, t)
        rates = np.asarray(given, dtype=float)
    except ConfigError:
        raise
    except Exception as error:
        raise ConfigError(
            f"{_place(law)} failed{source_lines.where(error, law.rate)}: {source_lines.one_line(error)}; fix it"
        ) from None
    if given is None or not array_checks.fits(rates.shape, D_hat.shape):
        found = None if given is None else rates.shape
        raise ConfigError(f"{_place(law)} expected to return {D_hat.shape}, one per loop, got {found}; fix it")
    return rates


def _place(law: DelayLaw) -> str:
    return f"adaptation {type(law).__name__}: rate ({source_lines.line(law.rate)})"
