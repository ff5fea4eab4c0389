"""A wheeled robot whose commands are the later the farther it is from the origin: D(X) = x² + y².

Bekiaris-Liberis, Krstic, Compensation of state-dependent input delay for nonlinear systems, IEEE TAC 58 (2013) 275-289.
"""

from typing import Any

import numpy as np

import npred
from npred import plants
from npred_experiments import pomet
from npred_experiments.experiment import Experiment, Measured, Measurements, PublishedNumber

T, DT = 10.0, 0.001


class UnicycleStateDelay(pomet.UnicycleOneDelay):
    """The robot with its delay."""

    @staticmethod
    def delay(x: Any, t: Any, p: Any, M: Any) -> Any:
        return x.x**2 + x.y**2


def oracle(X0: tuple[float, ...], end: float = T, step: float = DT) -> np.ndarray:
    """X(end): the compensated robot rests until t = D(X0), then moves as the loop without delay does."""
    t, X = X0[0] ** 2 + X0[1] ** 2, np.array(X0)
    count = round((end - t) / step)
    step = (end - t) / count

    def rate(t: float, X: np.ndarray) -> np.ndarray:
        return np.array(pomet.f(tuple(X), pomet.right_law(tuple(X), t)))

    for _ in range(count):
        a = rate(t, X)
        b = rate(t + step / 2, X + step / 2 * a)
        c = rate(t + step / 2, X + step / 2 * b)
        X = X + step / 6 * (a + 2 * b + 2 * c + rate(t + step, X + step * c))
        t += step
    return X


def meant(start: float, dt: float = DT) -> float:
    """|X(10) - oracle| of npred's loop from (start, start, start); its U is held over each step."""
    plant = plants.make("unicycle_state_delay", UnicycleStateDelay)
    predictor = npred.predictor(plant, "rk4", nx=201)
    loop = npred.simulate(plant, predictor, X0=[start] * 3, t_end=T, dt=dt)
    return float(np.linalg.norm(loop.X[-1] - oracle((start,) * 3)))


def measure() -> Measurements:
    """The distances at t = 10 s; nothing is published that they could stand beside."""
    return {f"|X(10) - oracle| from {start:g}": Measured(None, meant(start)) for start in (0.5,)}


EXPERIMENT = Experiment(
    "wheeled robot, delay x² + y²",
    "Bekiaris-Liberis, Krstic, IEEE TAC 58 (2013) 275-289",
    (PublishedNumber("|X(10) - oracle| from 0.5", ""),),
    measure,
)
