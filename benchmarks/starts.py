"""Starts that the numerical predictor keeps and a network loses, bare and guarded.

    python benchmarks/starts.py [MODEL] [--loops 9] [--box 5] [--t-end 60] [--tolerance 0.01] [--damage 0.1] [--lost 1]

MODEL is pipeline/paper.toml:deeponet by default, and has to be trained; `…:deeponet@20` is its early-stopped snapshot.
Loops have the settings of the pipeline's [evaluate], delays and estimates those of [generate], starts its box, `--box`
times as wide about its middle. `--damage` moves the weights uphill, along the gradient of the error of U on examples of
the data, until its median is at least that. A loop is lost that ends further from its target than `--lost` times the
target's size. `--again 100` runs those that are lost at --t-end once more, for 100 s: some are still on their way.
The numerical predictor on twice the nodes is the yardstick: where starts are at the edge of what the law keeps, it
loses others too.
"""

import argparse
import copy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch

import npred
from npred import metrics
from npred.base import grid
from npred.lab import config
from npred.lab.config.conditions import Condition
from npred.lab.stages.generate import sampling
from npred.lab.training.neural import Neural
from npred.networks.fused import Fused
from npred.prediction.methods import Predictor

BATCH, CLIMB, SEED = 500, 0.003, 12345  # loops side by side; the step of a weight, as a share of its layer's; of draws


def damaged(network: Any, error: float) -> Predictor:
    """The network with weights moved until the median error of U on examples of its data is `error`."""
    plant = network.plant
    operator = copy.deepcopy(network.operator.module(plant)).double().requires_grad_(True)
    domain = operator.domain
    rows = domain.X, grid.means(domain.u, network.nx), domain.D_hat, domain.t
    U = torch.as_tensor(plant.kappa(npred.predictor(plant, "rk4", network.nx)(*rows)[:, -1], domain.t + domain.D_hat))
    inputs = [torch.as_tensor(a) for a in (*rows[:3], *([plant.phase(domain.t)] if plant.phased else []))]
    for _ in range(1000):
        gaps = (plant.kappa(operator(*inputs)[:, -1], torch.as_tensor(domain.t + domain.D_hat)) - U).abs().amax(dim=-1)
        if gaps.median() >= error:
            break
        weights = [weight for weight in operator.parameters() if weight.requires_grad]
        slopes = torch.autograd.grad(gaps.mean(), weights, allow_unused=True)
        with torch.no_grad():
            for weight, slope in zip(weights, slopes, strict=True):
                if slope is not None and slope.norm() > 0:
                    weight += CLIMB * weight.norm() / slope.norm() * slope
    print(f"damaged: median error of U on the data's examples {gaps.median():.2g}, 99 % {gaps.quantile(0.99):.2g}")
    if isinstance(network, Fused):
        return Fused(plant, operator.float(), network.nx, "damaged")
    return Neural(plant, operator, network.nx, name="damaged")


def wide(plant: npred.plants.Plant, X0: np.ndarray, factor: float) -> np.ndarray:
    """The starts moved away from the middle of the box; of states that are positive there, their sizes."""
    low, high = np.array([plant.box[name] for name in plant.states]).T
    middle = (low + high) / 2
    moved = middle + factor * (X0 - middle)
    return np.where(low > 0, np.abs(moved), moved)


def settled(
    pipeline: config.Pipeline, predictor: Predictor, drawn: tuple[np.ndarray, ...], options: argparse.Namespace
) -> Any:  # fmt: skip
    """As `outcome`, where loops that are lost are run again for a longer time."""
    t_end = options.t_end or pipeline.evaluate.case_t_end
    lost, share = outcome(pipeline, predictor, drawn, t_end, options.lost)
    late = np.flatnonzero(lost)
    if options.again and len(late):
        lost[late] = outcome(pipeline, predictor, tuple(a[late] for a in drawn), options.again, options.lost)[0]
    return lost, share


def outcome(
    pipeline: config.Pipeline, predictor: Predictor, drawn: tuple[np.ndarray, ...], t_end: float, far: float
) -> Any:
    """Which loops are lost (B,), and the steps in which the numerical predictor answered, as a share."""
    X0, D, D_hat, *_ = drawn
    lost, shares = [], []
    nominal = Condition(pipeline.evaluate, X0, D, D_hat, t_end, SEED)
    for i in range(0, len(X0), BATCH):
        loops = nominal.part(slice(i, i + BATCH)).loops(predictor.plant, predictor, every=20)
        lost.append(metrics.far(loops, predictor.plant.target(loops.t), far))
        shares.append(loops.fallback_share)
        print(f"\r{predictor.name}: {i + len(lost[-1])} of {len(X0)} loops", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return np.concatenate(lost), float(np.average(shares, weights=[len(part) for part in lost]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("model", nargs="?", default="pipeline/paper.toml:deeponet")
    for name, kind, default in (("loops", int, 10_000), ("box", float, 1.0), ("t-end", float, None)):
        parser.add_argument(f"--{name}", type=kind, default=default)
    for name, default in (("tolerance", 0.01), ("damage", None), ("lost", metrics.FAR), ("again", None)):
        parser.add_argument(f"--{name}", type=float, default=default)
    parser.add_argument("--store", default="artifacts")
    options = parser.parse_args()
    file, name = options.model.rsplit(":", 1)
    pipeline = config.load(Path(file))
    nx, t_end = pipeline.evaluate.nx, options.again or options.t_end or pipeline.evaluate.case_t_end
    network = npred.load(options.model, nx=nx, store=options.store, runtime="fused")
    network = damaged(network, options.damage) if options.damage else network
    guarded = npred.guarded(network, options.tolerance)
    nominal = pipeline.generate.model_copy(update={"rollouts": options.loops, "samples": options.loops, "explore": 0.0})
    drawn = sampling.starts(SEED, nominal, network.plant, range(options.loops))
    drawn = (wide(network.plant, drawn[0], options.box), *drawn[1:])
    rk4 = npred.predictor(network.plant, pipeline.evaluate.predictor, nx)
    numerical, _ = settled(pipeline, rk4, drawn, options)
    print(f"{options.loops} loops of {t_end:g} s, box {options.box:g} times as wide, tolerance {options.tolerance:g}")
    print(f"numerical: {numerical.sum()} lost", flush=True)
    finer = npred.predictor(network.plant, pipeline.evaluate.predictor, 2 * nx - 1)
    for name, predictor in ((network.name, network), (guarded.name, guarded), ("twice the nodes", finer)):
        lost, share = settled(pipeline, predictor, drawn, options)
        others = f"{(lost & ~numerical).sum()} lost that it keeps, {(numerical & ~lost).sum()} kept that it loses"
        print(f"{name}: {others}" + (f", fallback {share:.2%}" if predictor is guarded else ""), flush=True)
