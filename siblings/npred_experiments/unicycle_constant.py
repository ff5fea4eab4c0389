"""A wheeled robot with one constant delay of 1 to 1.1 s, known to the predictor.

Bhan, Krstic, Shi, Neural Operators for Predictor Feedback Control of Nonlinear Delay Systems, arXiv:2411.18964.
"""

from functools import partial

import numpy as np

import npred
from npred.loop.closed_loop import Trajectories
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
AHEAD = 98  # samples by which the published metric shifts, whatever the delay
Runs = tuple[np.ndarray, np.ndarray]  # X0 (3, B) and D (B,)


def draws() -> tuple[np.ndarray, np.ndarray]:
    """X0 (3, 25) and D (25,) of the published runs."""
    noise, D = quirks.uniform(np.random.RandomState(1), RUNS, (-0.1, 0.1, 3), (1.0, 1.1, None))
    return 1.0 + noise, D


def published_loop(
    law: Law = pomet.published_law, predict: Predict = pomet.half_cell_short, runs: Runs | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """X and P(1), (1000, 3, 25), of the loop as published: a line by upwind, the rule that ends short of the delay.

    Another predictor may replace that rule, and other runs the published ones.
    """
    X0, D = runs or draws()
    X, P, line = np.empty((STEPS, *X0.shape)), np.zeros((STEPS, *X0.shape)), np.zeros((NODES, 2, len(D)))
    X[0] = X0
    for i in range(1, STEPS):
        t = DT * (i - 1)
        P[i - 1] = end = predict(X[i - 1].T, line.transpose(2, 0, 1), D, t)[:, -1].T
        line = quirks.upwind(line, 1 / D, np.stack(law(tuple(end), t + D)))
        X[i] = X[i - 1] + DT * np.stack(pomet.f(tuple(X[i - 1]), line[0]))
    return X, P


def shifted_error(X: np.ndarray, P: np.ndarray) -> float:
    """The published metric: the mean of |P(1, t) - X(t + 0.98)|, the delay drawn and the short horizon ignored."""
    return float(np.linalg.norm(P[: STEPS - AHEAD] - X[AHEAD:], axis=1).mean())


def rk4() -> Predict:
    """npred's numerical predictor, which networks of the loop as it is meant learn."""
    return npred.predictor(pomet.plant(), "rk4", nx=NODES + 1).predict


def meant_loop(predictor: npred.Predictor, runs: Runs) -> Trajectories:
    """npred's loops, with the right law and exact transport."""
    X0, D = runs
    return npred.simulate(predictor.plant, predictor, D=D, D_hat=D, X0=X0.T, t_end=STEPS * DT, dt=DT)


def meant(predictor: npred.Predictor | None = None) -> float:
    """The mean of |P(1, t) - X(t + D)| with each run's own delay."""
    loop = meant_loop(predictor or npred.predictor(pomet.plant(), "rk4", nx=NODES + 1), draws())
    errors = [_error(loop.t, loop.X[run], loop.P[run], D) for run, D in enumerate(draws()[1])]
    return float(np.mean(errors))


def _error(t: np.ndarray, X: np.ndarray, P: np.ndarray, D: float) -> float:
    arrival = t + D
    within = arrival <= t[-1]
    later = np.stack([np.interp(arrival[within], t, x) for x in X.T], axis=-1)
    return float(np.linalg.norm(P[within] - later, axis=-1).mean())


def measure() -> Measurements:
    """The mean prediction error."""
    return {"prediction": Measured(shifted_error(*published_loop()), meant())}


def others(rng: np.random.Generator) -> Runs:
    """Runs to learn from: starts in the box that the source trains in, twice as wide as that of its runs."""
    return 1.0 + rng.uniform(-0.2, 0.2, (3, OTHERS)), rng.uniform(0.99, 1.11, OTHERS)


PUBLISHED = NetworkLoop(
    pomet.plant,
    lambda: pomet.half_cell_short,
    lambda predict, rng: published_loop(predict=predict, runs=others(rng)),
    lambda predict: {"prediction": shifted_error(*published_loop(predict=predict))},
    calls=STEPS - 1,
    nodes=34,
    reads_end=True,
)
MEANT = NetworkLoop(
    pomet.plant,
    rk4,
    lambda predict, rng: meant_loop(Called(pomet.plant(), NODES + 1, predict), others(rng)),
    lambda predict: {"prediction": meant(Called(pomet.plant(), NODES + 1, predict))},
    calls=STEPS,
    nodes=26,
)
EXPERIMENT = Experiment(
    "unicycle, constant delay",
    "Bhan, Krstic, Shi, arXiv:2411.18964",
    (PublishedNumber("prediction", "0.028543"),),
    measure,
    networks("prediction", fno="0.061734", deeponet="0.058748", fno_gru="0.268882", deeponet_gru="0.156749"),
    LoopNetworks({AS_PUBLISHED: PUBLISHED, AS_MEANT: MEANT}),
    times=published_times(
        "Euler, 100 steps", numerical=2.0886, fno=1.0627, deeponet=0.3541, fno_gru=1.2395, deeponet_gru=0.5308
    ),
    clock=partial(latency.of_loop, MEANT, latency.METHODS),
)
