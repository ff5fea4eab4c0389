"""What hostile loops make of a network, bare and guarded: 64 loops a class, 100 s (about three minutes a network).

Usage: python benchmarks/hostile.py [MODEL], by default pipeline/paper.toml:deeponet, which has to be trained. A loop is
lost that ends further from rest than a fifth of |X*|; "extra" are those that the numerical predictor keeps.
"""

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import npred
from npred import metrics
from npred.conditions import EVERY, Condition, box
from npred.conditions.scenarios import delay
from npred.config import Evaluate, Generate, Scenario
from npred.config.evaluate import Jump
from npred.config.loop import Sensors
from npred.plants import Plant
from npred.predictors import Predictor
from npred.predictors.guarded import Guarded

B, NX, T_END = 64, 51, 100.0
rng = np.random.default_rng(0)


def pulse(size: float) -> Callable[[float], float]:
    """A disturbance at the input from 20 s to 21 s."""
    return lambda t: size if 20 <= t < 21 else 0.0


def flipped(Y: np.ndarray, t: float, at: set[int]) -> np.ndarray:
    """The measurement, its sign turned at those control steps."""
    return -Y if round(t / 0.005) in at else Y


def conditions(plant: Plant) -> dict[str, Condition]:
    """The conditions by what is hostile in them."""
    ranges = box(plant, Generate())
    X0 = rng.uniform(ranges[:, 0], ranges[:, 1], (B, plant.n))
    middle = ranges.mean(axis=1)
    at = set(rng.integers(1000, 8000, 5).tolist())
    nominal = Condition(Evaluate(), X0, 1.0, rng.uniform(0.3, 2.5, B), T_END, seed=0)
    slow, faster = Evaluate(D=2.0), Scenario(name="faster", jump=Jump(at=20.0, to=0.25))
    return {
        "nominal": nominal,
        "starts from a box 5 times as wide": replace(nominal, X0=np.abs(middle + 5 * (X0 - middle))),
        "noise 3 %": replace(nominal, table=Evaluate(measurement=Sensors(noise=0.03))),
        "noise 5 %": replace(nominal, table=Evaluate(measurement=Sensors(noise=0.05))),
        "D̂(0) = 0.1": replace(nominal, D_hat=0.1),
        "D̂(0) = 4": replace(nominal, D_hat=4.0),
        "D from 2 to 0.25 at 20 s": replace(nominal, table=slow, D=delay(slow, faster)),
        "pulse of U + 0.5": replace(nominal, disturbance=pulse(0.5)),
        "pulse of U − 0.5": replace(nominal, disturbance=pulse(-0.5)),
        "pulse of U + 1": replace(nominal, disturbance=pulse(1.0)),
        "pulse of U − 1": replace(nominal, disturbance=pulse(-1.0)),
        "five samples of X with the sign turned": replace(nominal, observer=lambda X_hat, Y, U, t: flipped(Y, t, at)),
    }


def outcome(plant: Plant, predictor: Predictor, condition: Condition) -> tuple[np.ndarray, float, float]:
    """Which loops are lost, the largest distance from rest, and the share of steps with the numerical predictor."""
    loops = condition.loops(plant, predictor, every=EVERY)
    target = plant.target(loops.t)
    lost = metrics.lost(loops, target)
    return lost, float(np.nan_to_num(np.linalg.norm(loops.X - target, axis=-1), nan=np.inf).max()), loops.fallback_share


if __name__ == "__main__":
    model, store = (sys.argv[1:] + ["pipeline/paper.toml:deeponet", "artifacts"][len(sys.argv) - 1 :])[:2]
    network = npred.load(model, nx=NX, runtime="fused", store=store)
    plant = network.plant
    rk4, guarded = npred.predictor("rk4", plant, NX), Guarded(network)
    name, counts = guarded.reference
    print(f"guarded by shadows, {name} on {', '.join(map(str, counts))} steps, tolerance {guarded.tolerance:g}")
    print("| class | numerical: lost, peak | bare: extra, peak | guarded: extra, peak, fallback |")
    print("|---|---|---|---|")
    for name, condition in conditions(plant).items():
        (lost, peak, _), bare, safe = (outcome(plant, p, condition) for p in (rk4, network, guarded))
        extra = [int((each[0] & ~lost).sum()) for each in (bare, safe)]
        cells = [name, f"{lost.sum()}, {peak:.3g}", f"{extra[0]}, {bare[1]:.3g}"]
        print(f"| {' | '.join(cells)} | {extra[1]}, {safe[1]:.3g}, {safe[2]:.2%} |", flush=True)
