"""The linear-quadratic regulator of the linearisation, with the Lyapunov and the Riccati equation in NumPy alone."""

import numpy as np
from numpy.typing import ArrayLike

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.formulas import Value
from npred.laws.design import Design
from npred.laws.law import Law, linear, rounded, written
from npred.plants.base import Plant

STEPS = 100  # Newton steps for the sign of a matrix; each doubles the number of right digits
CLOSE = 1e-13  # the relative change at which it ends
SAME = 1e-9  # share of the largest singular value: below it a rank is lost


def lqr(plant: Plant, Q: ArrayLike | None = None, R: ArrayLike | None = None) -> Law:
    """kappa = u - K (x - X) with K = inv(R) B' S of the Riccati equation A'S + SA - S B inv(R) B' S + Q = 0.

    A and B are those of f at the point of rest X, u, or their means along the reference. Of a plant that declares a
    setpoint, X and u are its rest and move with it, and K stays that of the declared one. The law itself is not
    clipped: npred clips every U to the input bounds.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    Q : array (n, n), its diagonal (n,), or one number for all, optional
        Weights of the states; by default 1 / size², the size half the box (Bryson's rule).
    R : array (m, m), its diagonal (m,), or one number for all, optional
        Weights of the inputs; by default 1 / size², the size the distance to the nearer bound.

    Returns
    -------
    Law
        A law kappa(x, t, p, M) by the text of its definition, which can be pasted into a plant's class.

    Raises
    ------
    ConfigError
        For weights that do not fit, and for a linearisation that the inputs do not stabilise.
    """
    design = Design(plant, "lqr")
    return along(design, gains(design, Q, R)[1])


def weights(design: Design, Q: ArrayLike | None = None, R: ArrayLike | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Q (n, n) and R (m, m), by default those of Bryson's rule. Raises ConfigError for weights that do not fit."""
    both = []
    for name, passed, sizes, definite in (("Q", Q, design.widths, False), ("R", R, design.sizes, True)):
        if passed is None:
            both.append(np.diag(1 / sizes**2))
            continue
        matrix, size = array_checks.floats(name, passed), len(sizes)
        matrix = np.diag(np.broadcast_to(matrix, size)) if matrix.ndim == 0 or matrix.shape == (size,) else matrix
        fits = matrix.shape == (size, size) and np.isfinite(matrix).all() and np.allclose(matrix, matrix.T)
        least = np.finfo(float).tiny if definite else -1e-12 * np.abs(matrix).max(initial=0.0)
        if not fits or np.linalg.eigvalsh(matrix).min() < least:
            kind = "positive definite" if definite else "without negative eigenvalues"
            expected = f"{name} ({size}, {size}) symmetric and {kind}, or its diagonal, got {passed}"
            raise design.refusal(expected, "write one weight each")
        both.append(matrix)
    return both[0], both[1]


def gains(design: Design, Q: ArrayLike | None = None, R: ArrayLike | None = None) -> tuple[np.ndarray, np.ndarray]:
    """S (n, n) and K (m, n) of the regulator."""
    both = weights(design, Q, R)
    try:
        return riccati(*design.linearised, *both)
    except ConfigError as fault:
        raise ConfigError(f"kappa {design.law}: plant {design.plant.name}: {fault}") from None


def along(design: Design, K: np.ndarray) -> Law:
    """u - K (x - X), for the point of rest, that of a set-point, or the reference X with its input u.

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
    first = len(plant.parameters)
    symbols = np.array(design.trace.parameters[first : first + K.size], dtype=object).reshape(K.shape)
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


def lyapunov(A: np.ndarray, Q: np.ndarray | None = None) -> np.ndarray:
    """The S of A'S + SA = -Q, (n, n), symmetric; positive definite where A is stable and Q, I by default, is."""
    eye = np.eye(len(A))
    right = -(eye if Q is None else Q)
    return np.linalg.solve(np.kron(A.T, eye) + np.kron(eye, A.T), right.ravel()).reshape(A.shape)


def riccati(A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """S of A'S + SA - S B inv(R) B' S + Q = 0 that stabilises, and K = inv(R) B' S: (n, n) and (m, n).

    By the sign of the Hamiltonian matrix (Roberts 1971), with one step of Kleinman's iteration to clear its rounding.
    It is solved in states and inputs of the sizes that the weights give them, and with Q as large as the quadratic
    term, so that rounding is the same in every unit; these sizes are powers of two, so that they round nothing.
    Raises ConfigError where an unstable rate is not moved by the inputs, or one on the axis has no weight in Q.
    """
    x, u = (_power(np.where(np.diag(W) > 0, np.diag(W), 1.0) ** -0.5) for W in (Q, R))
    A, B, Q, R = A * x / x[:, None], B * u / x[:, None], Q * np.outer(x, x), R * np.outer(u, u)
    pull, weight = np.linalg.norm(B @ np.linalg.solve(R, B.T)), np.linalg.norm(Q)
    ratio = _power(np.sqrt(weight / pull)) if weight > 0 and pull > 0 else 1.0
    S, K = _riccati(A, B, Q / ratio, R / ratio)
    return ratio * S / np.outer(x, x), u[:, None] * K / x


def _power(sizes: ArrayLike) -> np.ndarray:
    """The nearest powers of two."""
    return np.exp2(np.round(np.log2(sizes)))


def _riccati(A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    scale = max(float(np.linalg.norm(A, 2)), np.finfo(float).tiny)
    direction = B / max(float(np.linalg.norm(B, 2)), np.finfo(float).tiny)
    for rate in np.linalg.eigvals(A):  # do the inputs move those whose real part is not negative (Hautus)?
        pencil = np.hstack([(A - rate * np.eye(len(A))) / scale, direction])
        singular = np.linalg.svd(pencil, compute_uv=False)
        if rate.real >= -SAME * scale and singular[-1] <= SAME * singular[0]:
            shown = f"{rate.real:.3g}" + (f" {rate.imag:+.3g}i" if rate.imag else "")
            got = f"got the rate {shown}, which they do not move; write kappa(x, t, p, M)"
            raise ConfigError(f"expected a linearisation that its inputs stabilise, {got}")
    n, G = len(A), B @ np.linalg.solve(R, B.T)
    Z = np.block([[A, -G], [-Q, -A.T]])
    try:
        for _ in range(STEPS):
            inverse = np.linalg.inv(Z)
            scale = np.exp(-np.linalg.slogdet(Z)[1] / len(Z))
            last, Z = Z, (scale * Z + inverse / scale) / 2
            if np.linalg.norm(Z - last) <= CLOSE * np.linalg.norm(Z):
                break
        eye = np.eye(n)
        left, right = np.vstack([Z[:n, n:], Z[n:, n:] + eye]), -np.vstack([Z[:n, :n] + eye, Z[n:, :n]])
        S = np.linalg.lstsq(left, right, rcond=None)[0]
        K = np.linalg.solve(R, B.T @ S)
        S = lyapunov(A - B @ K, Q + K.T @ R @ K)
        S = (S + S.T) / 2
    except np.linalg.LinAlgError:
        S = np.full((n, n), np.nan)
    K = np.linalg.solve(R, B.T @ S)
    if not np.isfinite(S).all() or np.linalg.eigvals(A - B @ K).real.max() >= 0:
        raise ConfigError("lqr: expected weights Q that see every rate on the imaginary axis, got others; weigh more")
    return S, K
