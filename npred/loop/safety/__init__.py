"""A control barrier function of the predicted state [Ames et al., IEEE TAC 62 (2017) 3861; with input delay, Jankovic,
ACC 2018, 5200]: U is changed as little as keeps safe(x, t, p, M) >= 0.

With P the state at the time when U acts, h = safe(P, t + D), and ψ_0 = h, ψ_j = ψ_j-1' + α ψ_j-1 up to the first one
whose derivative U moves [Xiao, Belta, IEEE TAC 67 (2022) 3655], U is the nearest to kappa(P), in widths of its
bounds, with ψ' + α ψ >= margin.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError

if TYPE_CHECKING:
    from npred.kernels.kernel import Kernel
    from npred.plants.base import Plant


@dataclass(frozen=True)
class SafetyFilter:
    """U as near to kappa(P) as keeps the limits that the plant declares by safe(x, t, p, M) -> [h, ...] at h >= 0.

    U is held over a control step: the conditions are kept at both ends of it, to second order in dt. Distances of U are
    in units of its bounds' width. Where the bounds of U leave no room, the missed conditions, in units of what U can
    change, have the least sum of squares.

    Raises ConfigError for numbers that make no sense.
    """

    alpha: float = 1.0  #: how fast a limit may be approached, h' >= -alpha h, in 1 / time; at most 1 / dt
    margin: float = 0.0  #: added to that condition, in units of h / time^r if U moves the derivative r of h first
    delay: float = 0.0  #: how wrong D_hat may be, in the plant's unit of time; above 0 with actuator = "history"

    def __post_init__(self) -> None:
        for name, room in (("alpha", "above 0"), ("margin", "of at least 0"), ("delay", "of at least 0")):
            value = array_checks.number(f"safety: {name}", getattr(self, name))
            if not math.isfinite(value) or value < 0 or (name == "alpha" and value == 0):
                raise ConfigError(f"safety: expected {name} {room}, got {value:g}; give another")

    @property
    def ends(self) -> int:
        """How many predicted states the conditions are kept in."""
        return 3 if self.delay else 1

    def check(self, plant: "Plant", dt: float) -> None:
        """Raise ConfigError for a plant without limits, or of a kind that this filter does not serve."""
        if not plant.declares_safe:
            raise ConfigError(
                f"safety: expected a plant with safe(x, t, p, M), which is at least 0 where it is safe, "
                f"plant {plant.name} has none; write it"
            )
        if not plant.traced or not plant.one_delay or plant.declares_delay:
            raise ConfigError(
                f"safety: expected a traced plant with one constant delay, plant {plant.name} is of another kind; "
                "keep its limits in kappa"
            )
        if self.alpha * dt > 1:
            raise ConfigError(f"safety: expected alpha up to 1 / dt, {1 / dt:g}, got {self.alpha:g}; lower it")
        self.kernel(plant)

    def settings(self, dt: float, input_bounds: np.ndarray) -> dict[str, Any]:
        """The settings of a loop with it."""
        widths = np.ptp(np.asarray(input_bounds, dtype=float), axis=1)
        widths = np.where(np.isfinite(widths) & (widths > 0), widths, 1.0)
        numbers = np.array([self.alpha, self.margin, dt, *widths])
        return {"safety": numbers, "end_count": self.ends, "uncertain": float(self.delay)}

    def sizes(self, nx: int) -> dict[str, int]:
        """The sizes of its signals."""
        return {"ends": self.ends, "protected": nx}

    def kernel(self, plant: "Plant") -> "Kernel":
        """npred.prediction.delays.problem.PROTECT of the plant."""
        from npred.loop.safety.filter import kernel  # brings what compiles, which reading a pipeline has no use for

        return kernel(plant, self.ends)
