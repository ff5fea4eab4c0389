"""A DeepONet on a fixed grid as a program: the trunk is folded, and the sample runs beside the point of rest."""

from dataclasses import replace

import numpy as np

from npred.networks import matrices, program
from npred.networks.program import Dots, Layers, Matrix, Product, Program, Repeat, Shapes, Silu, mlp, mlp_shapes
from npred.networks.weights import Weights

DEGREE = 12  # Legendre polynomials that the trunk sees: x alone gives a basis of almost straight lines at the start
FINE = 256  # nodes from which on parity saves more than it costs
CELL = 32  # nodes of a fine grid on which the trunk consists of a few functions
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
    by_moment = p.weights("by_moment", by_input, 1)
    by_z = p.weights("by_z", np.concatenate([first[: p.seen], first[-1:]]), rows)
    bias = p.constant("bias", _bias(zero, rows))
    activation = Silu("h", "sums", width) if rows == 1 else program.SiluPair("h", "sums", width)
    p.operations += [
        *_moments(p, features, transform),
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


def _moments(p: Program, features: Matrix, transform: np.ndarray) -> list[program.Operation]:
    """The features of v by the transform (nx, count); on a fine grid by its parity, for which half of the nodes do."""
    (nx, count), m, half = transform.shape, p.m, (p.nx + 1) // 2
    if nx < FINE:
        return [Product(features, Matrix("v", 1, m), p.weights("by_node", transform, m), (m, nx, count))]
    by_node = _wider(p, transform[:half].T)  # (count, nodes)
    width = by_node.shape[1]
    even, odd = p.buffer("even_v", m, width), p.buffer("odd_v", m, width)
    operations: list[program.Operation] = [program.Halves(even, odd, "v", nx, m)]
    for k, v in enumerate((even, odd)):
        out, rows = replace(features, offset=k, column=2), by_node[k::2]
        operations.append(Dots(out, v, p.constant(f"by_{v.name}", rows), (m, width, len(rows))))
    return operations


def _bias(values: np.ndarray, rows: int) -> np.ndarray:
    return np.stack([np.zeros_like(values), values]) if rows == 2 else values[None]


def _smooth(p: Program, trunk: Layers, by_basis: np.ndarray, by_mean: np.ndarray, h: Matrix) -> tuple[Matrix, Matrix]:
    """N = sum_k b_k t_k(x) + a v_zero of the first row, the trunk split by parity about the middle and by rank; and a.

    Even and odd functions are known by half of the nodes, and each is of about half the rank. On a fine grid they are
    sums of a few local functions on each CELL nodes. Columns of zeros make whole vectors.
    """
    n, m, nx, width = p.n, p.m, p.nx, h.row
    t = mlp(trunk, matrices.legendre(nx, trunk[0]["weight"].shape[1]))  # (nx, basis)
    parts, size = [(t + sign * t[::-1]) / 2 for sign in (1, -1)], p.rounding * np.abs(t).max()
    local = _local(p, parts, size)
    (even, by_even), (odd, by_odd) = (_factors(_in_cells(local, part), size) for part in parts)
    even = np.concatenate([even, _in_cells(local, np.ones((nx, 1))).T])  # takes the level a v_zero
    weights = np.concatenate([by_even, np.zeros((1, t.shape[1])), by_odd])  # (rank, basis)
    rank = len(weights)
    by_hidden = np.concatenate([(weights @ by_basis).reshape(n * rank, width), by_mean])
    folded = p.weights("by_basis", _wider(p, by_hidden.T), 1)
    p.buffer("b", 1, folded.row)
    level, a = Matrix("b", rank, offset=len(by_even)), Matrix("b", m, offset=n * rank)
    N, b, odd_b = Matrix("N", nx), Matrix("b", rank), Matrix("b", rank, offset=len(even))
    p.operations += [
        Product(Matrix("b", folded.row), h, folded, (1, width, folded.row)),
        Product(level, a, p.constant("level", p.v_zero[:, None]), (n, m, 1), adds=True),
    ]
    both = _on_nodes(p, "even", b, even, local), _on_nodes(p, "odd", odd_b, odd, local)
    p.operations.append(program.Mirror(N, *both, n, nx))
    return N, a


def _on_nodes(p: Program, name: str, b: Matrix, functions: np.ndarray, local: np.ndarray) -> Matrix:
    """b times the functions (rank, numbers of cells), on the nodes of the first half."""
    functions, (q, cell) = _wider(p, functions), local.shape
    rank, columns = functions.shape
    out = p.buffer(f"{name}_part", p.n, columns)
    p.operations.append(Product(out, b, p.weights(name, functions, p.n), (p.n, rank, columns)))
    if cell == 1:
        return out
    rows = p.n * columns // q
    fine = p.buffer(f"{name}_nodes", rows, cell)
    p.operations.append(Product(fine, replace(out, row=q), p.weights("local", local, rows), (rows, q, cell)))
    return replace(fine, row=columns // q * cell)


def _local(p: Program, parts: list[np.ndarray], size: float) -> np.ndarray:
    """(q, CELL): the fewest functions of which the parts (nx, basis) consist on each CELL nodes of a half, within
    size, and rows of zeros that make whole vectors; [[1]], each node by itself, where they would not save much.
    """
    cells = -(-(p.nx + 1) // (2 * CELL))
    if cells * CELL > p.nx:
        return np.ones((1, 1))
    pieces = [part[: cells * CELL].reshape(cells, CELL, -1).swapaxes(0, 1).reshape(CELL, -1) for part in parts]
    local, _ = _factors(np.concatenate([*pieces, np.full((CELL, 1), np.abs(parts).max())], axis=1), size)
    q = next(q for q in range(len(local), CELL + 1) if cells * q == p.rounded(cells * q))
    return np.pad(local, ((0, q - len(local)), (0, 0))) if 3 * q <= CELL else np.ones((1, 1))


def _in_cells(local: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(numbers of cells, …): how much of each local function is in the values (nx, …) on the first half."""
    q, cell = local.shape
    cells = -(-(len(values) + 1) // (2 * cell))
    return np.einsum("qs,csk->cqk", local, values[: cells * cell].reshape(cells, cell, -1)).reshape(cells * q, -1)


def _wider(p: Program, values: np.ndarray) -> np.ndarray:
    return np.pad(values, ((0, 0), (0, p.rounded(values.shape[1]) - values.shape[1])))


def _factors(values: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """(rank, nodes) and (rank, basis), of the fewest singular vectors whose product is within `size` of the values."""
    U, s, V = np.linalg.svd(values, full_matrices=False)
    rank = next(r for r in range(1, len(s) + 1) if r == len(s) or np.abs(U[:, r:] * s[r:] @ V[r:]).max() < size)
    return U[:, :rank].T, s[:rank, None] * V[:rank]
