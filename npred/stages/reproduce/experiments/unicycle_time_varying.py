"""A wheeled robot with a delay that varies in time, D(t) = (1 + t) / (1 + b t), b drawn from 2 to 2.1.

Bhan, Krstic, Shi, Neural Operators for Predictor Feedback Control of Nonlinear Delay Systems, arXiv:2411.18964.
"""

import numpy as np

import npred
from npred import plants
from npred.stages.reproduce import pomet, quirks
from npred.stages.reproduce.experiment import Experiment, Measured, Measurements, PublishedNumber, networks
from npred.stages.reproduce.pomet import Law

RUNS, STEPS, NODES, DT = 25, 1000, 100, 0.01


def draws() -> tuple[np.ndarray, np.ndarray]:
    """X0 (3, 25) and b (25,) of the published runs."""
    noise, b = quirks.uniform(np.random.RandomState(1), RUNS, (-0.1, 0.1, 3), (2.0, 2.1, None))
    return 1.0 + noise, b


def arrival(t: float, b: np.ndarray) -> np.ndarray:
    """σ(t), when the command of time t acts: the solution of s - (1 + s) / (1 + b s) = t."""
    rest = -b * t
    return (np.sqrt(rest**2 + 4 * b * (1 + t)) - rest) / (2 * b)


def arrival_rate(t: float, b: np.ndarray) -> np.ndarray:
    """σ'(t)."""
    rest = -b * t
    return 0.5 + (1 / b - rest / (2 * b)) / (2 * np.sqrt((t + 1) / b + rest**2 / (4 * b**2)))


def published_loop(law: Law = pomet.published_law) -> np.ndarray:
    """X, (1000, 3, 25), of the loop as published: the line moves at 1 + x (σ' - 1) / (σ - t).

    Right is (1 + x (σ' - 1)) / (σ - t), which takes σ - t, 0.5 to 0.7 s. The published line takes about 1 s, so the
    plant gets the commands later than the predictor believes. With the right speed dt = dx would be unstable.
    """
    X0, b = draws()
    X, line = np.empty((STEPS, *X0.shape)), np.zeros((NODES, 2, RUNS))
    x = DT * np.arange(NODES - 1)[:, None, None]
    X[0] = X0
    for i in range(1, STEPS):
        t = DT * (i - 1)
        sigma = arrival(t, b)
        end = quirks.half_cell_short(pomet.f, tuple(X[i - 1]), line, sigma - t, DT)[-1]
        courant = 1 + x * (arrival_rate(t, b) - 1) / (sigma - t)  # times dt / dx = 1
        line = quirks.upwind(line, courant, np.stack(law(end, sigma)))
        X[i] = X[i - 1] + DT * np.stack(pomet.f(tuple(X[i - 1]), line[0]))
    return X


def meant() -> float:
    """The mean of |X| with the right law and exact transport, by npred: one plant per b."""
    X0, b = draws()
    loops = []
    for start, slope in zip(X0.T, b, strict=True):
        plant = plants.resolve("unicycle_time_delay", {"b": float(slope)})
        predictor = npred.predictor("rk4", plant, nx=NODES + 1)
        loops.append(npred.simulate(plant, predictor, X0=start, t_end=(STEPS - 1) * DT, dt=DT))
    return float(np.mean([np.linalg.norm(loop.X, axis=-1).mean() for loop in loops]))


def measure() -> Measurements:
    """The mean of |X| over the runs and the samples."""
    published = float(np.linalg.norm(published_loop(), axis=1).mean())
    return {"stabilisation": Measured(published, meant())}


EXPERIMENT = Experiment(
    "unicycle, time-varying delay",
    "Bhan, Krstic, Shi, arXiv:2411.18964",
    (PublishedNumber("stabilisation", "0.612850"),),
    measure,
    networks("stabilisation", fno="0.618899", deeponet="0.614086", fno_gru="0.637864", deeponet_gru="1.564935"),
)
