"""Successive approximations."""

from collections.abc import Callable

import numpy as np

from npred.base.errors import DivergedError
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods.base import Compiled


class Picard(Compiled):
    """P ← X + D_hat ∫₀ˣ f(P, u) dy by the trapezoidal rule until no node changes by over `tolerance` (1 + max |P|).

    Order 2. The contraction needs about e D_hat C_f sweeps; on long horizons of unstable plants it may not come: then
    the call raises DivergedError (in the loop: the lane becomes NaN). For one delay: ConfigError where inputs
    have several. Karafyllis, Krstic, Predictor Feedback, ch. 4.
    """

    name, order = "picard", 2

    def __init__(self, plant: Plant, nx: int = 101, tolerance: float = 1e-12, sweeps: int = 200):
        super().__init__(plant, nx)
        problem_of(plant).needs(self.name)
        self.tolerance, self.sweeps = tolerance, sweeps

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray | float) -> np.ndarray:
        P = super().predict(X, u, D_hat, t)
        failed = ~np.isfinite(P).all(axis=(1, 2))
        if failed.any():
            raise DivergedError(
                f"picard: expected a change below {self.tolerance:g} within {self.sweeps} sweeps, got none for "
                f"{failed.sum()} of {len(X)} calls (D_hat = {D_hat[failed][0]:g}); use rk4, or raise sweeps"
            )
        return P

    def compile(self) -> Callable[..., None]:
        return problem_of(self.plant).picard(self.tolerance, self.sweeps)
