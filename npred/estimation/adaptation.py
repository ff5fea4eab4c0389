"""The law of the delay estimate: w, q1, phi and the projection [DAPF, eqs. 11-14]; a gain where none is given."""

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, Self

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.estimation.delay_law import DelayLaw, delay
from npred.plants import inputs
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.delays.problem import Kernel

STARTS, SPAN, SETTLING = 16, 20.0, 5.0  # starts of the box, and how long they are followed: delays, time constants
CELLS = (200, 800)  # parts of that time; more if fewer overflow


@dataclass(frozen=True)
class DelayAdaptation(DelayLaw):
    """D_hat' = gamma Proj_[bounds]{D_hat, phi} [DAPF, eq. 11].

    A gamma that is left out is None until a loop says how long delays are, and then `suited_gamma`: 1000 for the
    paper's plant with D = 1 s.

    Parameters
    ----------
    gamma : float above 0, optional
        Adaptation gain; by default what npred.estimation.adaptation.suited_gamma finds for plant and delay.
    b : float above 0, default 1.0
        Weight of w in N = 1 + V + b ∫₀¹ (1 + x) w² dx.
    bounds : (low, high), in the plant's unit of time, optional
        The range of D_hat; by default 0.1 to 4 times the longest delay of a loop, widened to D and D_hat.

    Raises
    ------
    ConfigError
        For a gain, b or bounds that make no sense.
    """

    gamma: float = None  # type: ignore[assignment]

    def suited(self, plant: Plant, D: Any, D_hat: Any) -> Self:
        """The law with the bounds and the gamma that were left out. Raises ConfigError as `suited_gamma` does."""
        law = super().suited(plant, D, D_hat)
        return law if law.gamma is not None else law._with("gamma", suited_gamma(plant, delay(plant, D, D_hat), law.b))

    def check(self, plant: Plant) -> None:
        """Raise ConfigError where inputs have several delays, and where there is no V to divide by."""
        problem_of(plant).needs("adaptation")
        if not plant.declares_V:
            cure = "declare one, as npred plants check offers, or take DelayObserver or L1Adaptation, which need none"
            raise ConfigError(f"{undeclared(plant)}; {cure}")

    def rate(
        self, plant: Plant, X: np.ndarray, u: np.ndarray, P: np.ndarray, D_hat: np.ndarray, t: float
    ) -> np.ndarray:
        """gamma phi, which the bounds make gamma Proj{D_hat, phi}."""
        return self.gamma * self.phi(plant, X, u, P, D_hat, t)

    def kernel(self, plant: Plant) -> Kernel:
        return update_law(plant)

    def phi(self, plant: Plant, X: Any, u: Any, P: Any, D_hat: Any, t: float = 0.0) -> np.ndarray:
        """phi = -∫₀¹ (1+x) q1 w dx / (1 + V(X) + b ∫₀¹ (1+x) w² dx) [DAPF, eq. 12, with V at X(t)].

        X (..., n), u (..., nx, m), P (..., nx, n), D_hat (...) to phi (...). w = u - kappa(P, s) at s = t + x D_hat,
        and q1 = kappa_P r + kappa_s with dr/dx = D_hat (f_P r + f_s), r(0) = f(P(0), u(0), t): [DAPF, eq. 14] where
        f and kappa know no time. The integrals by the trapezoidal rule, r by Heun's method. Raises ConfigError where
        the shapes do not fit the plant or each other.
        """
        named = (("X", X), ("u", u), ("P", P), ("D_hat", D_hat))
        X, u, P, D_hat = (array_checks.floats(name, a) for name, a in named)
        self.check(plant)
        nx = u.shape[-2] if u.ndim > 1 else 0
        for name, a, last in (("u", u, (max(nx, 2), plant.m)), ("P", P, (nx, plant.n)), ("X", X, (plant.n,))):
            if a.shape[-len(last) :] != last:  # the kernel would read past the end of such an array
                axes = ", ".join(["...", *["nx"] * (len(last) - 1), str(last[-1])])
                what = f"expected shape ({axes}), nx >= 2 the same in u and P"
                raise ConfigError(f"{name}: {what}, got {a.shape}; reshape")
        shape = array_checks.batch(X=X.shape[:-1], u=u.shape[:-2], P=P.shape[:-2], D_hat=D_hat.shape)
        lanes = [np.broadcast_to(a, (*shape, *a.shape[a.ndim - k :])) for a, k in ((X, 1), (u, 2), (P, 2), (D_hat, 0))]
        rows = (a.reshape(-1, *a.shape[len(shape) :]) for a in lanes)
        X, u, P, D_hat = (np.array(np.moveaxis(a, 0, -1), order="C") for a in rows)
        count = D_hat.shape[0]
        phi, N = np.empty(count), np.empty(count)
        update_law(plant)(P, X, u, D_hat, float(t), plant.p, self.b, phi, N)
        return phi.reshape(shape)


def undeclared(plant: Plant) -> str:
    """The message that the law lacks V; the caller adds the cure."""
    return f"plant {plant.name}: expected V(x, t, p, M), a Lyapunov function, which the paper's law needs, found none"


@cache
def update_law(plant: Plant) -> Kernel:
    """The paper's law for D_hat: phi [DAPF, eq. 12] and N = 1 + V + b ∫ (1+x) w²."""
    return problem_of(plant).update()


@cache
def suited_gamma(plant: Plant, D: float, b: float = 1.0) -> float:
    """A gain with which a wrong estimate moves by about its error while the loop settles, and not past the delay.

    With an error e of the estimate w = q1 e to first order, and q1 = dU/dt, so that e' = -gamma R e with
        R = 3/2 |dU/dt|² / (1 + V + 3/2 b |dU/dt|² D²)
    from [DAPF, eq. 12], the error in the denominator being D. gamma = 1 / max ∫ R dt, the maximum over starts of the
    box, along the loop of the exact prediction from D on: U = kappa(X). gamma / D, without a unit of time, is rounded
    down to 1, 2 or 5 times a power of ten, so that no machine's rounding changes it. That is a scale, not a proof:
    npred plants check simulates loops.
    Raises ConfigError if loops from the box overflow, and if there is no box or no equilibrium.
    """
    if missing := [name for name in plant.states if name not in plant.box]:
        raise ConfigError(f"gamma: expected a gain, because plant {plant.name} has no box for {missing[0]}; give gamma")
    try:
        with np.errstate(all="ignore"):
            totals = (_excitation(plant, D, b, cells) for cells in CELLS)
            total = next((t for t in totals if np.isfinite(t).all()), np.zeros(1))
    except ConfigError as error:  # no equilibrium
        raise ConfigError(f"gamma: expected a gain, none could be derived: {error}; or give gamma") from None
    if not (largest := float(total.max())) > 0:
        what = f"none could be derived, because loops of plant {plant.name} overflow or do not move"
        raise ConfigError(f"gamma: expected a gain, {what}; give gamma")
    power = 10.0 ** math.floor(-math.log10(largest * D))
    return float(f"{max(k for k in (1, 2, 5) if k * power * largest * D <= 1) * power:.0e}") * D


def _excitation(plant: Plant, D: float, b: float, cells: int) -> np.ndarray:
    """∫ R dt of `suited_gamma`, (STARTS,), by Heun's method."""
    limits, (low, high) = inputs.bounds(plant, None), plant.ranges().T
    X = np.random.default_rng(0).uniform(low, high, (STARTS, plant.n))
    slowest = -np.linalg.eigvals(plant.linearised()[0]).real.max() if plant.rests else 0.0
    h = max(SPAN * D, SETTLING / slowest if slowest > 0 else 0.0) / cells
    past = np.broadcast_to(plant.u_target(0.0) if plant.rests or plant.tracks else np.zeros(plant.m), (STARTS, plant.m))
    first = round(D / h)  # step that a command of the loop arrives in

    def command(k: int, X: np.ndarray) -> np.ndarray:
        return past if k < first else np.clip(plant.kappa(X, k * h), *limits.T)

    total, U = np.zeros(STARTS), command(0, X)
    for k in range(cells):
        rate = plant.f(X, U, k * h)
        ahead = X + h * rate
        X = X + h / 2 * (rate + plant.f(ahead, command(k + 1, ahead) if k + 1 != first else U, (k + 1) * h))
        before, U = U, command(k + 1, X)
        if k + 1 > first:
            power = 1.5 * (((U - before) / h) ** 2).sum(axis=-1)
            total += h * power / (1 + plant.V(X, (k + 1) * h) + b * D**2 * power)
    return total
