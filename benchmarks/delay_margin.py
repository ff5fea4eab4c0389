"""The margin of a constant delay estimate, and the longest delay without prediction: by the spectrum, and where
simulated loops begin to be lost.

    python benchmarks/delay_margin.py [--steps 500]
    python benchmarks/delay_margin.py --gain

The controller predicts by a constant D_hat from its own commands, with a control step of D / steps. Loops begin near
rest. A loop is lost where its distance from rest grows, later against earlier, over the last 40 % of LENGTH D, or is
FAR times the first one there, as in a cycle that bounds of U limit. Nothing of the spectrum is in the search: errors
of D_hat grow from 1 % of D until a loop is lost, and that interval is divided until it is narrower than 0.05 % of the
error.

--gain: of the paper's plant, D = 1 s, how far an error e of U = kappa(P(1)) moves the loop. By the linearised loop:
the largest |X - X*| per unit of a small e that oscillates, over its frequencies, for constant D_hat; a constant e gives
metrics.gain. By simulation: square waves at constant D_hat, and a constant e with the paper's law, from 64 starts of
the box, where e moves D_hat too.
"""

import harness
import numpy as np
from plants import TwoDelays
from scipy.linalg import expm

import npred
from npred.loop import metrics
from npred.plants import Plant
from npred.prediction.methods.base import Predictor

CASES = (
    (npred.plant("scalar"), 1.0), (npred.plant("activator_repressor"), 1.0), (npred.plant("strict_feedforward2"), 1.0),
    (npred.plant("van_der_pol"), 1.0), (npred.plant("chemostat"), 1.5), (npred.plant("cart_pole"), 0.3),
    (npred.plant("pvtol"), 0.5), (Plant("two delays", TwoDelays), 1.0),
)  # fmt: skip
LENGTH, NEAR, NODES = 80.0, 1e-5, 201  # D; the distance from rest at the start; of the predictor
FAR = 100.0  # times the first distance
FIRST, GROWTH, MOST = 0.01, 1.3, 22  # of D: the first error, then so many times more, so often
WIDTH, PARTS = 5e-4, 9  # of the error, where the search ends; loops side by side


def grows(plant: Plant, D: float, errors: np.ndarray, dt: float, predicts: bool = True) -> np.ndarray:
    """Whether small states grow, for each error of D_hat; without prediction for each D."""
    rest, delays = plant.equilibrium, {"D": D, "D_hat": D + errors} if predicts else {"D": errors, "D_hat": 0.0}
    loop = npred.simulate(
        plant, npred.predictor(plant, "rk4", NODES), **delays, t_end=LENGTH * D, dt=dt, every=5,
        X0=rest + NEAR * np.maximum(1, np.abs(rest)), u0="equilibrium", actuator="history", progress=False,
    )  # fmt: skip
    gaps, count = np.abs(loop.X - rest).max(axis=-1), len(loop.t)
    gaps = np.where(np.isfinite(gaps), gaps, np.inf)
    earlier, later = (gaps[:, int(a * count) : int(b * count)].max(axis=1) for a, b in ((0.6, 0.8), (0.8, 1.0)))
    return (later > np.maximum(earlier, NEAR**2)) | (later > FAR * gaps[:, 0])


def simulated(plant: Plant, D: float, side: int, steps: int) -> float:
    """The least error of that sign at which loops are lost, of 0 the least D without prediction; infinite if none."""
    predicts, side = side != 0, side or 1
    errors = side * D * FIRST * GROWTH ** np.arange(MOST + 1)
    errors = errors[errors > -D]
    lost = grows(plant, D, errors, D / steps, predicts)
    if not lost.any():
        return side * np.inf
    first = int(np.argmax(lost))
    low, high = errors[first - 1] if first else 0.0, errors[first]
    while abs(high - low) > WIDTH * abs(high):
        inner = np.linspace(low, high, PARTS + 2)
        lost = grows(plant, D, inner[1:-1], D / steps, predicts)
        first = int(np.argmax(lost)) if lost.any() else PARTS
        low, high = inner[first], inner[first + 1]
    return (low + high) / 2


HELD = (1.0, 1.196, 1.35, 1.5)  # s: constant estimates
FREQUENCIES = np.linspace(1e-4, 20.0, 20_001)  # rad/s


def amplitudes(plant: Plant, D: float, D_hat: float, measured: bool) -> np.ndarray:
    """|X / e| at each frequency: X' = A X + B u(0), U = K P(1) + e, P(1) = e^{A D_hat} X + D_hat ∫ e^{A D_hat z} B u.

    u(1 - z) = U e^{-s D z} where u is measured, and U e^{-s D_hat z} where the controller shifts its own commands.
    """
    (closed, B), K = plant.linearised(), plant.kappa_jacobian(plant.equilibrium)
    A, s, eye = closed - B @ K, 1j * FREQUENCIES[:, None, None], np.eye(plant.n)
    acted = np.linalg.solve(s * eye - A, B * np.exp(-s * D))  # X over U
    M, flow = A * D_hat - s * (D if measured else D_hat) * eye, expm(A * D_hat)
    end = flow * np.exp(-s * (D if measured else D_hat))  # e^M
    loop = K @ (flow @ acted + D_hat * np.linalg.solve(M, (end - eye) @ B))
    return np.linalg.norm(acted @ np.linalg.inv(np.eye(plant.m) - loop), 2, axis=(1, 2))


def gains() -> None:
    """Print the largest |X / e| by estimate and actuator."""
    plant, D = npred.plant("activator_repressor"), 1.0
    print(f"gain of a constant error: {metrics.gain(plant):.1f}")
    print("D_hat  actuator  largest |X / e|  at, rad/s")
    for D_hat in HELD:
        for actuator in ("measured", "history"):
            values = amplitudes(plant, D, D_hat, actuator == "measured")
            k = int(np.argmax(values))
            print(f"{D_hat:5g}  {actuator:8}  {values[k]:15.1f}  {FREQUENCIES[k]:9.3f}")
    simulated_gains(plant, metrics.gain(plant))


SIZES, FREQUENCY = (0.001, 0.002, 0.005, 0.01), 0.464  # of e; rad/s, where D_hat = 1.5 s amplifies most


class Off(Predictor):
    """RK4, its P(1) moved along the gradient of kappa until kappa(P(1)) is off by e."""

    name = "off"

    def __init__(self, plant: Plant, e: float) -> None:
        super().__init__(plant, 101)
        self.exact, self.e = npred.predictor(plant, "rk4", 101), e

    def predict(self, X, u, D_hat, t):
        """P, (B, nx, n)."""
        P, kappa = self.exact(X, u, D_hat, t), self.plant.kappa
        end, goal = P[:, -1], kappa(P[:, -1]) + self.e
        for _ in range(8):  # Newton
            K = np.reshape(self.plant.kappa_jacobian(end), end.shape)
            end = end + K * (goal - kappa(end)) / (K**2).sum(axis=-1, keepdims=True)
        P[:, -1] = end
        return P


def simulated_gains(plant: Plant, gain: float) -> None:
    """Print what loops do with errors of different sizes."""
    kappa = plant.declaration.kappa
    print(f"square wave of {FREQUENCY} rad/s and size e, 200 s from rest, u measured: |X - X*| / (gain e)")
    for D_hat in HELD:
        shown = []
        for e in SIZES:

            def off(x, t, p, M, e=e):
                return [kappa(x, t, p, M)[0] + M.where(M.sin(FREQUENCY * t) > 0, e, -e)]

            wrong = plant.controlled(off)
            start = {"X0": plant.equilibrium, "u0": plant.u_equilibrium, "D_hat": D_hat, "adaptation": None}
            loop = npred.simulate(
                wrong, npred.predictor(wrong, "rk4", 101), D=1.0, t_end=200.0, dt=0.01, progress=False, **start
            )
            shown.append(f"{np.abs(loop.X[-5000:] - plant.equilibrium).max() / gain / e:.3g} at {e:g}")
        print(f"  D_hat = {D_hat:g}: {', '.join(shown)}", flush=True)
    print("constant e, the paper's law, D_hat(0) = 2 s, 64 starts of the box, 100 s: |X - X*| / (gain |e|), last 10 s")
    X0 = harness.starts(plant, 64, np.random.default_rng(0))
    law = npred.DelayAdaptation(gamma=1000.0, bounds=(0.1, 4.0))
    for e in [side * e for e in SIZES for side in (-1, 1)]:
        loop = npred.simulate(
            plant, Off(plant, e), D=1.0, D_hat=2.0, X0=X0, t_end=100.0, dt=0.02, adaptation=law, progress=False
        )
        ends = np.abs(loop.X[:, -500:] - plant.equilibrium).max(axis=(1, 2)) / gain / abs(e)
        estimates = f"D_hat from {loop.D_hat[:, -1].min():.2f} to {loop.D_hat[:, -1].max():.2f} s"
        far = f"above 1.5 in {(ends > 1.5).sum()} loops"
        print(f"  e = {e:g}: median {np.median(ends):.2f}, largest {ends.max():.3g}, {far}; {estimates}", flush=True)


def main() -> None:
    """Print a line per plant and side."""
    options = harness.options(__doc__, steps=500, gain=False)
    if options.gain:
        gains()
        return
    print("plant                  D    by the spectrum  by simulation  difference; of D the longest without prediction")
    for plant, D in CASES:
        edges = (*npred.delay_margin(plant, D), npred.delay_margin(plant))
        for what, side, edge in zip(("low", "high", "D"), (-1, 1, 0), edges, strict=True):
            found = simulated(plant, D, side, options.steps)
            print(f"{plant.name:20} {D:5g} {what:4} {edge:11.5f} {found:14.5f} {found / edge - 1:10.2%}", flush=True)


if __name__ == "__main__":
    main()
