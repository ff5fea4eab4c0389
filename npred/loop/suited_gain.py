"""A gain of the paper's law for the delay estimate that suits a plant and a delay, where nobody gives one."""

import math
from functools import cache

import numpy as np

from npred.errors import ConfigError
from npred.plants import inputs
from npred.plants.base import Plant

STARTS, SPAN, SETTLING = 16, 20.0, 5.0  # starts of the box, and how long they are followed: delays, time constants
CELLS = (200, 800)  # of that time; more where fewer leave the finite numbers


@cache
def suited_gamma(plant: Plant, D: float, b: float = 1.0) -> float:
    """A gain with which a wrong estimate moves by about its error while the loop settles, and not past the delay.

    With an error e of the estimate w = q1 e to first order, and q1 = dU/dt, so that e' = -gamma R e with
        R = 3/2 |dU/dt|² / (1 + V + 3/2 b |dU/dt|² D²)
    from [DAPF, eq. 12], the error in the denominator being D. gamma = 1 / max ∫ R dt, the maximum over starts of the
    box, along the loop of the exact prediction from D on: U = kappa(X). It is rounded down to 1, 2 or 5 times a power
    of ten, so that no machine's rounding changes it. That is a scale, not a proof: npred plants check simulates loops.
    Raises ConfigError where loops from the box leave the finite numbers, and where there is no box or no equilibrium.
    """
    if missing := [name for name in plant.states if name not in plant.box]:
        raise ConfigError(f"gamma: expected a gain, for plant {plant.name} has no box for {missing[0]}; give gamma")
    try:
        with np.errstate(all="ignore"):
            totals = (_excitation(plant, D, b, cells) for cells in CELLS)
            total = next((t for t in totals if np.isfinite(t).all()), np.zeros(1))
    except ConfigError as error:  # no equilibrium
        raise ConfigError(f"gamma: expected a gain, none could be derived: {error}; or give gamma") from None
    if not (largest := float(total.max())) > 0:
        what = f"none could be derived, for loops of plant {plant.name} leave the finite numbers or do not move"
        raise ConfigError(f"gamma: expected a gain, {what}; give gamma")
    power = 10.0 ** math.floor(math.log10(1 / largest))
    return float(f"{max(k for k in (1, 2, 5) if k * power * largest <= 1) * power:.0e}")


def _excitation(plant: Plant, D: float, b: float, cells: int) -> np.ndarray:
    """∫ R dt of `suited_gamma`, (STARTS,), by Heun's method."""
    limits, ends = inputs.bounds(plant, None), np.array([plant.box[name] for name in plant.states])
    X = np.random.default_rng(0).uniform(ends[:, 0], ends[:, 1], (STARTS, plant.n))
    slowest = -np.linalg.eigvals(closed_loop(plant)).real.max() if plant.rests else 0.0
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


def closed_loop(plant: Plant) -> np.ndarray:
    """f_X + f_U kappa' at the equilibrium, (n, n)."""
    f_X, f_U = plant.jacobians(plant.equilibrium, plant.u_equilibrium)
    return f_X + f_U @ plant.kappa_jacobian(plant.equilibrium)
