"""A Luenberger observer with samples: one gain for all states of the plant."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.estimation.observers.base import SIGMAS, Observer
from npred.estimation.observers.ekf import EKF
from npred.formulas import Array, Value, programs, tape
from npred.kernels.formula import Formulas, vector
from npred.kernels.kernel import Kernel, made, skeleton
from npred.plants.base import Plant
from npred.prediction.delays import problem
from npred.prediction.methods.runge_kutta import RK4

STEP = 0.5  # the longest of RK4, times the fastest pole


class Luenberger(Observer):
    """z' = F(z, U) + L (w - output(x)), z = (x, d), with one gain L, and w the outputs, predicted from sample to
    sample,
    w' = output_x f + output_t, w(t_k) = Y_k [Karafyllis, Kravaris, IEEE TAC 54 (2009) 2169].

    Poles λ of the linearised plant that are slower than `rate`, or unstable, go to -2 rate - λ, which is the smallest
    gain that makes all as fast as `rate`; the others stay [Anderson, Moore, Linear Optimal Control, 1971, ch. 3, in the
    limit of a small weight on the state]. The outputs (see Observer) are weighed by their half ranges over the box.
    From these its gate has the spread of an output less w, to which it adds twice the last difference that was taken.
    L is that of one point: where the plant is driven far from it, or samples are rare, take the EKF.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    rate : float, 1/s, optional
        How fast errors fade near the equilibrium; by default the geometric mean of the rates of the loop of kappa.
    offset : bool, default False
        Whether d is estimated.
    X0 : (n,), optional
        State to begin with; by default the middle of the box, and without a box the equilibrium or the reference at
        t = 0.
    outputs : list of str, optional
        The measured states of a plant that declares no output; by default all.

    Raises
    ------
    ConfigError
        For a plant that is not traced, or without an operating point that tells all states at t = 0, and for
        settings that do not fit.
    """

    pulls = True

    def __init__(
        self, plant: Plant, rate: float | None = None, offset: bool = False, X0: Any = None,
        outputs: Sequence[str] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(plant, offset=bool(offset), X0=X0, outputs=outputs)
        self.rate = self.sizes.rate if rate is None else array_checks.number("Luenberger: rate", rate)
        if not 0 < self.rate < np.inf:
            raise ConfigError(f"Luenberger: rate expected 1/s above 0, got {rate}; try {self.sizes.rate:.3g}")
        A, C = self.linearised(*self.operating_point)
        if self.rank(*self.operating_point) < self.size:
            what = f"expected {', '.join(self.outputs)} to tell all of plant {plant.name} at t = 0"
            raise ConfigError(f"Luenberger: {what}, got outputs that do not; take the EKF")
        self.L = smallest_gain(A, C, self.sizes.dy, self.rate)
        fastest = max(np.abs(np.linalg.eigvals(matrix)).max() for matrix in (A, A - self.L @ C, self.L @ C))
        self.settings = np.concatenate([[STEP / fastest], self.L.ravel(), (self.sizes.dy / SIGMAS) ** 2])

    @cached_property
    def filter(self) -> EKF:
        return EKF(self.plant, offset=self.offset, X0=self.X0, outputs=self.outputs)

    def start(self) -> np.ndarray:
        w = self.measured(self.X0)
        return np.concatenate([self.X0, np.zeros(self.plant.m), w, self.sizes.dy**2])

    def anew(self) -> tuple[np.ndarray, np.ndarray]:
        memory, count = self.start(), len(self.outputs)
        return memory, np.concatenate([np.zeros(len(memory) - count), np.ones(count)])

    @cached_property
    def follow(self) -> Kernel:
        n, m, count, of = self.plant.n, self.plant.m, len(self.outputs), Formulas(self.plant, ())
        trace = of.trace
        L = np.reshape(trace.vector("l", self.size * count), (self.size, count))

        def slope(z: Array, u: Array, t: Value) -> Array:
            x, d, w = z[:n], z[n : n + m], z[n + m :]
            y, f = self.traced_outputs(trace, x, t), trace.f(x, u + d, t)
            pull = L @ (w - y)
            moves = programs.derivative([*y], [t, *x], [1.0, *f])
            return np.concatenate([f + pull[:n], pull[n:] if self.offset else np.zeros(m), moves])

        z, u = trace.vector("z", n + m + count), trace.vector("u", m)
        y = RK4.step(slope, z, u, u, u, trace.input("t"), trace.input("h"))
        y = [*self.plant.stopped(y[:n], tape.M), *y[n:]]
        arguments = [vector("z", len(z), "1"), vector("u", m, "1"), vector("l", L.size, "1"), "t", "h"]
        functions = {"STEP": of.function(y, arguments, {"y": len(z)}, "1")}
        text = skeleton("luenberger_follow.h") + skeleton("follow.h")
        return made("luenberger_follow", problem.FOLLOW, text, functions, {"N": n, "M": m})

    @cached_property
    def correct(self) -> Kernel:
        of = Formulas(self.plant, ())
        sizes = {"N": self.plant.n, "M": self.plant.m, "SIZE": self.size, "OUTPUTS": len(self.outputs)}
        text, functions = skeleton("luenberger_correct.h"), {"OUTPUT": self.output_function(of)}
        return made("luenberger_correct", problem.CORRECT_BY, text, functions, sizes)


def smallest_gain(A: np.ndarray, C: np.ndarray, dy: np.ndarray, rate: float) -> np.ndarray:
    """L = P C' R⁻¹, R = diag(dy²), with the stabilising P of (A + rate I) P + P (A + rate I)' = P C' R⁻¹ C P."""
    size, weighed = len(A), C.T / dy**2
    faster = A + rate * np.eye(size)
    H = np.block([[faster.T, -weighed @ C], [np.zeros((size, size)), -faster]])
    for _ in range(100):  # the sign of H by Newton's method [Roberts, Int. J. Control 32 (1980) 677]
        inverse = np.linalg.inv(H)
        scale = abs(np.linalg.det(H)) ** (-1 / len(H))
        last, H = H, 0.5 * (scale * H + inverse / scale)
        if np.abs(H - last).max() <= 1e-14 * np.abs(H).max():
            break
    S = H + np.eye(2 * size)
    P = np.linalg.lstsq(S[:, size:], -S[:, :size], rcond=None)[0]
    return P @ weighed
