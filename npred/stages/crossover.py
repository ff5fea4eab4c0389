"""When a network pays: its latency against the numerical predictor's steps times the cost of one evaluation of f."""

from typing import Any

import numpy as np

from npred import grid, operators, plants, randomness, runtimes, timing
from npred.dataset import Dataset
from npred.operators import Scaling
from npred.plants import Plant
from npred.predictors import RK4, Predictor
from npred.stages import Job
from npred.stages.contenders import Reference, matching

STEPS = (10, 210)  # of the two runs whose difference is the cost of f
EVALUATIONS = 4  # of f in a step of RK4
SAMPLES, NODES = 50, 101
Row = dict[str, Any]


def of_rows(job: Job, rows: list[Row], reference: Reference) -> Row:
    """The crossover of the pipeline's plant, for its quickest network at batch 1 and the first dx, at its accuracy."""
    first = [r for r in rows if r["batch"] == 1 and not r["matches"] and abs(r["dx"] - job.config.bench.dx[0]) < 1e-9]
    network = min((r for r in first if r["predictor"] in job.config.train.models), key=lambda r: r["median_us"])
    steps = round(1 / next(r["dx"] for r in rows if r["matches"] == network["predictor"]))
    found = _crossover(job, job.plant, network["median_us"], steps)
    size = float(np.abs(reference.P).max())
    which = {key: network[key] for key in ("predictor", "runtime", "eps_sup")}
    return which | {"trained": True, "eps_relative": network["eps_sup"] / size} | found


def of_costly(job: Job, eps_relative: float) -> Row:
    """The same for the plant `costly` at the same relative accuracy, against a fused DeepONet of the pipeline's sizes.

    That network is untrained: its latency does not hang on its weights, and its accuracy is taken as given.
    """
    plant = plants.resolve(job.config.bench.costly)
    reference = Reference(plant, _samples(job, plant))
    eps, nx = eps_relative * float(np.abs(reference.P).max()), grid.count(job.config.bench.dx[0])
    operator = operators.build(job.config.train.deeponet, plant, Scaling(plant.n, plant.m)).eval().requires_grad_(False)
    latency = _median(job, plant, runtimes.predictor("fused", plant, operator, nx), nx)
    found = _crossover(job, plant, latency, matching(reference, eps) - 1)
    which = {"predictor": "deeponet", "runtime": "fused", "trained": False}
    return which | {"eps_sup": eps, "eps_relative": eps_relative} | found


def _samples(job: Job, plant: Plant) -> Dataset:
    """Random states of the plant's box with smooth inputs about the target's, as data to take errors on."""
    random = randomness.generator(job.config.seed, "bench", "costly")
    ends = np.array([plant.box[name] for name in plant.states])
    rest = plant.u_target(0.0)
    waves = np.cos(np.outer(grid.nodes(NODES), np.pi * np.arange(1, 4)))  # (nodes, 3)
    weights = random.normal(size=(SAMPLES, 3, plant.m)) * (0.1 + np.abs(rest)) / 10
    return Dataset(
        X=random.uniform(ends[:, 0], ends[:, 1], (SAMPLES, plant.n)), u=rest + waves @ weights,
        D_hat=random.uniform(0.2, 0.8, SAMPLES), P=np.zeros((SAMPLES, NODES, plant.n)), D=np.zeros(SAMPLES),
        t=np.ones(SAMPLES), rollout=np.zeros(SAMPLES, dtype=np.int32), test=np.ones(SAMPLES, dtype=np.uint8),
    )  # fmt: skip


def _crossover(job: Job, plant: Plant, network_us: float, steps: int) -> Row:
    """pays_from_ns: the cost of an evaluation of f at which RK4 with these steps takes as long as the network."""
    few, many = (_median(job, plant, RK4(plant, k + 1), k + 1) for k in STEPS)
    f_ns = (many - few) * 1000 / (EVALUATIONS * (STEPS[1] - STEPS[0]))
    overhead = max(few - f_ns * EVALUATIONS * STEPS[0] / 1000, 0.0)
    rk4_us = overhead + f_ns * EVALUATIONS * steps / 1000
    pays_from = max(network_us - overhead, 0.0) * 1000 / (EVALUATIONS * steps)
    return {
        "plant": plant.name, "f_ns": f_ns, "rk4_steps": steps, "rk4_us": rk4_us, "network_us": network_us,
        "network_speedup": rk4_us / network_us, "pays_from_ns": pays_from,
    }  # fmt: skip


def _median(job: Job, plant: Plant, run: Predictor, nx: int) -> float:
    """Microseconds of a call at batch 1, near the plant's target."""
    X, u = plant.target(0.0)[:, None] * 1.01, np.tile(plant.u_target(0.0)[None, :, None], (nx, 1, 1))
    D_hat, P, predict, config = np.ones(1), np.empty((nx, plant.n, 1)), run.lanes(), job.config.bench

    def call(k: int) -> None:
        predict(X, u, D_hat, 0.0, plant.p, P)

    return timing.quantiles(timing.sample({"one": call}, config.calls, config.seconds)["one"])["median_us"]


def sentence(found: Row) -> str:
    """What it means, for people."""
    numerical, ratio = f"rk4 with {found['rk4_steps']} steps", found["network_speedup"]
    trained = "" if found["trained"] else ", if trained to that accuracy"
    network = f"a {found['predictor']} ({found['runtime']}){trained}"
    first, second = (numerical, network) if ratio < 1 else (network, numerical)
    times = f"{found['network_us']:.1f} us the network, {found['rk4_us']:.1f} us rk4"
    pays = f"from {found['pays_from_ns']:.0f} ns an evaluation of f on (here {found['f_ns']:.0f} ns)"
    return (
        f"For {found['plant']} at eps = {found['eps_sup']:.1e} the fastest predictor is {first}, by "
        f"{max(ratio, 1 / ratio):.1f}x over {second}: {times}. A network pays {pays}."
    )
