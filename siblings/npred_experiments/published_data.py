"""Samples in the layout that the authors of [DAPF] published, as a file that a pipeline trains on:

    python -m npred_experiments.published_data INPUTS.npy OUTPUTS.npy -o theirs.h5

Both files hold a row of numbers per sample, nodes side by side. A row of the inputs is (D_hat, u_1 … u_m, x_1 … x_n)
node after node, (N, nx (1 + m + n)); a row of the outputs is (P_1 … P_n) node after node, (N, nx n). D_hat and X repeat
on every node.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from npred import plants
from npred.base import json_files, randomness
from npred.base.errors import ConfigError, NpredError, first_line, room_on_disk
from npred.lab.report.terminal.console import Console
from npred.lab.training.data.dataset import Dataset, attributes
from npred.plants import Plant

CONSTANT = 1e-5  # share of a quantity's largest value: float32 keeps an equality within it
TEST_SHARE = 0.1  # share of the rows or rollouts, as in [DAPF]
PROBED = 400  # rows whose nearest row is looked for
RELATIVE = 0.05  # residual over what P moves: Euler's method leaves a third of it at dx = 0.01
START = 1e-3  # distance of P(0) from X: files in single precision round a state of 1000 by less
CELL = 0.5  # in cells of the grid: by how much the delay that fits best may be off
SHUFFLED = 0.1  # share of `together`


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


def samples(plant: Plant, inputs: np.ndarray, outputs: np.ndarray, rollouts: int | None = None) -> Dataset:
    """The samples of such a pair, a tenth held out: of the rollouts where their number is known, else of the rows.

    With `rollouts`, rows of a rollout lie together, as many of each. True delay and time are not in the files: NaN.
    Raises ConfigError where the shapes do not fit the plant or each other, D_hat or X changes along a row's nodes, a
    number is not finite or D_hat is negative.
    """
    if plant.clocked or not plant.one_delay:
        raise ConfigError(
            f"--plant: expected one delay and a prediction free of time, got {plant.name}; the files hold one D_hat "
            "per row, and no time"
        )
    width = 1 + plant.m + plant.n
    nodes, odd = divmod(inputs.shape[1], width)
    if odd or nodes < 2 or outputs.shape != (len(inputs), nodes * plant.n):
        raise ConfigError(
            f"expected inputs (N, {width} nx) and outputs (N, {plant.n} nx) for plant {plant.name}, got {inputs.shape} "
            f"and {outputs.shape}; check the plant and the order of the files"
        )
    finite = np.isfinite(inputs).all(axis=1) & np.isfinite(outputs).all(axis=1)
    if not finite.all():
        raise ConfigError(f"expected finite numbers, got others in row {int(np.argmin(finite))}; leave it out")
    table = inputs.reshape(len(inputs), nodes, width)
    D_hat, u, X = table[..., 0], table[..., 1 : 1 + plant.m], table[..., 1 + plant.m :]
    for name, a in (("D_hat", D_hat[..., None]), ("X", X)):
        changing = np.abs(a - a[:, :1]).max(axis=(1, 2))
        if changing.max() > CONSTANT * np.abs(a).max():
            row = int(changing.argmax())
            raise ConfigError(
                f"expected {name} the same on every node of a row, got a change of {changing[row]:.3g} in row {row}; "
                f"a node's columns are D_hat, {', '.join([*plant.inputs, *plant.states])}"
            )
    if D_hat.min() < 0:
        row = int(D_hat[:, 0].argmin())
        raise ConfigError(f"expected D_hat >= 0, got {D_hat.min():.3g} in row {row}; it is a node's first column")
    rollout, test = split(len(inputs), rollouts)
    P, unknown = outputs.reshape(len(outputs), nodes, plant.n), np.full(len(inputs), np.nan)
    return Dataset(X[:, 0].copy(), u.copy(), D_hat[:, 0].copy(), P.copy(), unknown, unknown, rollout, test)


def split(count: int, rollouts: int | None) -> tuple[np.ndarray, np.ndarray]:
    """The rollout of each of `count` rows, int32, and 1 if it is held out, uint8; without rollouts a row is one.

    Raises ConfigError where the rows are not a multiple of the rollouts, or too few to hold any out.
    """
    groups = count if rollouts is None else rollouts
    if not 2 <= groups <= count or count % groups:
        what = "two rows or more" if rollouts is None else "at least 2 rollouts with as many rows of each"
        raise ConfigError(f"expected {what}, got {count} rows of {groups}; give --rollouts a divisor")
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
    slope = plant.f(data.P, data.u)
    cells = (slope[:, 1:] + slope[:, :-1]) / 2
    sums = np.cumsum(cells, axis=1) / cells.shape[1]
    integral = data.D_hat[:, None, None] * np.concatenate([np.zeros_like(sums[:, :1]), sums], axis=1)
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
    return float(np.median([np.linalg.norm(rest - point, axis=1).min() for point in _some(held_out)]))


def together(data: Dataset) -> float:
    """The excess over chance of rows whose nearest other row is of their rollout: 1 always, about 0 if shuffled."""
    points = _points(data)
    chance = 1 / len(np.unique(data.rollout))
    hits = []
    for row in _some(np.arange(len(points))):
        distance = np.linalg.norm(points - points[row], axis=1)
        distance[row] = np.inf
        hits.append(data.rollout[distance.argmin()] == data.rollout[row])
    return float((np.mean(hits) - chance) / (1 - chance))


def _points(data: Dataset) -> np.ndarray:
    points = np.column_stack([data.X, data.D_hat])
    return points / (points.std(axis=0) + np.finfo(float).tiny)


def _some(rows: np.ndarray) -> np.ndarray:
    return rows[np.unique(np.linspace(0, len(rows) - 1, PROBED).astype(int))]


def doubts(measured: dict[str, Any], nx: int) -> list[str]:
    """The faults that the checks find in the samples, in words."""
    lines = [
        f"{state}: P = X + D_hat ∫ f(P, u) leaves {100 * relative:.3g} % of what P moves: is it another plant?"
        for state, relative in measured["relative"].items()
        if not relative <= RELATIVE
    ]
    lines += [
        f"{state}: P(0) is up to {off:.3g} from X: does the first node lie at x = 0?"
        for state, off in measured["start"].items()
        if not off <= START
    ]
    if not abs(measured["horizon"] - 1) <= CELL / (nx - 1):
        lines.append(
            f"P fits {measured['horizon']:.4f} D_hat better: do the nodes end at x = 1? Expected linspace(0, 1, nx)"
        )
    return lines


def bring(inputs: Path, outputs: Path, name: str, rollouts: int | None, output: Path, console: Console) -> None:
    """Write the rows of two files as one HDF5 file, and describe them. Raises ConfigError where it cannot."""
    if output.resolve() in (inputs.resolve(), outputs.resolve()):
        raise ConfigError(f"--output: expected another file than the two, got {output}; name one")
    plant = plants.resolve(name)
    data = samples(plant, read(inputs), read(outputs), rollouts)
    nx, measured = data.u.shape[1], checks(plant, data)
    for line in doubts(measured, nx):
        console.warn(line)
    if rollouts and together(data) < SHUFFLED:
        console.warn("the rows look shuffled: no nearer to their rollout than by chance; leave out --rollouts")
    with room_on_disk(output):
        data.write(output, attributes(plant, "imported"))
    start, residual, relative = (
        ", ".join(f"{state} {value:.3g}" for state, value in measured[key].items())
        for key in ("start", "residual", "relative")
    )
    console.out(f"{output}: {len(data)} samples on {nx} nodes for plant {plant.name}")
    console.out(f"sup |P(0) - X|: {start}")
    console.out(f"sup residual of P = X + D_hat ∫ f(P, u): {residual}")
    console.out(f"rms of it over rms of P - X: {relative}; P fits {measured['horizon']:.4f} D_hat best")
    splits = {"rows": split(len(data), None)[1]} | ({"rollouts": data.test} if rollouts else {})
    for kind, test in splits.items():
        away = f"the nearest training row {nearest(data, test):.3g} deviations away"
        console.out(f"split by {kind}: {int(test.sum())} rows held out, {away}")
    by = "rollouts" if rollouts else "rows; with --rollouts N, by rollout"
    console.out(f'held out in the file: by {by}\nuse it: data = "{output}" below [generate]')


def main(arguments: list[str] | None = None) -> int:
    """Read the command line; the exit code."""
    about = str(__doc__).partition("\n")[0]
    parser = argparse.ArgumentParser("python -m npred_experiments.published_data", description=about)
    parser.add_argument("inputs", type=Path, help="rows of D_hat, inputs, states, node after node")
    parser.add_argument("outputs", type=Path, help="rows of P, one number per state, node after node")
    parser.add_argument("--plant", default="activator_repressor", help="a name or my_plant.py:Tank")
    parser.add_argument("--rollouts", type=int, help="how many, if the rows of one lie together: whole ones held out")
    parser.add_argument("-o", "--output", type=Path, default=Path("theirs.h5"), help="the HDF5 file to write")
    asked, console = parser.parse_args(arguments), Console()
    try:
        bring(asked.inputs, asked.outputs, asked.plant, asked.rollouts, asked.output, console)
    except NpredError as error:
        console.error(str(error))
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
