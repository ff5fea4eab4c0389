"""The linear-quadratic regulator of the linearisation."""

import numpy as np
from numpy.typing import ArrayLike

from npred import array_checks
from npred.errors import ConfigError
from npred.laws.design import Design
from npred.laws.law import Law, linear, rounded, written
from npred.laws.riccati import riccati
from npred.plants.base import Plant
from npred.symbolic import Value


def lqr(plant: Plant, Q: ArrayLike | None = None, R: ArrayLike | None = None) -> Law:
    """kappa = u - K (x - X) with K = inv(R) B' S of the Riccati equation A'S + SA - S B inv(R) B' S + Q = 0.

    A and B are those of f at the point of rest X, u, or their means along the reference. The law itself is not clipped:
    npred clips every U to the input bounds.

    Raises ConfigError for weights that do not fit, and for a linearisation that the inputs do not stabilise.
    """
    design = Design(plant, "lqr")
    return along(design, gains(design, Q, R)[1])


def weights(design: Design, Q: ArrayLike | None = None, R: ArrayLike | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Q (n, n) and R (m, m), by default those of Bryson's rule. Raises ConfigError for weights that do not fit."""
    return (
        _weights(design, "Q", Q, design.widths, least=0.0),
        _weights(design, "R", R, design.sizes, least=np.finfo(float).tiny),
    )


def gains(design: Design, Q: ArrayLike | None = None, R: ArrayLike | None = None) -> tuple[np.ndarray, np.ndarray]:
    """S (n, n) and K (m, n) of the regulator."""
    both = weights(design, Q, R)
    try:
        return riccati(*design.linearised, *both)
    except ConfigError as fault:
        raise ConfigError(f"kappa {design.law}: plant {design.plant.name}: {fault}") from None


def along(design: Design, K: np.ndarray) -> Law:
    """u - K (x - X), for the point of rest or the reference X with its input u.

    Along a reference the gain is K(t) with A(t) - B(t) K(t) = A - B K, of the means A and B, so that errors obey the
    same equation all the time; or K where no K(t) does that.
    """
    if not design.follows:
        return linear(design.plant, K, *design.rest, design.widths)
    A, B = design.linearised
    return written(design.trace, design.guess, _commands(design, rounded(K), rounded(A - B @ K)))


def adjustable(plant: Plant, K: np.ndarray) -> Plant:
    """The plant with the law of `along` whose gains K (m, n) are its last parameters: other gains compile nothing."""
    names = [f"lqr_gain{k}" for k in range(K.size)]
    parameters = plant.parameters | dict(zip(names, K.ravel().tolist(), strict=True))
    declared = type(plant.declared.__name__, (plant.declared,), {"parameters": parameters})
    other = type(plant)(plant.name, declared, source=plant.source)
    design = Design(other, "lqr")
    A, B = design.linearised
    symbols = np.array(design.trace.parameters[-K.size :], dtype=object).reshape(K.shape)
    closed = A - B @ (symbols if design.schedules(A - B @ K) else K)
    return other.controlled(written(design.trace, design.guess, _commands(design, symbols, closed)))


def _commands(design: Design, K: np.ndarray, closed: np.ndarray) -> list[Value]:
    """u - K (x - X), or u - K(t) (x - X) with A(t) - B(t) K(t) = closed = A - B K, as expressions."""
    X, u = design.target
    errors = [a - b for a, b in zip(design.x, X, strict=True)]
    if closed.dtype == object or design.schedules(closed):
        pulls = design.scheduled(closed, errors)
    else:
        pulls = [sum(gain * error for gain, error in zip(row, errors, strict=True)) for row in K]
    return [a - b for a, b in zip(u, pulls, strict=True)]


def _weights(design: Design, name: str, given_weights: ArrayLike | None, sizes: np.ndarray, least: float) -> np.ndarray:
    """The matrix of Q or R: as it was passed, of its diagonal, or by Bryson's rule."""
    if given_weights is None:
        return np.diag(1 / sizes**2)
    matrix = array_checks.floats(name, given_weights)
    matrix = np.diag(matrix) if matrix.ndim == 1 else matrix
    size = len(sizes)
    fits = matrix.shape == (size, size) and np.isfinite(matrix).all() and np.allclose(matrix, matrix.T)
    if not fits or np.linalg.eigvalsh(matrix).min() < least - 1e-12 * np.abs(matrix).max() * (least == 0):
        kind = "positive definite" if least else "without negative eigenvalues"
        raise design.refusal(f"{name} ({size}, {size}) symmetric and {kind}, or its diagonal, got {given_weights}",
                             "write one weight each")  # fmt: skip
    return matrix
