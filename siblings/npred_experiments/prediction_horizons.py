"""The delays of a linear plant with an observer, D1(t) and D2(t), and the inverse of t - D(t) that its predictor needs.

arXiv:2603.29117 (Neural approximated predictor horizons).
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from npred_experiments import latency
from npred_experiments.experiment import (
    AS_MEANT,
    AS_PUBLISHED,
    NUMERICAL,
    Experiment,
    Measured,
    Measurements,
    Place,
    PredictionTime,
    PublishedNumber,
    PublishedTime,
    TrainedForLoop,
)
from npred_experiments.horizons import Delay, draws, inverse, late, rate, times

NAMES = ("a", "b", "α", "ω", "φ")
DIGITS = (("0.40", "0.31", "-0.10", "4.95", "0.95"), ("0.28", "0.15", "-0.06", "1.28", "0.82"))
RESIDUAL = "|φ(ρ(t)) - t|"
RESIDUALS = ((f"{RESIDUAL}, Euler", "3e-4"), (f"{RESIDUAL}, RK4", "1e-11"))


def integrated(delay: Delay, t: np.ndarray, method: Callable[..., float]) -> np.ndarray:
    """ρ by ρ' = 1 / φ'(ρ), as published, from the exact ρ(t_0)."""
    rho = np.empty_like(t)
    rho[0] = inverse(delay, t[:1])[0]
    step = float(t[1] - t[0])
    for k in range(len(t) - 1):
        rho[k + 1] = method(delay, rho[k], step)
    return rho


def euler(delay: Delay, rho: float, step: float) -> float:
    """One step of Euler's method."""
    return rho + step / float(rate(delay, rho))


def rk4(delay: Delay, rho: float, step: float) -> float:
    """One step of the classical Runge-Kutta method."""
    slopes = [0.0]
    for share in (0.0, 0.5, 0.5, 1.0):
        slopes.append(1.0 / float(rate(delay, rho + share * step * slopes[-1])))
    return rho + step / 6 * (slopes[1] + 2 * slopes[2] + 2 * slopes[3] + slopes[4])


def residual(delay: Delay, method: Callable[..., float] | None = None) -> float:
    """The largest |φ(ρ(t)) - t| on [0, 12] at steps of 1 ms; None: Newton's method, for all times at once."""
    t = times()
    return missed(delay, inverse(delay, t) if method is None else integrated(delay, t, method))


def missed(delay: Delay, rho: np.ndarray) -> float:
    """The largest |φ(ρ(t)) - t|, with ρ at the times of a run."""
    return float(np.abs(late(delay, rho) - times()).max())


def measure() -> Measurements:
    """The drawn delays, and how well each method inverts φ1."""
    pair = draws()
    drawn = {f"D{k}: {name}": value for k, d in enumerate(pair, 1) for name, value in zip(NAMES, d, strict=True)}
    rows = {name: Measured(value, value) for name, value in drawn.items()}
    exact = residual(pair[0])
    methods = zip(RESIDUALS, (euler, rk4), strict=True)
    return rows | {name: Measured(residual(pair[0], method), exact) for (name, _), method in methods}


def clock() -> list[PredictionTime]:
    """The time of ρ at all times of a run, by the published methods and by Newton's, and its residual."""
    delay, t = draws()[0], times()[:-1]
    rows = []
    for name, method in (("Euler", euler), ("RK4", rk4), ("Newton", None)):
        ms = latency.median_of(partial(integrated, delay, t, method) if method else partial(inverse, delay, t))
        setting = f"ρ at 12 000 times, {name}"
        rows.append(PredictionTime(predictor=NUMERICAL, setting=setting, ms=ms, error=residual(delay, method)))
    return rows


def train(name: str, network: str, place: Place) -> tuple[dict[str, dict[str, float]], list[TrainedForLoop]]:
    """The residual of a network, which is trained now, for the figure's D1: the same in both loops."""
    from npred_experiments import horizon_network

    operator, row = horizon_network.trained(*place)
    delay = draws()[0]
    residuals = {RESIDUAL: missed(delay, horizon_network.inverse(operator, delay, times()))}
    return {AS_PUBLISHED: residuals, AS_MEANT: residuals}, [row]


EXPERIMENT = Experiment(
    "prediction horizons of delays that vary in time",
    "arXiv:2603.29117",
    (
        *(
            PublishedNumber(f"D{k}: {name}", digits)
            for k, row in enumerate(DIGITS, 1)
            for name, digits in zip(NAMES, row, strict=True)
        ),
        *(PublishedNumber(name, digits) for name, digits in RESIDUALS),
    ),
    measure,
    (PublishedNumber(RESIDUAL, "5e-2", "fno"),),
    train,
    times=(
        PublishedTime(NUMERICAL, "ρ at 12 000 times, Euler", 11.98),
        PublishedTime(NUMERICAL, "ρ at 12 000 times, RK4", 42.50),
        PublishedTime("fno", "ρ at 12 000 times", 2.01),
    ),
    clock=clock,
)
