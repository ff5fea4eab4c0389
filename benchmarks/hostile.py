"""What hostile loops make of a network, bare and guarded: 64 loops a class, 100 s (about three minutes a network).

Usage: python benchmarks/hostile.py [MODEL], by default pipeline/paper.toml:deeponet, which has to be trained. A loop is
lost that ends further from rest than a fifth of |X*|; "extra" are those that the numerical predictor keeps.
"""

import sys
from typing import Any

import numpy as np

import npred
from npred import metrics

B, NX, T_END = 64, 51, 100.0
rng = np.random.default_rng(0)


def pulse(size: float):
    """A disturbance at the input from 20 s to 21 s."""
    return lambda t: size if 20 <= t < 21 else 0.0


def flipped(Y: np.ndarray, t: float, at: set[int]) -> np.ndarray:
    """The measurement, its sign turned at those control steps."""
    return -Y if round(t / 0.005) in at else Y


def classes(plant: npred.plants.Plant) -> dict[str, dict[str, Any]]:
    """The loops of each class, as arguments of npred.simulate."""
    box = np.array([plant.box[name] for name in plant.states])
    X0 = rng.uniform(box[:, 0], box[:, 1], (B, plant.n))
    middle = box.mean(axis=1)
    at = set(rng.integers(1000, 8000, 5).tolist())
    flips = npred.Measurement(observer=lambda X_hat, Y, U, t: flipped(Y, t, at))
    common = {"X0": X0, "D": 1.0, "D_hat": rng.uniform(0.3, 2.5, B)}
    different = {
        "nominal": {},
        "starts from a box 5 times as wide": {"X0": np.abs(middle + 5 * (X0 - middle))},
        "noise 3 %": {"measurement": npred.Measurement(noise=0.03)},
        "noise 5 %": {"measurement": npred.Measurement(noise=0.05)},
        "D̂(0) = 0.1": {"D_hat": 0.1},
        "D̂(0) = 4": {"D_hat": 4.0},
        "D from 2 to 0.25 at 20 s": {"D": lambda t: 2.0 if t < 20 else 0.25},
        "pulse of U + 0.5": {"disturbance": pulse(0.5)},
        "pulse of U − 0.5": {"disturbance": pulse(-0.5)},
        "pulse of U + 1": {"disturbance": pulse(1.0)},
        "pulse of U − 1": {"disturbance": pulse(-1.0)},
        "five samples of X with the sign turned": {"measurement": flips},
    }
    return {name: common | arguments for name, arguments in different.items()}


def outcome(plant, predictor, arguments) -> tuple[np.ndarray, float, float]:
    """Which loops are lost, the largest distance from rest, and the share of steps with the numerical predictor."""
    loops = npred.simulate(plant, predictor, t_end=T_END, adaptation=npred.DelayAdaptation(), every=10, **arguments)
    target = plant.target(loops.t)
    lost = metrics.lost(loops, target)
    return lost, float(np.nan_to_num(np.linalg.norm(loops.X - target, axis=-1), nan=np.inf).max()), loops.fallback_share


if __name__ == "__main__":
    network = npred.load(sys.argv[1] if len(sys.argv) > 1 else "pipeline/paper.toml:deeponet", nx=NX, runtime="fused")
    plant = network.plant
    rk4, guarded = npred.predictor("rk4", plant, NX), npred.guarded(network)
    name, (steps, _) = guarded.reference
    print(f"guarded by the {guarded.by}, {name} on {steps} steps, tolerance {guarded.tolerance:g}")
    print("| class | numerical: lost, peak | bare: extra, peak | guarded: extra, peak, fallback |")
    print("|---|---|---|---|")
    for name, arguments in classes(plant).items():
        (lost, peak, _), bare, safe = (outcome(plant, p, arguments) for p in (rk4, network, guarded))
        extra = [int((each[0] & ~lost).sum()) for each in (bare, safe)]
        cells = [name, f"{lost.sum()}, {peak:.3g}", f"{extra[0]}, {bare[1]:.3g}"]
        print(f"| {' | '.join(cells)} | {extra[1]}, {safe[1]:.3g}, {safe[2]:.2%} |", flush=True)
