"""What a law in continuous time loses because its command is held over a control step.

Over a delay of whole steps the prediction from the held commands is exact, and the loop is the sampled one without
delay: X((k + 1) dt + D) = e^{A dt} X + ∫ e^{A s} ds B U, U = kappa(X(k dt + D)). So a law that is designed for held
commands loses nothing, with D = dt either. One that is designed in continuous time, as those of `kappa = "lqr"`, acts
dt / 2 late in the mean. How much that is depends on dt and the pace of its loop, and not on D.
"""

from functools import cache

import numpy as np

from npred.base.matrices import exponential
from npred.plants import speed
from npred.plants.base import Plant

DIFFERENCE = 1e-6  # half the width of a difference, relative to the box
LONG = 8.0  # time constants of the slowest rate that are looked at
MOMENTS = 100  # of the first, and of all, at most
SHORT = 1e-2  # a step, times the fastest rate, over which the loss is proportional to the step


@cache
def linearised(plant: Plant) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """f_X (n, n), f_U (n, m) and kappa' (m, n) where the plant works at t = 0, the states in widths of the box; None
    where a function fails. By differences: at the start of each loop, they take a moment where the formulas take a
    second.
    """
    try:
        X, u = speed.operating_point(plant)
        width = np.ptp(plant.ranges(X, 0.5), axis=1)
        width = np.where(width > 0, width, 1.0)
        h = DIFFERENCE * np.concatenate([width, np.maximum(np.abs(u), 1.0)])
        z = np.concatenate([X, u]) + np.concatenate([np.diag(h), -np.diag(h)])
        with np.errstate(all="ignore"):
            f, kappa = plant.f(z[:, : plant.n], z[:, plant.n :], 0.0), plant.kappa(z[:, : plant.n], 0.0)
    except speed.FAILURES:
        return None
    by_z, K = ((values[: len(h)] - values[len(h) :]).T / (2 * h) for values in (f, kappa))
    A, B, K = by_z[:, : plant.n] * width / width[:, None], by_z[:, plant.n :] / width[:, None], K[:, : plant.n] * width
    return (A, B, K) if all(np.isfinite(each).all() for each in (A, B, K)) else None


@cache
def loss(plant: Plant, dt: float) -> float:
    """How far small states of the loop with U held over dt are from those of the law in continuous time.

    The largest difference of a state from the box at a control step, over the largest distance of that state. Infinite
    where the held law does not bring small states to rest; 0 where nothing is known, as where the law itself does not
    bring them there. A mode that the law in continuous time leaves where it is, as a conserved quantity, is left there
    by the held one too.
    """
    matrices = linearised(plant)
    if matrices is None:
        return 0.0
    A, B, K = matrices
    rates = np.linalg.eigvals(A + B @ K)
    none = speed.NONE * np.abs(rates).max()
    moving = rates.real[np.abs(rates) > none]
    if not moving.size or moving.max() > -none:
        return 0.0
    m = B.shape[1]
    step = exponential(dt * np.block([[A, B], [np.zeros((m, len(A) + m))]]))[: len(A)]
    held, ideal = step[:, : len(A)] + step[:, len(A) :] @ K, exponential(dt * (A + B @ K))
    growths = np.linalg.eigvals(held)
    if (np.abs(growths[np.abs(growths - 1) > none * dt]) >= 1).any():
        return np.inf
    steps = max(int(LONG / -moving.max() / dt), 1)
    differences, sizes = np.zeros(len(A)), np.ones(len(A))
    for each in {1, -(-steps // MOMENTS) | 1}:  # odd: a state that changes its sign with each step is seen at both
        count = min(steps // each, MOMENTS)
        of_held, of_ideal = (_powers(np.linalg.matrix_power(one, each), count) for one in (held, ideal))
        differences = np.maximum(differences, np.abs(of_held - of_ideal).sum(axis=2).max(axis=0))
        sizes = np.maximum(sizes, np.abs(of_ideal).sum(axis=2).max(axis=0))
    return float((differences / sizes).max())


def _powers(one: np.ndarray, count: int) -> np.ndarray:
    """The powers 1 to `count` of a matrix, (count, n, n)."""
    powers = one[None]
    while len(powers) < count:
        powers = np.concatenate([powers, powers @ powers[-1]])
    return powers[:count]


@cache
def per_time(plant: Plant) -> float:
    """The loss of a short step, over the step, in 1 / time; 0 where it is not known, or not finite."""
    dt = SHORT / speed.rates(plant).fastest
    lost = loss(plant, dt) / dt
    return lost if lost < np.inf else 0.0
