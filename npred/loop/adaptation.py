"""The delay estimate's update law: w, q1, phi and the projection [DAPF, eqs. 11-14]."""

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from npred import array_checks
from npred.delays import family_of
from npred.delays.family import UPDATE, Kernel
from npred.errors import ConfigError
from npred.loop.delay_law import DelayLaw, interpreted
from npred.plants.base import Plant
from npred.predictors import RK4
from npred.symbolic.compile_cache import jit


@dataclass(frozen=True)
class DelayAdaptation(DelayLaw):
    """D_hat' = gamma Proj_[bounds]{D_hat, phi} [DAPF, eq. 11]: gamma the adaptation gain, b > 0, bounds in seconds.

    Raises ConfigError for a gain, b or bounds that make no sense.
    """

    gamma: float = 1000.0

    def check(self, plant: Plant) -> None:
        """Raise ConfigError where inputs have delays of their own."""
        family_of(plant).needs("adaptation")

    def rate(
        self, plant: Plant, X: np.ndarray, u: np.ndarray, P: np.ndarray, D_hat: np.ndarray, t: float
    ) -> np.ndarray:  # fmt: skip
        """gamma phi, which the bounds make gamma Proj{D_hat, phi}."""
        return self.gamma * self.phi(plant, X, u, P, D_hat, t)

    def phi(self, plant: Plant, X: Any, u: Any, P: Any, D_hat: Any, t: float = 0.0) -> np.ndarray:
        """phi = -∫₀¹ (1+x) q1 w dx / (1 + V(X) + b ∫₀¹ (1+x) w² dx) [DAPF, eq. 12, with V at X(t)].

        X (..., n), u (..., nx, m), P (..., nx, n), D_hat (...) to phi (...). w = u - kappa(P, s) at s = t + x D_hat,
        and q1 = kappa_P r + kappa_s with dr/dx = D_hat (f_P r + f_s), r(0) = f(P(0), u(0), t): [DAPF, eq. 14] where
        f and kappa know no time. The integrals by the trapezoidal rule, r by Heun's method.
        Raises ConfigError where the shapes do not fit the plant or each other.
        """
        named = (("X", X), ("u", u), ("P", P), ("D_hat", D_hat))
        X, u, P, D_hat = (array_checks.floats(name, a) for name, a in named)
        self.check(plant)
        _check(plant, X, u, P)
        shape = array_checks.batch(X=X.shape[:-1], u=u.shape[:-2], P=P.shape[:-2], D_hat=D_hat.shape)
        lanes = [np.broadcast_to(a, (*shape, *a.shape[a.ndim - k :])) for a, k in ((X, 1), (u, 2), (P, 2), (D_hat, 0))]
        X, u, P, D_hat = (_lanes_last(a, len(shape)) for a in lanes)
        count = D_hat.shape[0]
        phi, N = np.empty(count), np.empty(count)
        update_law(plant)(P, X, u, D_hat, float(t), plant.p, self.b, phi, N)
        return phi.reshape(shape)


class Part(NamedTuple):
    """The laws as the time loop runs them: U, then phi and N on lanes, and D_hat += gain phi dt within the bounds."""

    control: Kernel
    update: Kernel
    gain: float
    b: float
    bounds: np.ndarray
    compiled: bool


def part(plant: Plant, law: DelayLaw | None) -> Part:
    """The laws' part of a control step: compiled for the paper's law and for None, which freezes D_hat."""
    control = control_law(plant)
    if law is None:
        return Part(control, _frozen(), 0.0, 1.0, np.array((0.0, np.inf)), True)
    bounds = np.array(law.bounds, dtype=float)
    papers = DelayAdaptation.rate, DelayAdaptation.phi
    if isinstance(law, DelayAdaptation) and (type(law).rate, type(law).phi) == papers:
        return Part(control, update_law(plant), law.gamma, law.b, bounds, True)
    return Part(control, interpreted(law, plant), 1.0, law.b, bounds, False)


@cache
def _frozen() -> Kernel:
    """D_hat stays as it is. Compiled on first use: `npred status` looks laws up, and has no use for Numba."""

    @jit(UPDATE, nogil=True)
    def frozen(P, X, u, D_hat, t, p, b, phi, N):  # type: ignore[no-untyped-def]
        """Nothing is added."""

    return frozen


def _check(plant: Plant, X: np.ndarray, u: np.ndarray, P: np.ndarray) -> None:
    """The kernel reads what the shapes promise: a wrong one would be read past its end."""
    nx = u.shape[-2] if u.ndim > 1 else 0
    for name, a, wanted in (("u", u, (max(nx, 2), plant.m)), ("P", P, (nx, plant.n)), ("X", X, (plant.n,))):
        if a.shape[-len(wanted) :] != wanted:
            axes = ", ".join(["..."] + ["nx"] * (len(wanted) - 1) + [str(wanted[-1])])
            raise ConfigError(f"{name}: expected shape ({axes}), nx >= 2 the same in u and P, got {a.shape}; fix it")


def _lanes_last(a: np.ndarray, leading: int) -> np.ndarray:
    return np.array(np.moveaxis(a.reshape(-1, *a.shape[leading:]), 0, -1), order="C")


@cache
def update_law(plant: Plant) -> Kernel:
    """The paper's law for D_hat: phi [DAPF, eq. 12] and N = 1 + V + b ∫ (1+x) w²."""
    return family_of(plant).update()


@cache
def control_law(plant: Plant) -> Kernel:
    """U_j = kappa_j(P(r_j)) with r_j = 1 for one delay [DAPF, eq. 9]; between nodes P(r_j) is a step of RK4."""
    return family_of(plant).control(RK4.step)
