"""The Lyapunov and the Riccati equation, and which rates the inputs move, in NumPy alone."""

import numpy as np

from npred.errors import ConfigError

STEPS = 100  # of Newton's method for the sign of a matrix, which doubles its digits in each
CLOSE = 1e-13  # the relative change at which it ends
SAME = 1e-9  # of the largest singular value: below it a rank is lost


def lyapunov(A: np.ndarray, Q: np.ndarray | None = None) -> np.ndarray:
    """The S of A'S + SA = -Q, (n, n), symmetric; positive definite where A is stable and Q, I by default, is."""
    eye = np.eye(len(A))
    right = -(eye if Q is None else Q)
    return np.linalg.solve(np.kron(A.T, eye) + np.kron(eye, A.T), right.ravel()).reshape(A.shape)


def riccati(A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """S of A'S + SA - S B inv(R) B' S + Q = 0 that stabilises, and K = inv(R) B' S: (n, n) and (m, n).

    By the sign of the Hamiltonian matrix (Roberts 1971), with one step of Kleinman's iteration to clear its rounding.
    Raises ConfigError where an unstable rate is not moved by the inputs, or one on the axis has no weight in Q.
    """
    check_stabilisable(A, B)
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


def check_stabilisable(A: np.ndarray, B: np.ndarray) -> None:
    """Raise ConfigError where the inputs do not move an eigenvalue of A whose real part is not negative (Hautus)."""
    scale = max(float(np.linalg.norm(A, 2)), np.finfo(float).tiny)
    direction = B / max(float(np.linalg.norm(B, 2)), np.finfo(float).tiny)
    for rate in np.linalg.eigvals(A):
        pencil = np.hstack([(A - rate * np.eye(len(A))) / scale, direction])
        singular = np.linalg.svd(pencil, compute_uv=False)
        if rate.real >= -SAME * scale and singular[-1] <= SAME * singular[0]:
            shown = f"{rate.real:.3g}" + (f" {rate.imag:+.3g}i" if rate.imag else "")
            raise ConfigError(
                f"expected a linearisation that its inputs stabilise, got the rate {shown}, which they do not move; "
                "write kappa(x, t, p, M)"
            )
