"""What hostile loops make of a network, bare and guarded: 64 loops a class, 100 s (about three minutes a network).

    python benchmarks/hostile.py [MODEL] [STORE] [--loops 16] [--t-end 40] [--tolerance 0.05] [--lost 2]
        [--nx 51] [--only nominal noise]

MODEL is pipeline/paper.toml:deeponet by default, and has to be trained. A loop is lost that ends further from rest than
`--lost` times |X*|; "extra" are those that the numerical predictor keeps. Times are shares of the length of a loop, and
delays multiples of the pipeline's D where its plant knows its delay; the estimate then stays where it starts.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import npred
from npred import metrics
from npred.guard.guarded import Guarded
from npred.lab import config
from npred.lab.config import FROZEN, Evaluate, Scenario
from npred.lab.config.conditions import EVERY, Condition, box, true_delay
from npred.lab.config.evaluate import Jump
from npred.loop.measurement import Sensors
from npred.plants import Plant
from npred.prediction.methods import Predictor

NX = 51


def pulse(size: float, at: float) -> Callable[[float], float]:
    """A disturbance at the input for one second."""
    return lambda t: size if at <= t < at + 1 else 0.0


def conditions(plant: Plant, pipeline: config.Pipeline, loops: int, t_end: float) -> dict[str, Condition]:
    """The conditions by what is hostile in them."""
    rng, ranges = np.random.default_rng(0), box(plant, pipeline.generate)
    frozen = pipeline.evaluate.adaptation == FROZEN
    X0 = rng.uniform(ranges[:, 0], ranges[:, 1], (loops, plant.n))
    middle, positive = ranges.mean(axis=1), ranges[:, 0] > 0
    wide = middle + 5 * (X0 - middle)
    table = pipeline.evaluate if frozen else Evaluate()
    D, at = table.D, 0.2 * t_end
    wrong = {round(step * t_end / 100 * 0.005 / table.dt) for step in rng.integers(1000, 8000, 5)}

    def flipped(X_hat: np.ndarray, Y: np.ndarray, U: np.ndarray, t: float) -> np.ndarray:
        return -Y if round(t / table.dt) in wrong else Y

    near = np.array(pipeline.generate.D_hat, dtype=float) if frozen else np.array([0.3, 2.5])
    nominal = Condition(table, X0, D, rng.uniform(near.min(), near.max(), loops), t_end, seed=0)
    slow, faster = table.model_copy(update={"D": 2 * D}), Scenario(name="faster", jump=Jump(at=at, to=D / 4))
    return {
        "nominal": nominal,
        "starts from a box 5 times as wide": replace(nominal, X0=np.where(positive, np.abs(wide), wide)),
        **{
            f"noise {share:.0%}": replace(
                nominal, table=table.model_copy(update={"measurement": Sensors(relative_noise=share)})
            )
            for share in (0.03, 0.05)
        },
        **{f"D̂(0) = {share:g} D": replace(nominal, D_hat=share * D) for share in (0.1, 4.0)},
        "D from 2 D to D / 4": replace(nominal, table=slow, D=true_delay(slow, faster)),
        **{f"pulse of U {size:+g}": replace(nominal, disturbance=pulse(size, at)) for size in (0.5, -0.5, 1.0, -1.0)},
        "five samples of X with the sign turned": replace(nominal, observer=flipped),
    }


def outcome(plant: Plant, predictor: Predictor, condition: Condition, far: float) -> tuple[np.ndarray, float, float]:
    """Which loops are lost, the largest distance from rest, and the share of steps with the numerical predictor."""
    loops = condition.loops(plant, predictor, every=EVERY)
    target = plant.target(loops.t)
    lost = metrics.far(loops, target, far)
    return lost, float(np.nan_to_num(np.linalg.norm(loops.X - target, axis=-1), nan=np.inf).max()), loops.fallback_share


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("model", nargs="?", default="pipeline/paper.toml:deeponet")
    parser.add_argument("store", nargs="?", default="artifacts")
    parser.add_argument("--loops", type=int, default=64)
    parser.add_argument("--nx", type=int, default=NX, help="nodes of the network and of the numerical predictor")
    parser.add_argument("--only", nargs="*", default=[""], help="classes whose names have one of these words")
    for name, default in (("t-end", 100.0), ("tolerance", 0.01), ("lost", metrics.FAR)):
        parser.add_argument(f"--{name}", type=float, default=default)
    options = parser.parse_args()
    pipeline = config.load(Path(options.model.rsplit(":", 1)[0]))
    network = npred.load(options.model, nx=options.nx, runtime="fused", store=options.store)
    plant = network.plant
    rk4, guarded = npred.predictor(plant, "rk4", options.nx), Guarded(network, options.tolerance)
    name, counts = guarded.reference
    print(f"guarded by shadows, {name} on {', '.join(map(str, counts))} steps, tolerance {guarded.tolerance:g}")
    print("| class | numerical: lost, peak | bare: extra, peak | guarded: extra, peak, fallback |")
    print("|---|---|---|---|")
    for name, condition in conditions(plant, pipeline, options.loops, options.t_end).items():
        if not any(word in name for word in options.only):
            continue
        (lost, peak, _), bare, safe = (outcome(plant, p, condition, options.lost) for p in (rk4, network, guarded))
        extra = [int((each[0] & ~lost).sum()) for each in (bare, safe)]
        cells = [name, f"{lost.sum()}, {peak:.3g}", f"{extra[0]}, {bare[1]:.3g}"]
        print(f"| {' | '.join(cells)} | {extra[1]}, {safe[1]:.3g}, {safe[2]:.2%} |", flush=True)
