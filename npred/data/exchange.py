"""Samples in the layout that the authors of [DAPF] published: rows of numbers in two .npy files, nodes side by side.

A row of the inputs is (D_hat, u_1 … u_m, x_1 … x_n) node after node, (N, nx (1 + m + n)); a row of the outputs is
(P_1 … P_n) node after node, (N, nx n). D_hat and X repeat on every node.
"""

from pathlib import Path
from typing import Any

import numpy as np

from npred import json_files, randomness
from npred.data.dataset import Dataset
from npred.errors import ConfigError, first_line
from npred.plants import Plant

CONSTANT = 1e-5  # of a quantity's largest value: what float32 leaves of an equality
TEST_SHARE = 0.1  # of the rows or rollouts, as in [DAPF]
PROBED = 400  # held-out rows whose nearest training row is looked for


def join(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Inputs (N, nx (1 + m + n)) and outputs (N, nx n) of the samples."""
    rows, nodes = data.u.shape[:2]
    repeated = [np.broadcast_to(a, (rows, nodes, a.shape[-1])) for a in (data.D_hat[:, None, None], data.X[:, None])]
    inputs = np.concatenate([repeated[0], data.u, repeated[1]], axis=-1)
    return inputs.reshape(rows, -1), data.P.reshape(rows, -1)


def part(plant: Plant, inputs: np.ndarray, outputs: np.ndarray, rollouts: int | None = None) -> Dataset:
    """The samples of such a pair, a tenth held out: of the rollouts where their number is known, else of the rows.

    With `rollouts`, rows of a rollout lie together, as many of each. True delay and time are not in the files: NaN.
    Raises ConfigError where the shapes do not fit the plant or each other, D_hat or X changes along a row's nodes, a
    number is not finite or D_hat is negative.
    """
    D_hat, u, X, P = _columns(plant, inputs, outputs)
    count = len(P)
    rollout, test = split(count, rollouts)
    unknown = np.full(count, np.nan)
    return Dataset(X=X, u=u, D_hat=D_hat, P=P, D=unknown, t=unknown, rollout=rollout, test=test)


def split(count: int, rollouts: int | None) -> tuple[np.ndarray, np.ndarray]:
    """The rollout of each of `count` rows, int32, and 1 if it is held out, uint8; without rollouts a row is one.

    Raises ConfigError where the rows are not a multiple of the rollouts, or too few to hold any out.
    """
    groups = count if rollouts is None else rollouts
    if not 2 <= groups <= count or count % groups:
        what = "two rows or more" if rollouts is None else "at least 2 rollouts with as many rows of each"
        raise ConfigError(f"import: expected {what}, got {count} rows of {groups}; give --rollouts a divisor")
    held_out = randomness.generator(0, "import").permutation(groups)[: max(round(TEST_SHARE * groups), 1)]
    rollout = np.repeat(np.arange(groups, dtype=np.int32), count // groups)
    return rollout, np.isin(rollout, held_out).astype(np.uint8)


@np.errstate(all="ignore")
def checks(plant: Plant, data: Dataset) -> dict[str, Any]:
    """The residuals of the samples in the predictor equation [DAPF, eq. 10], one number per state each.

    start: sup |P(0) - X|. residual: sup over samples and nodes of |P(x) - X - D_hat ∫₀ˣ f(P, u) dy|, the integral by
    the trapezoidal rule. relative: the root of its mean square over that of P - X. horizon: the share a of D_hat that
    fits P - X = a D_hat ∫ f best; 1 - dx where the last node is x = 1 - dx. NaN where f leaves the finite numbers.
    """
    integral = _integral(plant, data)
    moved = data.P - data.X[:, None]
    residual = moved - integral
    scale = np.sqrt(np.mean(moved**2, axis=(0, 1))) + np.finfo(float).tiny
    horizon = np.sum(moved * integral / scale**2) / max(np.sum((integral / scale) ** 2), np.finfo(float).tiny)
    by_state = {
        "start": np.abs(moved[:, 0]).max(axis=0),
        "residual": np.abs(residual).max(axis=(0, 1)),
        "relative": np.sqrt(np.mean(residual**2, axis=(0, 1))) / scale,
    }
    named = {name: dict(zip(plant.states, values.tolist(), strict=True)) for name, values in by_state.items()}
    return {**named, "horizon": float(horizon)}


def nearest(data: Dataset, test: np.ndarray) -> float:
    """The median distance from a held-out row to the nearest of the others, in (X, D_hat) over their deviations.

    A split that parts rollouts into both sides makes it small: its test asks for what was trained on.
    """
    points = _points(data)
    held_out, rest = points[test == 1], points[test == 0]
    return float(np.median([_distances(point, rest).min() for point in _some(held_out)]))


def together(data: Dataset) -> float:
    """The excess over chance of rows whose nearest other row is of their rollout: 1 always, about 0 if shuffled."""
    points = _points(data)
    chance = 1 / len(np.unique(data.rollout))
    hits = []
    for row in _some(np.arange(len(points))):
        distance = _distances(points[row], points)
        distance[row] = np.inf
        hits.append(data.rollout[distance.argmin()] == data.rollout[row])
    return float((np.mean(hits) - chance) / (1 - chance))


def read(path: Path) -> np.ndarray:
    """The matrix of an .npy file as float64. Raises ConfigError for anything else; pickles are not opened."""
    try:
        with np.errstate(over="ignore"):
            array = np.lib.format.open_memmap(json_files.regular(path), mode="r")  # mapped: its size is checked
    except Exception as error:  # the header is read as Python's literals, and what is none fails in many ways
        got = first_line(error)
        raise ConfigError(f"{path}: expected an .npy file of numbers, got: {got}; check the path") from None
    if array.ndim < 2 or not array.size or array.dtype.kind not in "fiu":
        got = f"{array.dtype} {array.shape}"
        raise ConfigError(f"{path}: expected a matrix, one row per sample, got {got}; save it with np.save")
    return np.array(array, dtype=float).reshape(len(array), -1)


def _columns(plant: Plant, inputs: np.ndarray, outputs: np.ndarray) -> tuple[np.ndarray, ...]:
    """D_hat (N,), u (N, nx, m), X (N, n) and P (N, nx, n), checked."""
    width = 1 + plant.m + plant.n
    nodes, odd = divmod(inputs.shape[1], width)
    if odd or nodes < 2 or outputs.shape != (len(inputs), nodes * plant.n):
        raise ConfigError(
            f"import: expected inputs (N, {width} nx) and outputs (N, {plant.n} nx) for plant {plant.name}, "
            f"got {inputs.shape} and {outputs.shape}; check the plant and the order of the files"
        )
    if not (np.isfinite(inputs).all() and np.isfinite(outputs).all()):
        bad = int(np.argmax(~(np.isfinite(inputs).all(axis=1) & np.isfinite(outputs).all(axis=1))))
        raise ConfigError(f"import: expected finite numbers, got others in row {bad}; leave it out")
    table = inputs.reshape(len(inputs), nodes, width)
    D_hat, u, X = table[..., 0], table[..., 1 : 1 + plant.m], table[..., 1 + plant.m :]
    for name, a in (("D_hat", D_hat[..., None]), ("X", X)):
        changing = np.abs(a - a[:, :1]).max(axis=(1, 2))
        if changing.max() > CONSTANT * np.abs(a).max():
            row = int(changing.argmax())
            raise ConfigError(
                f"import: expected {name} the same on every node of a row, got a change of {changing[row]:.3g} in "
                f"row {row}; a node's columns are D_hat, {', '.join([*plant.inputs, *plant.states])}"
            )
    if D_hat.min() < 0:
        row = int(D_hat[:, 0].argmin())
        raise ConfigError(
            f"import: expected D_hat >= 0, got {D_hat.min():.3g} in row {row}; it is the first column of a node"
        )
    return D_hat[:, 0].copy(), u.copy(), X[:, 0].copy(), outputs.reshape(len(outputs), nodes, plant.n).copy()


def _integral(plant: Plant, data: Dataset) -> np.ndarray:
    """D_hat ∫₀ˣ f(P, u) dy on the nodes, (N, nx, n), by the trapezoidal rule."""
    slope = plant.f(data.P, data.u)
    cells = (slope[:, 1:] + slope[:, :-1]) / 2
    sums = np.cumsum(cells, axis=1) / cells.shape[1]
    return data.D_hat[:, None, None] * np.concatenate([np.zeros_like(sums[:, :1]), sums], axis=1)


def _points(data: Dataset) -> np.ndarray:
    points = np.column_stack([data.X, data.D_hat])
    return points / (points.std(axis=0) + np.finfo(float).tiny)


def _some(rows: np.ndarray) -> np.ndarray:
    return rows[np.unique(np.linspace(0, len(rows) - 1, PROBED).astype(int))]


def _distances(point: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points - point, axis=1)
