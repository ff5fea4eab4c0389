"""What a delay model is to the predictors and the loop: five kernels for the prediction problem of one plant.

The problem is dP/dx = D_hat f(P, u(x), t + x D_hat), P(0) = X on x in [0, 1] [DAPF, eq. 10], and U = kappa(P) at its
end. Arrays have their lanes innermost, so that B loops share each instruction.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from npred.plants.base import Plant

Kernel = Callable[..., None]
Step = Callable[..., Any]  # the formula of a one-step method: npred.predictors.onestep

# X (n, B), u (nx, m, B), D_hat (B,), t, p -> P (nx, n, B)
PREDICT = "void(float64[:,::1], float64[:,:,::1], float64[::1], float64, float64[::1], float64[:,:,::1])"
# P (nx, n, B), u (nx, m, B), D_hat (B,), t, p -> U (m, B)
CONTROL = "void(float64[:,:,::1], float64[:,:,::1], float64[::1], float64, float64[::1], float64[:,::1])"
# P (nx, n, B), X (n, B), u at the nodes (nx, m, B), D_hat (B,), t, p, b -> phi (B,), N (B,)
UPDATE = (
    "void(float64[:,:,::1], float64[:,::1], float64[:,:,::1], float64[::1], float64, float64[::1], float64, "
    "float64[::1], float64[::1])"
)
# X (n, B), the delayed input U0 for the first `share` of a step, then U1 (m, B), dt, t, p -> X
ADVANCE = "void(float64[:,::1], float64[:,::1], float64[:,::1], float64[:,::1], float64, float64, float64[::1])"


class Family(ABC):
    """The kernels of one plant. What a family lacks it refuses by ConfigError, with what to do instead."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant

    @staticmethod
    @abstractmethod
    def serves(plant: Plant) -> bool:
        """Whether the family is that of the plant."""

    @abstractmethod
    def sweep(self, step: Step) -> Kernel:
        """PREDICT by a one-step method over the nodes."""

    @abstractmethod
    def picard(self, tolerance: float, sweeps: int) -> Kernel:
        """PREDICT by successive approximations."""

    @abstractmethod
    def control(self, step: Step) -> Kernel:
        """CONTROL, U = kappa(P(1)) [DAPF, eq. 9]; `step` predicts between nodes where a delay ends there."""

    @abstractmethod
    def update(self) -> Kernel:
        """UPDATE, the paper's law for D_hat: phi [DAPF, eq. 12] and N = 1 + V + b ∫ (1+x) w²."""

    @abstractmethod
    def advance(self, step: Step) -> Kernel:
        """ADVANCE, a step of the plant with held inputs, split where a switch of a delayed input falls inside it."""


def transition(df: Any, x: Any, u: Any, t: Any, h: Any, r: Any, s: Any) -> tuple[Any, Any]:
    """One step of dr/dx = D_hat (f_P r + f_t) by Heun's method: r at this node, and s = h (f_P r + f_t) for the next.

    x, u are of this node; r, s of the one before; h = D_hat / (nx - 1); df(x, u, t, r) is f_P r + f_t.
    """
    new = r + (s + h * df(x, u, t, r + s)) / 2
    return new, h * df(x, u, t, new)
