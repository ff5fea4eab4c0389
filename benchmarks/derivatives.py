"""What the published notebook's two wrong derivatives do to the loop of the update law, and what a network does to phi.

    python benchmarks/derivatives.py [MODEL ...]

With MODELs, as pipeline/paper.toml:deeponet, it prints of each the error of D_hat' on held-out rows, for the network's
P_hat stands in the place of P in [DAPF, eqs. 12-14]. Otherwise, the notebook:
∂f1/∂x2 has x2² in the place of x2; ∂κ/∂x1 has 1 added and lacks a factor x1. All else is npred's: RK4, exact transport.
Before t = 0 the input is 0, as there. The law with the right derivatives, by the same code, is the reference; npred's
compiled one is the same law.
"""

import sys
from typing import Any

import harness
import numpy as np

import npred
from npred.base import grid
from npred.lab import config
from npred.lab.config import conditions
from npred.lab.report.terminal.console import columns
from npred.loop import metrics

FIRST = (0.3, 0.5, 1.0, 1.5, 2.0, 3.5)  # s: D_hat(0)


class ByHand(npred.DelayAdaptation):
    """The law of [DAPF, eqs. 11-14] with derivatives written by hand, right or as the notebook has them."""

    wrong = False

    def rate(self, plant: Any, X: Any, u: Any, P: Any, D_hat: Any, t: float) -> np.ndarray:
        """gamma phi: the integrals by the trapezoidal rule, Phi f(P(0)) by Heun's method, as the compiled law."""
        x, w = np.linspace(0, 1, P.shape[1]), u[..., 0] - plant.kappa(P)[..., 0]
        q1 = self.q1(plant, P, u, D_hat / (len(x) - 1))
        V, (top, bottom) = plant.V(X), (np.trapezoid((1 + x) * y, x) for y in (q1 * w, w**2))
        return -self.gamma * top / (1 + V + self.b * bottom)

    def q1(self, plant: Any, P: np.ndarray, u: np.ndarray, h: np.ndarray) -> np.ndarray:
        """kappa'(P) r, r' = D_hat f_P r, r(0) = f(P(0), u(0)): (B, nx)."""
        f_P, kappa_P = self.derivatives(plant, *np.moveaxis(P, -1, 0))
        r, s, rows = plant.f(P[:, 0], u[:, 0]), 0.0, []
        for j in range(P.shape[1]):
            if j:
                r = r + (s + h[:, None] * np.einsum("bij,bj->bi", f_P[:, j], r + s)) / 2
            s = h[:, None] * np.einsum("bij,bj->bi", f_P[:, j], r)
            rows.append(np.einsum("bj,bj->b", kappa_P[:, j], r))
        return np.stack(rows, axis=1)

    def derivatives(self, plant: Any, x1: np.ndarray, x2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """f_P (B, nx, 2, 2) and kappa' (B, nx, 2)."""
        K1, K2, Ka, Kb = plant.p[:4]
        size = 1 + x1**2 + x2**2
        steep, flat = 2 * K1 * x1 / size, 2 * (K1 * x1**2 + Ka) / size**2
        f1 = np.stack([steep - x1 * flat, -x2 * flat], axis=-1)
        f2 = 2 * x1 * (K2 - Kb) / (1 + x1**2) ** 2
        to_x2, kappa_P = f1[..., 1], -f1
        if self.wrong:
            to_x2, kappa_P = -(x2**2) * flat, np.stack([1 - steep + flat, x2 * flat], axis=-1)
        f_P = np.stack([f1[..., 0] - 1, to_x2, f2, np.full_like(f2, -0.5)], axis=-1)
        return f_P.reshape(*f2.shape, 2, 2), kappa_P


class Notebook(ByHand):
    """With the notebook's two mistakes."""

    wrong = True


def of_networks(models: list[str]) -> None:
    """gamma |phi(P_hat) - phi(P)| in seconds per second, P by RK4; gamma and b as the pipeline evaluates."""
    rows = []
    for model in models:
        network, pipeline = npred.load(model), model.rpartition(":")[0]
        data = harness.samples(model, None).subset(test=True)
        law = conditions.adaptation(config.load(pipeline).evaluate, network.plant)
        u = grid.refine(data.u, network.nx)
        exact = npred.predictor(network.plant, "rk4", network.nx)(data.X, u, data.D_hat)
        both = network(data.X, u, data.D_hat), exact
        ours, right = (law.rate(network.plant, data.X, u, P, data.D_hat, 0.0) for P in both)
        gap, largest = np.abs(ours - right), np.abs(right).max()
        rows.append([model, str(len(gap)), *(f"{value:.2g}" for value in (gap.max(), np.median(gap), largest))])
    print(columns(["network", "rows", "largest error of D_hat'", "median", "largest |D_hat'|"], rows))


def main() -> None:
    if sys.argv[1:]:
        of_networks(sys.argv[1:])
        return
    plant = npred.plant("activator_repressor")
    rk4 = npred.predictor(plant, "rk4", nx=51)
    laws = {"compiled": npred.DelayAdaptation, "right, by hand": ByHand, "the notebook's": Notebook}
    rows = []
    for bounds in (None, [[0.0, np.inf]]):
        for name, law in laws.items():
            loops = npred.simulate(
                plant, rk4, D=1.0, D_hat=FIRST, X0=[0.03, 30.0], t_end=100.0, dt=1 / 300, input_bounds=bounds,
                u0=[0.0], adaptation=law(gamma=1000.0, b=1.0, bounds=(0.1, 4.0)),
            )  # fmt: skip
            target = plant.target(loops.t)
            radius, settled = metrics.radius(loops, target), metrics.settle_time(loops, target)
            for i, D_hat0 in enumerate(FIRST):
                found = f"{radius[i]:.1e}", f"{settled[i]:.1f}", f"{loops.D_hat[i, -1]:.3f}"
                rows.append(["U >= 0" if bounds else "no clip", f"{D_hat0:g}", name, *found])
    print(columns(["", "D_hat(0)", "law", "radius", "settled, s", "D_hat at the end"], sorted(rows)))


if __name__ == "__main__":
    main()
