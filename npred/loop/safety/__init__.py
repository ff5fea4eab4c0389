"""A predictive safety filter [Wabersich, Zeilinger, Automatica 129 (2021) 109597] on the predicted state: U = kappa(P),
unless the loop that follows would break a limit safe(x, t, p, M) >= margin; see npred/kernels/c/protect.h.
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
    """U = kappa(P), changed only where the loop that follows would break a limit h >= margin that the plant declares by
    safe(x, t, p, M) -> [h, ...].

    Raises ConfigError for numbers that make no sense.
    """

    alpha: float | None = None  #: rate, in 1 / time, at which a broken limit is restored; None: that of kappa
    margin: float = 0.0  #: the least h, in the unit of the limits
    delay: float = 0.0  #: how wrong D_hat may be, in the plant's unit of time; above 0 with actuator = "history"
    horizon: float | None = None  #: how far ahead loops are simulated; by default six of kappa's slowest time constants

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            optional = name in ("alpha", "horizon")
            if not (optional and value is None):
                room, value = "above 0" if optional else "of at least 0", array_checks.number(f"safety: {name}", value)
                if not math.isfinite(value) or value < 0 or (optional and value == 0):
                    raise ConfigError(f"safety: expected {name} {room}, got {value:g}; give another")

    @property
    def ends(self) -> int:
        """The number of predicted states from which the limits are to be kept."""
        return 3 if self.delay else 1

    @staticmethod
    def serves(plant: "Plant") -> bool:
        """True for a traced plant with one constant delay."""
        return plant.traced and plant.one_delay and not plant.declares_delay

    def numbers(self, plant: "Plant", dt: float, input_bounds: np.ndarray) -> dict[str, Any]:
        """The settings of a loop with it."""
        from npred.loop.safety.filter import numbers

        values = numbers(plant, dt, input_bounds, self.margin, self.alpha, self.horizon)
        return {"safety": values, "end_count": self.ends, "uncertain": float(self.delay)}

    def axes(self, plant: "Plant") -> dict[str, int]:
        """The axes of its signals."""
        from npred.loop.safety.filter import remembered

        return {"ends": self.ends, "plan": remembered(plant)}

    def kernels(self, plant: "Plant") -> "dict[str, Kernel]":
        """npred.prediction.delays.problem.PROTECT of the plant."""
        from npred.loop.safety.filter import kernel  # brings what compiles, which reading a pipeline has no use for

        return {"protect": kernel(plant, self.ends)}

    def doubts(self, plant: "Plant", dt: float, values: np.ndarray, input_bounds: np.ndarray) -> list[str]:
        """What a user should know before the first command, of its `numbers`."""
        from npred.loop.safety.filter import survey
        from npred.plants import inputs
        from npred.plants.notation import UNITS

        bounds = tuple(tuple(pair) for pair in inputs.widest(plant, input_bounds).tolist())
        return survey(plant, self.ends, tuple(values.tolist()), bounds).doubts(dt, UNITS.get(plant.time_unit, 1.0))

    def operations(self, plant: "Plant") -> int:
        """Floating-point operations of its longest step at most."""
        from npred.loop.safety.filter import operations

        return operations(plant, self.ends)
