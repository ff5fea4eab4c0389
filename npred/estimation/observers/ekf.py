"""The extended Kalman filter of a plant in continuous time with samples in discrete time."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.estimation.observers.base import Observer
from npred.formulas import programs, tape
from npred.kernels.formula import Formulas, vector
from npred.kernels.kernel import Kernel, made, skeleton
from npred.plants.base import Plant
from npred.prediction.delays import problem
from npred.prediction.methods.runge_kutta import RK4

MODEL = 0.1  # the share of f that the model does not know, by default
NOISE = 0.01  # times the half range of an output
OFFSET = 0.1  # times the half range of an input, in the time in which the loop moves


class EKF(Observer):
    """The extended Kalman filter [Jazwinski, Stochastic Processes and Filtering Theory, 1970, theorem 8.1].

    The plant is X' = f(X, U + d) + w, d' = v, Y_k = output(X(t_k)) + e_k. The state goes on by RK4 with the input held,
    the covariance P by the exact derivative of that step; a sample corrects both, one output after the other. P is kept
    as U D U', so that it is symmetric and positive also in single precision.

    1 / T is the geometric mean of the rates of the loop of kappa without delay. d begins at 0. For a state without a
    range in the box, half of it is taken as 1, or as X0 where that is larger. Outputs: see Observer.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    Q : float, (n,) or (n, n), X² / s, optional
        Spectral density of w. By default the model is wrong by a tenth of f, which changes in the time T of the
        loop: Q_ii = (f_i / 10)² T, with f_i the root of the mean square of f over the box.
    R : float or (l,), squares of the outputs' units, optional
        Variance of e; by default its deviation is 1 % of half the output's range.
    offset : bool, float or (m,), U² / s, default False
        Whether d is estimated, or the spectral density of v. With True d moves by a tenth of half the range that
        kappa has over the box, in T.
    X0 : (n,), optional
        State to begin with; by default the middle of the box, and without a box the rest or the reference at
        t = 0.
    P0 : float, (n,) or (n, n), squares of the states' units, optional
        Variance of X0; by default its deviation is half the box.
    outputs : list of str, optional
        Names of the outputs and states that are measured; by default the plant's outputs, and where it declares none,
        all states.

    Raises
    ------
    ConfigError
        For a plant that is not traced, for outputs that do not tell the state, and for settings that do not fit.
    """

    def __init__(
        self, plant: Plant, Q: Any = None, R: Any = None, offset: Any = False, X0: Any = None, P0: Any = None,
        outputs: Sequence[str] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(plant, offset=offset, X0=X0, outputs=outputs)
        sizes = self.sizes
        walk = (OFFSET * sizes.du) ** 2 * sizes.rate if offset is True else offset
        Q = (MODEL * sizes.f) ** 2 / sizes.rate if Q is None else Q
        self.Q = self._whole("Q", Q, self.fitting("offset", walk, plant.m) if self.offset else np.zeros(0))
        self.P0 = self._whole("P0", sizes.dx**2 if P0 is None else P0, (OFFSET * sizes.du[: self.size - plant.n]) ** 2)
        self.R = self.fitting("R", (NOISE * sizes.dy) ** 2 if R is None else R, len(self.outputs))
        if not (self.R > 0).all():
            raise ConfigError(f"EKF: R expected variances above 0, got {self.R.tolist()}; give the square of the noise")
        self.settings = np.concatenate([self.R, factors(self.Q).ravel()])

    @property
    def filter(self) -> "EKF":
        return self

    def start(self) -> np.ndarray:
        return np.concatenate([self.X0, np.zeros(self.plant.m), factors(self.P0).ravel()])

    def anew(self) -> tuple[np.ndarray, np.ndarray]:
        variances = np.concatenate([np.zeros(self.plant.n + self.plant.m), np.eye(self.size).ravel()])
        return self.start(), variances

    def covariance(self, memory: np.ndarray) -> np.ndarray:
        """P of a memory, of X or of (X, d)."""
        stored = memory[self.plant.n + self.plant.m :].reshape(self.size, self.size)
        U = np.triu(stored, 1) + np.eye(self.size)
        return (U * np.diag(stored)) @ U.T

    @cached_property
    def follow(self) -> Kernel:
        n, m, of = self.plant.n, self.plant.m, Formulas(self.plant, ())
        trace = of.trace
        x, u, v, w = (trace.vector(name, size) for name, size in zip("xuvw", (n, m, n, m), strict=True))
        y = self.plant.stopped(RK4.step(trace.f, x, u, u, u, trace.input("t"), trace.input("h")), tape.M)
        change = programs.derivative([*y], [*x, *u], [*v, *w])
        arguments = [*(vector(name, size, "1") for name, size in zip("xuvw", (n, m, n, m), strict=True)), "t", "h"]
        functions = {"STEP": of.function([*y, *change], arguments, {"y": n, "change": n}, "1")}
        text = skeleton("ekf_follow.h") + skeleton("follow.h")
        return made("ekf_follow", problem.FOLLOW, text, functions, self._counts | {"WIDTH": 3 * self.size})

    @cached_property
    def correct(self) -> Kernel:
        return self._correct(gains=False)

    @cached_property
    def correct_with_gains(self) -> Kernel:
        """The same on a memory that has room for the gain (size, l) at its end, which it writes there."""
        return self._correct(gains=True)

    def _correct(self, gains: bool) -> Kernel:
        n, of = self.plant.n, Formulas(self.plant, ())
        x = self.plant.stopped(of.trace.vector("x", n), tape.M)  # a state stays within the plant's state_bounds
        stop = of.function([*x], [vector("x", n, "1")], {"y": n}, "1")
        functions = {"OUTPUT": self.output_function(of), "STOP": stop}
        sizes = self._counts | {"GAINS": int(gains)}
        return made("ekf_correct", problem.CORRECT_BY, skeleton("ekf_correct.h"), functions, sizes)

    @property
    def _counts(self) -> dict[str, int]:
        return {"N": self.plant.n, "M": self.plant.m, "SIZE": self.size, "OUTPUTS": len(self.outputs)}

    def _whole(self, name: str, of_state: Any, of_offsets: np.ndarray) -> np.ndarray:
        """The covariance (size, size) of the state and the offsets."""
        n, array = self.plant.n, array_checks.floats(f"EKF: {name}", of_state)
        array = array if array.shape == (n, n) else np.diag(self.fitting(name, array, n))
        whole = np.diag(np.concatenate([np.zeros(n), of_offsets]))
        whole[:n, :n] = array
        array_checks.finite(f"EKF: {name}", whole)
        if not np.allclose(whole, whole.T) or np.linalg.eigvalsh(whole).min() < -1e-12 * np.trace(whole):
            raise ConfigError(f"EKF: {name} expected a symmetric matrix without negative eigenvalues, got others")
        return whole


def factors(P: np.ndarray) -> np.ndarray:
    """U, unit upper triangular, with D as its diagonal: P = U D U' [Bierman, 1977, ch. III]."""
    rest, result = P.copy(), np.zeros_like(P)
    for j in reversed(range(len(P))):
        D = result[j, j] = max(rest[j, j], 0.0)
        if D > 0:
            result[:j, j] = rest[:j, j] / D
            rest[:j, :j] -= D * np.outer(result[:j, j], result[:j, j])
    return result
