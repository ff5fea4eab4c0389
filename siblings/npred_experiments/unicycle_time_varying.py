"""A wheeled robot with a delay that varies in time, D(t) = (1 + t) / (1 + b t), b drawn from 2 to 2.1.

Bhan, Krstic, Shi, Neural Operators for Predictor Feedback Control of Nonlinear Delay Systems, arXiv:2411.18964.
"""

from functools import lru_cache, partial
from typing import Any

import numpy as np

import npred
from npred import plants
from npred_experiments import latency, pomet, quirks
from npred_experiments.experiment import (
    AS_MEANT,
    AS_PUBLISHED,
    Experiment,
    Measured,
    Measurements,
    PublishedNumber,
    networks,
    published_times,
)
from npred_experiments.loop_networks import LoopNetworks
from npred_experiments.network_loop import Called, NetworkLoop, Predict
from npred_experiments.pomet import Law

RUNS, STEPS, NODES, DT = 25, 1000, 100, 0.01
OTHERS = 300  # runs to learn from
Runs = tuple[np.ndarray, np.ndarray]  # X0 (3, B) and b (B,)


def draws() -> tuple[np.ndarray, np.ndarray]:
    """X0 (3, 25) and b (25,) of the published runs."""
    noise, b = quirks.uniform(np.random.RandomState(1), RUNS, (-0.1, 0.1, 3), (2.0, 2.1, None))
    return 1.0 + noise, b


def arrival(t: float, b: Any) -> Any:
    """σ(t), when the command of time t acts: the solution of s - (1 + s) / (1 + b s) = t."""
    rest = -b * t
    return (np.sqrt(rest**2 + 4 * b * (1 + t)) - rest) / (2 * b)


def arrival_rate(t: float, b: Any) -> Any:
    """σ'(t)."""
    rest = -b * t
    return 0.5 + (1 / b - rest / (2 * b)) / (2 * np.sqrt((t + 1) / b + rest**2 / (4 * b**2)))


def published_loop(
    law: Law = pomet.published_law, predict: Predict = pomet.half_cell_short, runs: Runs | None = None
) -> np.ndarray:
    """X, (1000, 3, 25), of the loop as published: the line moves at 1 + x (σ' - 1) / (σ - t).

    Right is (1 + x (σ' - 1)) / (σ - t), which takes σ - t, 0.5 to 0.7 s. The published line takes about 1 s, so the
    plant gets the commands later than the predictor believes. With the right speed dt = dx would be unstable.
    Another predictor may replace the published rule, and other runs the published ones.
    """
    X0, b = runs or draws()
    X, line = np.empty((STEPS, *X0.shape)), np.zeros((NODES, 2, len(b)))
    x = DT * np.arange(NODES - 1)[:, None, None]
    X[0] = X0
    for i in range(1, STEPS):
        t = DT * (i - 1)
        sigma = arrival(t, b)
        end = tuple(predict(X[i - 1].T, line.transpose(2, 0, 1), sigma - t, t)[:, -1].T)
        courant = 1 + x * (arrival_rate(t, b) - 1) / (sigma - t)  # times dt / dx = 1
        line = quirks.upwind(line, courant, np.stack(law(end, sigma)))
        X[i] = X[i - 1] + DT * np.stack(pomet.f(tuple(X[i - 1]), line[0]))
    return X


@lru_cache(maxsize=64)
def rk4(b: float) -> npred.Predictor:
    """npred's numerical predictor of the plant with this b."""
    return npred.predictor(plants.resolve("unicycle_time_delay", {"b": b}), "rk4", nx=NODES + 1)


def meant(predict: Predict | None = None, runs: Runs | None = None) -> float:
    """The mean of |X| with the right law and exact transport, by npred: one plant per b, starts X0 (3, B) or (3, b, B).

    Another predictor gets the horizon σ(t) - t for the delay D(t): there is one map from it, nearly, for all b.
    """
    X0, b = runs or draws()
    loops = []
    for start, slope in zip(np.moveaxis(X0, 1, 0), b.tolist(), strict=True):
        predictor = rk4(slope)
        if predict:
            predictor = Called(predictor.plant, NODES + 1, partial(_by_horizon, predict, slope))
        loops.append(npred.simulate(predictor.plant, predictor, X0=start.T, t_end=(STEPS - 1) * DT, dt=DT))
    return float(np.mean([np.linalg.norm(loop.X, axis=-1).mean() for loop in loops]))


def _by_horizon(predict: Predict, b: float, X: np.ndarray, u: np.ndarray, D: np.ndarray, t: Any) -> np.ndarray:
    return predict(X, u, np.full(len(X), arrival(t, b) - t), t)


def by_horizon(X: np.ndarray, u: np.ndarray, horizon: np.ndarray, t: Any) -> np.ndarray:
    """P as npred has it, with the horizon for the delay: b solves (1 + σ) / (1 + b σ) = σ - t, one for all rows."""
    sigma = t + float(horizon[0])
    b = round(((1 + sigma) / (sigma - t) - 1) / sigma, 9)
    return rk4(b).predict(X, u, np.full(len(X), (1 + t) / (1 + b * t)), t)


def measure() -> Measurements:
    """The mean of |X| over the runs and the samples."""
    published = float(np.linalg.norm(published_loop(), axis=1).mean())
    return {"stabilisation": Measured(published, meant())}


def others(rng: np.random.Generator) -> Runs:
    """Runs to learn from, with starts from a box twice as wide as that of the published ones."""
    return 1.0 + rng.uniform(-0.2, 0.2, (3, OTHERS)), rng.uniform(1.98, 2.12, OTHERS)


def slopes(rng: np.random.Generator) -> Runs:
    """The same for plants that npred simulates one after the other: fewer b, and 30 starts for each."""
    b = np.round(rng.uniform(1.98, 2.12, OTHERS // 30), 6)
    return 1.0 + rng.uniform(-0.2, 0.2, (3, len(b), 30)), b


LOOPS = {
    AS_PUBLISHED: NetworkLoop(
        pomet.plant,
        lambda: pomet.half_cell_short,
        lambda predict, rng: published_loop(predict=predict, runs=others(rng)),
        lambda predict: {"stabilisation": float(np.linalg.norm(published_loop(predict=predict), axis=1).mean())},
        calls=STEPS - 1,
        nodes=34,
        reads_end=True,
        rounds=2,
    ),
    AS_MEANT: NetworkLoop(
        pomet.plant,
        lambda: by_horizon,
        lambda predict, rng: meant(predict, slopes(rng)),
        lambda predict: {"stabilisation": meant(predict)},
        calls=STEPS * (OTHERS // 30),
        kept=500,
        nodes=26,
    ),
}
EXPERIMENT = Experiment(
    "unicycle, time-varying delay",
    "Bhan, Krstic, Shi, arXiv:2411.18964",
    (PublishedNumber("stabilisation", "0.612850"),),
    measure,
    networks("stabilisation", fno="0.618899", deeponet="0.614086", fno_gru="0.637864", deeponet_gru="1.564935"),
    LoopNetworks(LOOPS),
    times=published_times(
        "Euler, 100 steps", numerical=1.9616, fno=0.9903, deeponet=0.2706, fno_gru=1.1782, deeponet_gru=0.5096
    ),
    clock=partial(latency.of_loop, LOOPS[AS_MEANT], latency.METHODS),
)
