"""The published law for an actuator state that is not measured [Bhan, Krstic, Shi, arXiv:2509.26443, eq. 82]."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from npred.delays import family, family_of
from npred.delays.family import Kernel
from npred.errors import ConfigError
from npred.loop.delay_law import DelayLaw
from npred.plants.base import Plant
from npred.symbolic import kernels, programs
from npred.symbolic.trace import Trace

# w = u - kappa(P) and q3 = kappa_P f(P(0), u(0)) at the nodes; derivatives by central differences, one-sided at ends.
UPDATE = """\
    nx, n, lanes = P.shape
    m = u.shape[1]
    {parameters}
    w, q = np.empty((nx, m)), np.empty((nx, m))
    dx = 1.0 / (nx - 1)
    for l in range(lanes):
        for j in range(nx):
            h = D_hat[l] / (nx - 1)
            {node}
        total = 0.0
        for c in range(m):
            for j in range(nx):
                a, z = max(j - 1, 0), min(j + 1, nx - 1)
                w_x, q_x = (w[z, c] - w[a, c]) / ((z - a) * dx), (q[z, c] - q[a, c]) / ((z - a) * dx)
                weight = (1.0 + j * dx) * dx * (0.5 if j == 0 or j == nx - 1 else 1.0)
                total += weight * (q[j, c] * w[j, c] / (abs(w[j, c]) + EPSILON) + q_x * w_x / (abs(w_x) + EPSILON))
            total += 2.0 * w_x / (abs(w_x) + EPSILON) * q[nx - 1, c]
        phi[l], N[l] = total, np.nan
"""


@dataclass(frozen=True)
class L1Adaptation(DelayLaw):
    """D_hat' = gamma Proj_[bounds]{D_hat, phi}, fed with the controller's own commands û(x) = U(t + D_hat (x - 1)):

        phi = 2 sgn(w_x(1)) q3(1) + ∫₀¹ (1 + x) [q3 sgn(w) + q3_x sgn(w_x)] dx,
        w = û - kappa(P),   q3(x) = kappa_P(P(x)) f(P(0), û(0)),

    summed over the inputs, with w / (|w| + epsilon) for sgn: near rest w is a rounding error of the grid, and its sign
    noise, which a law without that width answers at full speed; epsilon = 0 is the published law. It converges
    locally, from estimates near the delay, and has no limit as dt goes to 0 (docs/delay_laws.md); b has no meaning
    here.
    Raises ConfigError for a gain or bounds that make no sense.
    """

    epsilon: float = 0.05

    def check(self, plant: Plant) -> None:
        """Raise ConfigError where the plant is not traced, or has no one delay to estimate, as for the paper's law."""
        family_of(plant).needs("adaptation")
        if not plant.traced:
            raise ConfigError(
                f"adaptation L1Adaptation: expected a plant that is traced, {plant.name} says traced = False; "
                "take DelayAdaptation"
            )

    def rate(
        self, plant: Plant, X: np.ndarray, u: np.ndarray, P: np.ndarray, D_hat: np.ndarray, t: float
    ) -> np.ndarray:  # fmt: skip
        """gamma phi, (B,)."""
        arrays = [np.array(np.moveaxis(a, 0, -1), order="C") for a in (P, X, u, D_hat)]
        phi, N = np.empty(len(D_hat)), np.empty(len(D_hat))
        _kernel(plant, self.epsilon)(*arrays, t, plant.p, self.b, phi, N)
        return self.gamma * phi

    def kernel(self, plant: Plant) -> Kernel:
        return _kernel(plant, self.epsilon)


def _kernel(plant: Plant, epsilon: float) -> Kernel:
    n, m, trace = plant.n, plant.m, Trace(plant)
    start, u_start, t = trace.vector("y", n), trace.vector("v", m), trace.input("t")
    x, u, now = trace.vector("x", n), trace.vector("u", m), trace.input("s")
    q = trace.dkappa(x, now, trace.f(start, u_start, t))
    w = u - trace.kappa(x, now)
    names: dict[str, Any] = {f"x{k}": f"P[j, {k}, l]" for k in range(n)} | {f"y{k}": f"P[0, {k}, l]" for k in range(n)}
    names |= {f"u{c}": f"u[j, {c}, l]" for c in range(m)} | {f"v{c}": f"u[0, {c}, l]" for c in range(m)}
    node = programs.lines([*w, *q], names | {"s": "(t + j * h)"}, [f"{v}[j, {c}]" for v in "wq" for c in range(m)])
    text = UPDATE.replace("EPSILON", repr(epsilon or 1e-300))
    source = kernels.fill(text, parameters=kernels.parameters(len(plant.p)), node=node)
    return family.build("l1", family.UPDATE, source)
