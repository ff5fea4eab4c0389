"""A wheeled robot with one constant delay of 1 to 1.1 s, known to the predictor.

Bhan, Krstic, Shi, Neural Operators for Predictor Feedback Control of Nonlinear Delay Systems, arXiv:2411.18964.
"""

import numpy as np

import npred
from npred import plants
from npred.stages.reproduce import pomet, quirks
from npred.stages.reproduce.experiment import Experiment, Measured, Measurements, PublishedNumber, networks
from npred.stages.reproduce.pomet import Law

RUNS, STEPS, NODES, DT = 25, 1000, 100, 0.01
AHEAD = 98  # samples by which the published metric shifts, whatever the delay


def draws() -> tuple[np.ndarray, np.ndarray]:
    """X0 (3, 25) and D (25,) of the published runs."""
    noise, D = quirks.uniform(np.random.RandomState(1), RUNS, (-0.1, 0.1, 3), (1.0, 1.1, None))
    return 1.0 + noise, D


def published_loop(law: Law = pomet.published_law) -> tuple[np.ndarray, np.ndarray]:
    """X and P(1), (1000, 3, 25), of the loop as published: a line by upwind, the rule that ends short of the delay."""
    X0, D = draws()
    X, P, line = np.empty((STEPS, *X0.shape)), np.zeros((STEPS, *X0.shape)), np.zeros((NODES, 2, RUNS))
    X[0] = X0
    for i in range(1, STEPS):
        end = quirks.half_cell_short(pomet.f, tuple(X[i - 1]), line, D, DT)[-1]
        P[i - 1] = end
        line = quirks.upwind(line, 1 / D, np.stack(law(end, DT * (i - 1) + D)))
        X[i] = X[i - 1] + DT * np.stack(pomet.f(tuple(X[i - 1]), line[0]))
    return X, P


def shifted_error(X: np.ndarray, P: np.ndarray) -> float:
    """The published metric: the mean of |P(1, t) - X(t + 0.98)|, the delay drawn and the short horizon ignored."""
    return float(np.linalg.norm(P[: STEPS - AHEAD] - X[AHEAD:], axis=1).mean())


def meant() -> float:
    """The mean of |P(1, t) - X(t + D)| with the right law, exact transport and each run's own delay, by npred."""
    X0, D = draws()
    plant = plants.make("unicycle_one_delay", pomet.UnicycleOneDelay)
    loop = npred.simulate(
        plant, npred.predictor("rk4", plant, nx=NODES + 1), D=D, D_hat=D, X0=X0.T, t_end=STEPS * DT, dt=DT
    )
    errors = [_error(loop.t, loop.X[run], loop.P[run], D[run]) for run in range(RUNS)]
    return float(np.mean(errors))


def _error(t: np.ndarray, X: np.ndarray, P: np.ndarray, D: float) -> float:
    arrival = t + D
    within = arrival <= t[-1]
    later = np.stack([np.interp(arrival[within], t, x) for x in X.T], axis=-1)
    return float(np.linalg.norm(P[within] - later, axis=-1).mean())


def measure() -> Measurements:
    """The mean prediction error."""
    return {"prediction": Measured(shifted_error(*published_loop()), meant())}


EXPERIMENT = Experiment(
    "unicycle, constant delay",
    "Bhan, Krstic, Shi, arXiv:2411.18964",
    (PublishedNumber("prediction", "0.028543"),),
    measure,
    networks("prediction", fno="0.061734", deeponet="0.058748", fno_gru="0.268882", deeponet_gru="0.156749"),
)
