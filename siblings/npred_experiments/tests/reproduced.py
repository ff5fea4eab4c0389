"""A loop of the scalar plant that any predictor may serve, for tests of what networks learn of experiments."""

import numpy as np

import npred
from npred import plants
from npred.loop.closed_loop import Trajectories
from npred_experiments.network_loop import Called, NetworkLoop, Predict

NX, STEPS = 21, 40


def small_loop() -> NetworkLoop:
    """X' of the scalar plant with D = 0.5; its metric is the size of the prediction at the end of 2 s, from 0.4."""
    return NetworkLoop(
        lambda: plants.resolve("scalar"),
        lambda: numerical().predict,
        lambda predict, rng: _simulated(predict, rng.uniform(-0.5, 0.5, (40, 1))),
        lambda predict: {"error": 1.0 + float(np.abs(_simulated(predict, np.array([[0.4]])).X[:, -1]).max())},
        calls=STEPS,
        kept=10,
    )


def numerical() -> npred.Predictor:
    """What its networks learn."""
    return npred.predictor(plants.resolve("scalar"), "rk4", nx=NX)


def _simulated(predict: Predict, X0: np.ndarray) -> Trajectories:
    predictor = Called(plants.resolve("scalar"), NX, predict)
    return npred.simulate(predictor.plant, predictor, D=0.5, D_hat=0.5, X0=X0, t_end=STEPS * 0.05, dt=0.05)
