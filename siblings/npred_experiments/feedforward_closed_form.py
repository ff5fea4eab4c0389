"""A strict-feedforward plant whose compensated loop has a formula: Z1' = Z2 - Z2² U(t - D), Z2' = U(t - D).

Krstic, Input delay compensation for forward complete and strict-feedforward nonlinear systems, IEEE TAC 55, 2010.
"""

from functools import cache
from typing import Any

import numpy as np

import npred
from npred_experiments.experiment import Experiment, Measured, Measurements, PublishedNumber

D, Z0, T = 1.0, (0.5, 0.3), 8.0
STEPS = 500  # steps per D of the published loop's integration


def closed_form(t: np.ndarray) -> np.ndarray:
    """Z(t), (..., 2), from Z0 with zero input before t = 0.

    y = Z1 + Z2³ / 3 makes the plant linear, y' = Z2: it drifts until D, then
    Z2 = e^-s [b - (a + b) s] and y = e^-s [a + (a + b) s], s = t - D, a = y(0) + D Z2(0), b = Z2(0).
    """
    a, b = Z0[0] + D * Z0[1] + Z0[1] ** 3 / 3, Z0[1]
    s = np.maximum(t - D, 0.0)
    Z2 = np.exp(-s) * (b - (a + b) * s)
    y = np.exp(-s) * (a + (a + b) * s)
    drift = np.stack([Z0[0] + t * b, np.full_like(t, b)], axis=-1)
    return np.where((t < D)[..., None], drift, np.stack([y - Z2**3 / 3, Z2], axis=-1))


def command(t: np.ndarray, shift: float = 0.0) -> np.ndarray:
    """U(t) = -e^-t [(a + 2 b) - t (a + b)] after t = 0, later by `shift`: the source's formula is that of U(t - D)."""
    a, b = Z0[0] + D * Z0[1] + Z0[1] ** 3 / 3, Z0[1]
    s = t - shift
    return np.where(s < 0, 0.0, -np.exp(-s) * ((a + 2 * b) - s * (a + b)))


def predicted(y: Any, Z2: Any, moments: tuple[Any, Any]) -> tuple[Any, Any]:
    """y and Z2 at t + D, exactly, from ∫ U and ∫ (t - θ) U over [t - D, t]."""
    return y + D * Z2 + moments[1], Z2 + moments[0]


def delayed_loop() -> tuple[np.ndarray, np.ndarray]:
    """t and Z of the delayed plant under the exact predictor, its two integrals advanced as states: nothing of the
    closed form is used. Classical Runge-Kutta, the delayed command between two steps by a polynomial of degree 7.
    """
    step, count = D / STEPS, round(T / D) * STEPS
    state = np.array([Z0[0], Z0[1], 0.0, 0.0])  # Z1, Z2, ∫ U, ∫ (t - θ) U
    Z, U = np.empty((count + 1, 2)), np.zeros(count + 1)
    for k in range(count + 1):
        Z[k], U[k] = state[:2], _law(state)
        late = [_delayed(U, k - STEPS + shift, k // STEPS - 1) for shift in (0.0, 0.5, 1.0)]
        a = _rate(state, late[0])
        b = _rate(state + step / 2 * a, late[1])
        c = _rate(state + step / 2 * b, late[1])
        state = state + step / 6 * (a + 2 * b + 2 * c + _rate(state + step * c, late[2]))
    return np.arange(count + 1) * step, Z


def _law(state: np.ndarray) -> float:
    """U of the published loop, by the exact predictor."""
    Z1, Z2, first, second = state.tolist()
    y_ahead, Z2_ahead = predicted(Z1 + Z2**3 / 3, Z2, (first, second))
    return -y_ahead - 2 * Z2_ahead


def _rate(state: np.ndarray, late: float) -> np.ndarray:
    Z2, U = state[1], _law(state)
    return np.array([Z2 - Z2**2 * late, late, U - late, state[2] - D * late])


def _delayed(U: np.ndarray, at: float, span: int) -> float:
    """U at a place between its samples, by the polynomial through the eight nearest of the same span of D."""
    if span < 0:
        return 0.0
    first = int(min(max(np.floor(at) - 3, span * STEPS), (span + 1) * STEPS - 7))
    return float(np.dot(_weights(at - first), U[first : first + 8]))


@cache
def _weights(at: float) -> np.ndarray:
    """Lagrange's, of the samples 0, …, 7."""
    places = range(8)
    return np.array([np.prod([(at - q) / (p - q) for q in places if q != p]) for p in places])


def meant(dt: float = 0.001) -> float:
    """The largest |Z - closed form| of npred's loop, whose U is held over each step of dt: of first order in dt."""
    plant = npred.plant("strict_feedforward2")
    loop = npred.simulate(plant, npred.predictor(plant, "rk4"), D=D, D_hat=D, X0=Z0, t_end=T, dt=dt)
    return float(np.abs(loop.X - closed_form(loop.t)).max())


def euler_loop() -> float:
    """The mean of |Z| over 25 starts of the repository's Euler loop, dt = 0.1 s, whose predictor makes no error."""
    X = np.random.RandomState(0).uniform(0, 1, (25, 2)).T
    steps, late, norms = 60, [np.zeros(25)] * 10, []
    for _ in range(steps):
        norms.append(np.linalg.norm(X, axis=0))
        P = X
        for u in late:
            P = P + 0.1 * np.stack([P[1] - P[1] ** 2 * u, u])
        late.append(-P[0] - 2 * P[1] - P[1] ** 3 / 3)
        u = late.pop(0)
        X = X + 0.1 * np.stack([X[1] - X[1] ** 2 * u, u])
    return float(np.mean(norms))


def measure() -> Measurements:
    """The distance from the closed form: of the delayed loop, integrated to rounding, and of npred's."""
    t, Z = delayed_loop()
    distance = float(np.abs(Z - closed_form(t))[STEPS::STEPS].max())
    return {"distance from the closed form": Measured(distance, meant())}


EXPERIMENT = Experiment(
    "strict-feedforward plant with a closed form",
    "Krstic, IEEE TAC 55 (2010) 287-303",
    (PublishedNumber("distance from the closed form", "0"),),
    measure,
)
