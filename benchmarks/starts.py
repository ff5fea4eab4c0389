"""Starts that the numerical predictor keeps and a network loses, bare and guarded.

    python benchmarks/starts.py [MODEL] [--loops 9] [--box 5] [--t-end 60] [--tolerance 0.01] [--lost 1]

MODEL is pipeline/paper.toml:deeponet by default, and has to be trained; `…:deeponet@20` is its early-stopped snapshot.
Loops have the settings of the pipeline's [evaluate], delays and estimates those of [generate], starts its box, `--box`
times as wide about its middle. A loop is lost that ends further from its target than `--lost` times the target's size.
The numerical predictor on twice the nodes is the yardstick: where starts are at the edge of what the law keeps, it
loses others too.
"""

import sys

import harness
import numpy as np

import npred
from npred import metrics
from npred.lab.config.conditions import Condition
from npred.lab.stages.generate import sampling
from npred.prediction.methods import Predictor

BATCH, SEED = 500, 12345  # loops side by side


def wide(plant: npred.plants.Plant, X0: np.ndarray, factor: float) -> np.ndarray:
    """The starts moved away from the middle of the box; of states that are positive there, their sizes."""
    low, high = harness.box(plant)
    middle = (low + high) / 2
    moved = middle + factor * (X0 - middle)
    return np.where(low > 0, np.abs(moved), moved)


def outcome(condition: Condition, predictor: Predictor, far: float) -> tuple[np.ndarray, float]:
    """Which loops are lost (B,), and the steps in which the numerical predictor answered, as a share."""
    lost, shares = [], []
    for i in range(0, len(condition.X0), BATCH):
        loops = condition.part(slice(i, i + BATCH)).loops(predictor.plant, predictor, every=20)
        lost.append(metrics.far(loops, predictor.plant.target(loops.t), far))
        shares.append(loops.fallback_share)
        print(f"\r{predictor.name}: {i + len(lost[-1])} loops", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return np.concatenate(lost), float(np.average(shares, weights=[len(part) for part in lost]))


if __name__ == "__main__":
    named = {"loops": 10_000, "box": 1.0, "t_end": float, "tolerance": 0.01, "lost": metrics.FAR, "store": "artifacts"}
    options = harness.options(__doc__, {"model": harness.PAPER}, **named)
    pipeline = harness.pipeline(options.model)
    nx, t_end = pipeline.evaluate.nx, options.t_end or pipeline.evaluate.case_t_end
    network = harness.network(options, nx)
    guarded = npred.guarded(network, options.tolerance)
    nominal = pipeline.generate.model_copy(update={"rollouts": options.loops, "samples": options.loops, "explore": 0.0})
    X0, D, D_hat, *_ = sampling.starts(SEED, nominal, network.plant, range(options.loops))
    condition = Condition(pipeline.evaluate, wide(network.plant, X0, options.box), D, D_hat, t_end, SEED)
    rk4, finer = (npred.predictor(network.plant, pipeline.evaluate.predictor, nodes) for nodes in (nx, 2 * nx - 1))
    numerical, _ = outcome(condition, rk4, options.lost)
    print(f"{options.loops} loops of {t_end:g} s, box {options.box:g} times as wide, tolerance {options.tolerance:g}")
    print(f"numerical: {numerical.sum()} lost", flush=True)
    for name, predictor in ((network.name, network), (guarded.name, guarded), ("twice the nodes", finer)):
        lost, share = outcome(condition, predictor, options.lost)
        others = f"{(lost & ~numerical).sum()} lost that it keeps, {(numerical & ~lost).sum()} kept that it loses"
        print(f"{name}: {others}" + (f", fallback {share:.2%}" if predictor is guarded else ""), flush=True)
