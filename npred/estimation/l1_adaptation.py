"""The published law for an actuator state that is not measured [Bhan, Krstic, Shi, arXiv:2509.26443, eq. 82]."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from npred.base.errors import ConfigError
from npred.estimation.delay_law import DelayLaw
from npred.kernels.formula import Formulas, vector
from npred.kernels.kernel import Kernel, made, skeleton
from npred.plants.base import Plant
from npred.prediction.delays import problem, problem_of


@dataclass(frozen=True)
class L1Adaptation(DelayLaw):
    """D_hat' = gamma Proj_[bounds]{D_hat, phi}, fed with the controller's own commands û(x) = U(t + D_hat (x - 1)):

        phi = 2 sgn(w_x(1)) q3(1) + ∫₀¹ (1 + x) [q3 sgn(w) + q3_x sgn(w_x)] dx,
        w = û - kappa(P),   q3(x) = kappa_P(P(x)) f(P(0), û(0)),

    summed over the inputs, with w / (|w| + epsilon) for sgn: near rest w is a rounding error of the grid, and its sign
    noise, which a law without that width answers at full speed; epsilon = 0 is the published law. It converges
    locally, from estimates near the delay, and has no limit as dt goes to 0 (docs/delay_laws.md).

    Parameters
    ----------
    gamma : float above 0, optional
        Adaptation gain, a time; by default a quarter of the upper bound: 1 s for D = 1 s.
    b : float, default 1.0
        Has no meaning here; laws of a pipeline have it.
    bounds : (low, high), in the plant's unit of time, optional
        The range of D_hat; by default 0.1 to 4 times the longest delay of a loop, widened to D and D_hat.
    epsilon : float, default 0.05
        Width of sgn(w), for which w / (|w| + epsilon) is taken; 0 is the published law.

    Raises
    ------
    ConfigError
        For a gain or bounds that make no sense.
    """

    gamma: float = None  # type: ignore[assignment]
    epsilon: float = 0.05

    def suited(self, plant: Plant, D: Any, D_hat: Any) -> Self:
        """The law with the bounds and the gamma that were left out."""
        law = super().suited(plant, D, D_hat)
        return law if law.gamma is not None else law._with("gamma", law.bounds[1] / 4)

    def check(self, plant: Plant) -> None:
        """Raise ConfigError where the plant is not traced, or has no one delay to estimate, as for the paper's law."""
        problem_of(plant).needs("adaptation")
        if not plant.traced:
            what = f"expected a plant that is traced, {plant.name} says traced = False"
            raise ConfigError(f"adaptation L1Adaptation: {what}; take DelayAdaptation")

    def rate(
        self, plant: Plant, X: np.ndarray, u: np.ndarray, P: np.ndarray, D_hat: np.ndarray, t: float
    ) -> np.ndarray:
        """gamma phi, (B,)."""
        arrays = [np.array(np.moveaxis(a, 0, -1), order="C") for a in (P, X, u, D_hat)]
        phi, N = np.empty(len(D_hat)), np.empty(len(D_hat))
        _kernel(plant, self.epsilon)(*arrays, t, plant.p, self.b, phi, N)
        return self.gamma * phi

    def kernel(self, plant: Plant) -> Kernel:
        return _kernel(plant, self.epsilon)


def _kernel(plant: Plant, epsilon: float) -> Kernel:
    n, m, of = plant.n, plant.m, Formulas(plant, ())
    trace = of.trace
    start, u_start, t = trace.vector("y", n), trace.vector("v", m), trace.input("t")
    x, u, now = trace.vector("x", n), trace.vector("u", m), trace.input("s")
    q = trace.dkappa(x, now, trace.f(start, u_start, t))
    w = u - trace.kappa(x, now)
    arguments = [vector("x", n), vector("u", m), vector("y", n), vector("v", m), "s", "t"]
    functions = {"NODE": of.function([*w, *q], arguments, {"wq": 2 * m}, "one")}
    sizes = {"N": n, "M": m, "EPSILON": repr(epsilon or 1e-300)}
    return made("l1", problem.UPDATE, skeleton("l1.h"), functions, sizes, work=lambda nx, lanes, _: 2 * m * nx)
