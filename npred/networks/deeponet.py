"""A DeepONet on a fixed grid as a program: the trunk is folded, and the sample runs beside the point of rest."""

from dataclasses import replace

import numpy as np

from npred.networks import matrices, program
from npred.networks.program import Dots, Layers, Matrix, Product, Program, Repeat, Shapes, Silu, mlp, mlp_shapes
from npred.networks.weights import Weights

DEGREE = 12  # Legendre polynomials that the trunk sees: x alone gives a basis of almost straight lines at the start
PAIRED, STRIDED = True, False  # the sample runs beside the point of rest; every node is evaluated


def shapes(
    n: int, m: int, clock: int = 0, *,
    width: int = 96, depth: int = 4, basis: int = 48, trunk: int = 64, moments: int = 16,
) -> Shapes:  # fmt: skip
    """The arrays of npred.lab.training.operators.deeponet.DeepONetwork, with its arguments."""
    branch = [n + clock + moments * m + 1, *[width] * depth, n * (basis + m)]
    return mlp_shapes("branch", branch, bias=False) | mlp_shapes("trunk", [DEGREE, trunk, trunk, basis])


def append(p: Program, weights: Weights) -> None:
    """Append the operations of N: both rows share each load of the weights; the last, linear layer takes the first."""
    n, m, nx, rows, trunk = p.n, p.m, p.nx, p.rows, weights.layers("network.trunk")
    *hidden, last = weights.layers("network.branch")
    h, basis = _hidden(p, hidden), len(trunk[-1]["weight"])
    width = h.row
    by_state = last["weight"].reshape(n, basis + m, width)
    by_mean = by_state[:, basis:].reshape(-1, width)  # (n m, width)
    N, a = _smooth(p, trunk, by_state[:, :basis], by_mean, h)
    if rows == 2:
        both, rest = p.buffer("both", 1, n * m), replace(h, offset=width)
        p.operations.append(Dots(both, rest, p.constant("by_mean", by_mean), (1, width, n * m), a))
        a = both
    p.operations.append(Product(N, replace(a, row=m), Matrix("r", nx), (n, m, nx), adds=True))


def _hidden(p: Program, hidden: Layers) -> Matrix:
    """The branch's hidden layers, of all rows side by side: in differences a bias cancels."""
    n, m, nx, rows = p.n, p.m, p.nx, p.rows
    first = hidden[0]["weight"].T  # rows: X and the phase, moments, D_hat
    count, width = (len(first) - p.columns) // m, first.shape[1]
    transform = matrices.moments(nx, count).T  # (nx, count)
    by_input = first[p.seen : -1].reshape(count, m, width).swapaxes(0, 1).reshape(m * count, width)
    zero = p.z_zero @ first[:n] + np.outer(p.v_zero, transform.sum(axis=0)).ravel() @ by_input + hidden[0]["bias"]
    features, sums, h = p.buffer("features", m, count), p.buffer("sums", rows, width), p.buffer("h", rows, width)
    by_node, by_moment = p.weights("by_node", transform, m), p.weights("by_moment", by_input, 1)
    by_z = p.weights("by_z", np.concatenate([first[: p.seen], first[-1:]]), rows)
    bias = p.constant("bias", _bias(zero, rows))
    activation = Silu("h", "sums", width) if rows == 1 else program.SiluPair("h", "sums", width)
    p.operations += [
        Product(features, Matrix("v", 1, m), by_node, (m, nx, count)),
        Product(sums, Matrix("z", p.columns), by_z, (rows, p.columns, width), bias),
        Product(sums, Matrix("features", m * count), by_moment, (1, m * count, width), adds=True),
        activation,
    ]
    if hidden[1:]:
        weight = p.stack("weight", [layer["weight"].T for layer in hidden[1:]], rows)
        biases = p.stack("biases", [_bias(layer["bias"], rows) for layer in hidden[1:]])
        operation = Product(sums, h, weight, (rows, width, width), biases)
        p.operations.append(Repeat(len(hidden) - 1, (operation, activation)))
    return h


def _bias(values: np.ndarray, rows: int) -> np.ndarray:
    return np.stack([np.zeros_like(values), values]) if rows == 2 else values[None]


def _smooth(p: Program, trunk: Layers, by_basis: np.ndarray, by_mean: np.ndarray, h: Matrix) -> tuple[Matrix, Matrix]:
    """N = sum_k b_k t_k(x) + a v_zero of the first row, the trunk split by parity about the middle and by rank; and a.

    Even and odd functions are known by half of the nodes, and each is of about half the rank. Columns of zeros make
    whole vectors.
    """
    n, m, nx, width = p.n, p.m, p.nx, h.row
    t = mlp(trunk, matrices.legendre(nx, trunk[0]["weight"].shape[1]))  # (nx, basis)
    half, size = (nx + 1) // 2, p.rounding * np.abs(t).max()
    (even, by_even), (odd, by_odd) = (_factors((t + sign * t[::-1])[:half] / 2, size) for sign in (1, -1))
    even = np.concatenate([even, np.ones((1, half))])  # takes the level a v_zero
    weights = np.concatenate([by_even, np.zeros((1, t.shape[1])), by_odd])  # (rank, basis)
    rank = len(weights)
    by_hidden = np.concatenate([(weights @ by_basis).reshape(n * rank, width), by_mean])
    folded = p.weights("by_basis", _wider(p, by_hidden.T), 1)
    p.buffer("b", 1, folded.row)
    b, odd_b = Matrix("b", rank), Matrix("b", rank, offset=len(even))
    level, a = Matrix("b", rank, offset=len(by_even)), Matrix("b", m, offset=n * rank)
    even, odd = _wider(p, even), _wider(p, odd)
    columns, N = even.shape[1], Matrix("N", nx)
    even_part, odd_part = p.buffer("even_part", n, columns), p.buffer("odd_part", n, columns)
    p.operations += [
        Product(Matrix("b", folded.row), h, folded, (1, width, folded.row)),
        Product(level, a, p.constant("level", p.v_zero[:, None]), (n, m, 1), adds=True),
        Product(even_part, b, p.weights("even", even, n), (n, len(even), columns)),
        Product(odd_part, odd_b, p.weights("odd", odd, n), (n, len(odd), columns)),
        program.Mirror(N, even_part, odd_part, n, nx),
    ]
    return N, a


def _wider(p: Program, values: np.ndarray) -> np.ndarray:
    return np.pad(values, ((0, 0), (0, p.rounded(values.shape[1]) - values.shape[1])))


def _factors(values: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """(rank, nodes) and (rank, basis), of the fewest singular vectors whose product is within `size` of the values."""
    U, s, V = np.linalg.svd(values, full_matrices=False)
    rank = next(r for r in range(1, len(s) + 1) if r == len(s) or np.abs(U[:, r:] * s[r:] @ V[r:]).max() < size)
    return U[:, :rank].T, s[:rank, None] * V[:rank]
