"""Successive approximations."""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred.errors import DivergedError
from npred.plants.base import Plant
from npred.plants.black_box import BlackBox
from npred.predictors import array_predictors
from npred.predictors.base import SIGNATURE, Compiled
from npred.symbolic import called_functions, kernels, programs

SOURCE = """\
def picard(X, u, D_hat, t, p, P):
    nx, n, lanes = P.shape
    {parameters}
    before, total = np.empty(n), np.empty(n)
    for l in range(lanes):
        h = D_hat[l] / (nx - 1)
        for j in range(nx):
            for c in range(n):
                P[j, c, l] = X[c, l]
        for _ in range(SWEEPS):
            change = size = 0.0
            for j in range(nx):
                {node}
                for c in range(n):
                    y = X[c, l] if j == 0 else total[c] + h / 2 * (before[c] + f[c])
                    change, size = max(change, abs(y - P[j, c, l])), max(size, abs(y))
                    total[c], before[c], P[j, c, l] = y, f[c], y
            if change <= TOLERANCE * (1.0 + size):
                break
        else:
            P[:, :, l] = np.nan
"""


class Picard(Compiled):
    """P ← X + D_hat ∫₀ˣ f(P, u) dy by the trapezoidal rule until no node changes by over `tolerance` (1 + max |P|).

    Order 2. The contraction needs about e D_hat C_f sweeps; on long horizons of unstable plants it may not come: then
    the call raises DivergedError (in the loop: the lane becomes NaN). For one delay: ConfigError where inputs have
    delays of their own. Karafyllis, Krstic, Predictor Feedback, ch. 4.
    """

    name, order = "picard", 2

    def __init__(self, plant: Plant, nx: int = 101, tolerance: float = 1e-12, sweeps: int = 200):
        super().__init__(plant, nx)
        plant.needs_one_delay("picard", "use rk4")
        self.tolerance, self.sweeps = tolerance, sweeps

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        P = super().predict(X, u, D_hat, t)
        failed = ~np.isfinite(P).all(axis=(1, 2))
        if failed.any():
            raise DivergedError(
                f"picard: expected a change below {self.tolerance:g} within {self.sweeps} sweeps, got none for "
                f"{failed.sum()} of {len(X)} calls (D_hat = {D_hat[failed][0]:g}); use rk4, or raise sweeps"
            )
        return P

    def compile(self) -> Callable[..., None]:
        if isinstance(self.plant, BlackBox):
            return array_predictors.picard(self.plant, self.tolerance, self.sweeps)
        n, m = self.plant.n, self.plant.m
        trace = called_functions.trace(self.plant)
        y = trace.f(trace.vector("x", n), trace.vector("a", m), trace.input("t"))
        names = {f"x{k}": f"P[j, {k}, l]" for k in range(n)} | {f"a{k}": f"u[j, {k}, l]" for k in range(m)}
        node = programs.lines(y, names | {"t": "(t + j * h)"}, [f"f{k}" for k in range(n)])
        node.append(f"f = ({', '.join(f'f{k}' for k in range(n))},)")
        source = SOURCE.replace("SWEEPS", str(self.sweeps)).replace("TOLERANCE", repr(self.tolerance))
        source = kernels.fill(source, parameters=kernels.parameters(len(self.plant.p)), node=node)
        return kernels.build("picard", SIGNATURE, source, called_functions.imports(trace))
