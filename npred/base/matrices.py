"""The exponential of matrices."""

import numpy as np


def exponential(A: np.ndarray) -> np.ndarray:
    """e^A of matrices (..., n, n): the Taylor series of A / 2^k, squared k times."""
    k = max(0, int(np.ceil(np.log2(np.abs(A).sum(axis=-1).max(initial=1e-300)))) + 1)
    term = total = np.broadcast_to(np.eye(A.shape[-1]), A.shape)
    for i in range(1, 19):
        term = term @ A / (i * 2.0**k)
        total = total + term
    for _ in range(k):
        total = total @ total
    return total
