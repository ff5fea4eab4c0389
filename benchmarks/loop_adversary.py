"""What an adversary makes of whole loops: does it lose one with a guarded network that the numerical predictor keeps?

    python benchmarks/loop_adversary.py MODEL [--loops 500] [--push 0.5] [--spoof 0.5] [--tolerance 0.01] [--t-end 30]
        [--again 100]

CMA-ES chooses the start, D, D_hat(0), a disturbance at the input that is constant over each of eight spans of time and
at most `--push` in size, and four samples of X that a sensor gets wrong, each state by at most `--spoof` times the
width of the plant's box, and when: all in the first 30 % of the time. It maximises how much further the guarded loop
goes, and ends, from its target than the numerical one under the same attack. A loop is lost that ends further from its
target than `--lost` times the target's size; with `--again 100` those that are lost run once more, under the same
attack, for 100 s: some are still on their way at `--t-end`. It prints one row of a Markdown table.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cma
import numpy as np

import npred
from npred import metrics
from npred.lab import config
from npred.lab.config.conditions import Condition, box
from npred.plants import Plant
from npred.prediction.methods import Predictor

SPANS, SPOOFED = 8, 4
ATTACKED = 0.3  # of the time: loops may settle in the rest
SIZE, GENERATIONS, WIDTH = 20, 8, 0.3  # of a population; the spread that it begins with
NEAR = 1e-3  # of the target's size: two loops that end nearer than this end alike
FAR = 1e6  # stands for a distance that is not finite
HEAD = ["model", "loops", "lost: numerical", "bare", "guarded", "guarded alone", "bare alone", "worst peak ratio"]


class Attack(NamedTuple):
    """What a point z in [0, 1]^k stands for."""

    X0: np.ndarray
    D: float
    D_hat: float
    push: np.ndarray  # (SPANS, m)
    spoofs: dict[int, np.ndarray]  # control step -> what is added to the sample of X (n,)


class Outcome(NamedTuple):
    """Of one loop: whether it is lost, how far from its target it was at most, and at the end."""

    lost: bool
    peak: float
    end: float


def attack(z: np.ndarray, plant: Plant, pipeline: config.Pipeline, options: argparse.Namespace) -> Attack:
    """The attack of a point: the ranges of delays and estimates are those of the data."""
    generate, n, m = pipeline.generate, plant.n, plant.m
    ranges, steps = box(plant, generate), round(ATTACKED * options.t_end / pipeline.evaluate.dt)
    X0, (a, b), pushes, when, offsets = np.split(z, np.cumsum([n, 2, SPANS * m, SPOOFED]))
    D_hat = between(b, np.array(generate.D_hat, dtype=float).ravel())
    at = (when * steps).astype(int)
    wrong = options.spoof * (2 * offsets.reshape(SPOOFED, n) - 1) * (ranges[:, 1] - ranges[:, 0])
    return Attack(
        ranges[:, 0] + X0 * (ranges[:, 1] - ranges[:, 0]), between(a, np.atleast_1d(generate.D)), D_hat,
        options.push * (2 * pushes.reshape(SPANS, m) - 1), dict(zip(at.tolist(), wrong, strict=True)),
    )  # fmt: skip


def between(share: float, ends: np.ndarray) -> float:
    return float(ends.min() + share * (ends.max() - ends.min()))


def condition(attacks: list[Attack], pipeline: config.Pipeline, attacked: float, t_end: float) -> Condition:
    """The loops of a population side by side, each with its own attack, which lasts `attacked` seconds."""
    table, pushes = pipeline.evaluate, np.array([it.push for it in attacks])
    wrong: dict[int, np.ndarray] = {}
    for lane, it in enumerate(attacks):
        for step, offset in it.spoofs.items():
            wrong.setdefault(step, np.zeros((len(attacks), len(it.X0))))[lane] = offset

    def disturbance(t: float) -> np.ndarray:
        span = int(SPANS * t / attacked)
        return pushes[:, span] if span < SPANS else 0 * pushes[:, 0]

    def observer(X_hat: np.ndarray, Y: np.ndarray, U: np.ndarray, t: float) -> np.ndarray:
        return Y + wrong.get(round(t / table.dt), 0.0)

    X0, D, D_hat = (np.array([getattr(it, name) for it in attacks]) for name in ("X0", "D", "D_hat"))
    return Condition(table, X0, D, D_hat, t_end, 0, disturbance=disturbance, observer=observer)


def outcomes(predictor: Predictor, it: Condition, far: float) -> list[Outcome]:
    """Of each loop."""
    loops = it.loops(predictor.plant, predictor, every=20, progress=False)
    target = predictor.plant.target(loops.t)
    size = np.linalg.norm(loops.X - target, axis=-1)
    size = np.nan_to_num(size, nan=FAR, posinf=FAR) / max(float(np.abs(target).max()), 1e-9 if target.any() else 1.0)
    ends = zip(metrics.far(loops, target, far), size.max(axis=-1), size[:, -1], strict=True)
    return [Outcome(bool(lost), float(peak), float(end)) for lost, peak, end in ends]


def worse(guarded: Outcome, numerical: Outcome) -> float:
    """By how much further the guarded loop went, as logarithms."""
    return float(np.log(guarded.peak / numerical.peak) + np.log((guarded.end + NEAR) / (numerical.end + NEAR)))


def search(ask: Callable[[list[np.ndarray]], list[float]], size: int, loops: int, seed: int) -> None:
    """Populations from random centres, until so many points were asked, or some more: populations are whole."""
    rng, asked = np.random.default_rng(seed), 0
    while asked < loops:
        settings = {"bounds": [0, 1], "popsize": SIZE, "seed": int(rng.integers(1, 2**31)), "verbose": -9}
        evolution = cma.CMAEvolutionStrategy(rng.uniform(0.2, 0.8, size), WIDTH, settings)
        for _ in range(GENERATIONS):
            points = evolution.ask()
            evolution.tell(points, [-score for score in ask(points)])
            asked += SIZE
            if asked >= loops or evolution.stop():
                break


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("model", nargs="?", default="pipeline/paper.toml:deeponet")
    parser.add_argument("--loops", type=int, default=500)
    for name, default in (("push", 0.5), ("spoof", 0.5), ("tolerance", 0.01), ("lost", metrics.FAR), ("t-end", 30.0)):
        parser.add_argument(f"--{name}", type=float, default=default)
    parser.add_argument("--again", type=float, default=None)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--store", default="artifacts")
    options = parser.parse_args()
    pipeline = config.load(Path(options.model.rsplit(":", 1)[0]))
    network = npred.load(options.model, nx=pipeline.evaluate.nx, store=options.store, runtime="fused")
    plant = network.plant
    rk4 = npred.predictor(plant, pipeline.evaluate.predictor, network.nx)
    runs = {"numerical": rk4, "bare": network, "guarded": npred.guarded(network, options.tolerance)}
    found: list[dict[str, Outcome]] = []
    late: list[dict[str, Outcome]] = []  # of those that are lost, or what became of them

    def made(attacks: list[Attack], t_end: float) -> list[dict[str, Outcome]]:
        it = condition(attacks, pipeline, ATTACKED * options.t_end, t_end)
        each = {name: outcomes(run, it, options.lost) for name, run in runs.items()}
        return [dict(zip(each, row, strict=True)) for row in zip(*each.values(), strict=True)]

    def ask(points: list[np.ndarray]) -> list[float]:
        attacks = [attack(z, plant, pipeline, options) for z in points]
        found.extend(made(attacks, options.t_end))
        lost = [it for it, row in zip(attacks, found[-len(points) :], strict=True) if any(o.lost for o in row.values())]
        if lost:
            late.extend(made(lost, options.again or options.t_end))
        print(f"\r{len(found)} loops", end="", file=sys.stderr, flush=True)
        return [worse(row["guarded"], row["numerical"]) for row in found[-len(points) :]]

    search(ask, plant.n + 2 + SPANS * plant.m + SPOOFED * (1 + plant.n), options.loops, options.seed)
    lost = {name: np.array([each[name].lost for each in late], dtype=bool) for name in runs}
    ratio = max(each["guarded"].peak / each["numerical"].peak for each in found if not each["numerical"].lost)
    alone = [int((lost[name] & ~lost["numerical"]).sum()) for name in ("guarded", "bare")]
    cells = [options.model, len(found), *(int(lost[name].sum()) for name in runs), *alone, f"{ratio:.3g}"]
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}\n| {' | '.join(map(str, cells))} |")


if __name__ == "__main__":
    main()
