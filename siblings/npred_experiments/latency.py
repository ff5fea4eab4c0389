"""The time of one prediction, called as a control loop calls it, one state at a time, and its error."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

import npred
from npred.base import grid
from npred.kernels.kernel import bound
from npred.lab.stages.bench import timing
from npred.plants import Plant
from npred.prediction.methods import Predictor
from npred_experiments.experiment import NUMERICAL, PredictionTime
from npred_experiments.network_loop import NetworkLoop, RecordedCalls, recorded
from npred_experiments.regression import Quadratic

CALLS, PROBES, SECONDS = 2000, 200, 1.0  # at most; PROBES of them differ
FINE = 1001  # nodes of the predictor that errors are taken from
Methods = Mapping[str, tuple[str, int]]  # by what their rows say: a numerical predictor and its nodes
METHODS: Methods = {
    "Euler, 100 steps": ("euler", 101),
    "Heun, 100 steps": ("heun", 101),
    "Heun, 50 steps": ("heun", 51),
    "Heun, 20 steps": ("heun", 21),
}


class PredictorInputs(NamedTuple):
    """The calls of predictors: X (N, n), u (N, nx, m), D_hat (N,), t (N,), in double precision."""

    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray
    t: np.ndarray

    @classmethod
    def of(cls, samples: RecordedCalls) -> "PredictorInputs":
        """Some of the recorded calls, from first to last, of those after the first delay.

        Before, u jumps from its past to the first command, and every method is of first order.
        """
        later = np.flatnonzero(samples.t > samples.D_hat)
        rows = later[np.linspace(0, len(later) - 1, min(PROBES, len(later))).astype(int)]
        return cls(*(array[rows].astype(float) for array in (samples.X, samples.u, samples.D_hat, samples.t)))

    def on(self, nx: int) -> "PredictorInputs":
        """The same with u on nx nodes."""
        return self._replace(u=grid.means(self.u, nx))


def of_loop(loop: NetworkLoop, methods: Methods) -> list[PredictionTime]:
    """The times of numerical predictors on calls that a loop makes."""
    return numerical(loop.plant(), PredictorInputs.of(recorded(loop)), methods)


def numerical(plant: Plant, calls: PredictorInputs, methods: Methods) -> list[PredictionTime]:
    """The times of numerical predictors, and the largest of their errors at the end of the delay."""
    exact, rows = _ends(plant, calls, "rk4", FINE), []
    for setting, (method, nx) in methods.items():
        ms = milliseconds(npred.predictor(plant, method, nx=nx), calls.on(nx))
        error = _largest(_ends(plant, calls, method, nx) - exact)
        rows.append(PredictionTime(predictor=NUMERICAL, setting=setting, ms=ms, error=error))
    return rows


def milliseconds(run: Predictor, calls: PredictorInputs, rest: Quadratic | None = None) -> float:
    """The median time of one call on the loop's memory; with a regression, of both and their sum."""
    predict, p, P = run.lanes(), run.plant.p, np.empty((calls.u.shape[1], run.plant.n, 1))
    memory = [
        (np.array(X)[:, None], np.array(u)[:, :, None], np.array([D_hat]), float(t))
        for X, u, D_hat, t in zip(*calls, strict=True)
    ]
    predictions = [bound(predict, *sample, p, P) for sample in memory]

    def call(k: int) -> None:
        X, u, _, _ = memory[k % len(memory)]
        predictions[k % len(memory)]()
        if rest:
            P[:, :, 0] += rest(X.T, u.transpose(2, 0, 1))[0]

    return _median(call)


def median_of(function: Callable[[], object]) -> float:
    """The median milliseconds of one call of a function."""

    def call(k: int) -> None:
        function()

    return _median(call)


def _median(call: timing.Call) -> float:
    return float(np.median(timing.sample({"": call}, CALLS, SECONDS)[""])) / 1e6


def _ends(plant: Plant, calls: PredictorInputs, method: str, nx: int) -> np.ndarray:
    """P(1), (N, n)."""
    X, u, D_hat, t = calls.on(nx)
    return npred.predictor(plant, method, nx=nx).predict(X, u, D_hat, t)[:, -1]


def _largest(errors: np.ndarray) -> float:
    return float(np.linalg.norm(errors, axis=-1).max())
