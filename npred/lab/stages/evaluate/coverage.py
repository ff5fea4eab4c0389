"""Coverage of the loops' states by the data: a network is only reliable where it was trained."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from npred.lab.config.results import PredictorId
from npred.lab.config.results.evaluate import Coverage
from npred.lab.training.data.dataset import Dataset
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant

MARGIN = 1e-3  # of a quantity's range: beyond it a loop is outside
NEAR = 0.05  # of the bounds' width: data that come this close to a bound of D_hat reach it
WARN = 0.01  # of a predictor's loop steps
BINS = 60


def quantities(plant: Plant, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray) -> dict[str, np.ndarray]:
    """The values of each state, each input and the delay estimate, flat, without those of diverged loops."""
    by_name = {name: X[..., k] for k, name in enumerate(plant.states)}
    by_name |= {name: u[..., k] for k, name in enumerate(plant.inputs)} | {"D_hat": D_hat}
    return {name: values[np.isfinite(values)] for name, values in by_name.items()}


def measure(
    plant: Plant, data: Dataset, loops: Mapping[PredictorId, Trajectories], bounds: tuple[float, float] = (0.0, np.inf)
) -> dict[str, Coverage]:
    """For each quantity its range in the training data, and the share of each predictor's loop steps outside it.

    An estimate at its bound is inside where the data come near that bound: they cannot lie beyond, and what is drawn
    up to a bound does not meet it.
    """
    covered = quantities(plant, data.X, data.u, data.D_hat)
    ranges = {name: (float(values.min()), float(values.max())) for name, values in covered.items()}
    near, ends = NEAR * (bounds[1] - bounds[0]), zip(ranges["D_hat"], bounds, strict=True)
    reached: dict[str, Any] = {"D_hat": [bound if abs(end - bound) <= near < np.inf else end for end, bound in ends]}
    outside: dict[str, dict[PredictorId, float]] = {name: {} for name in ranges}
    for predictor_id, run in loops.items():
        for name, values in quantities(plant, run.X, run.U, run.D_hat).items():
            low, high = reached.get(name, ranges[name])
            slack = MARGIN * (high - low)
            outside[name][predictor_id] = float(np.mean((values < low - slack) | (values > high + slack)))
    return {name: Coverage(data=ranges[name], outside=outside[name]) for name in ranges}


def write(path: Path, plant: Plant, data: Dataset, loops: Mapping[PredictorId, Trajectories]) -> None:
    """Densities over the data's range as HDF5: by quantity `edges` (BINS + 1,), `data` and `loops/NAME` (BINS,)."""
    with h5py.File(path, "w") as opened:
        file: Any = opened
        for name, values in quantities(plant, data.X, data.u, data.D_hat).items():
            slack = MARGIN * np.ptp(values)  # what `measure` counts as inside is in the picture
            slack = slack or 0.01 * max(abs(values[0]), 1.0)  # of a delay that is known there is one value
            edges = np.linspace(values.min() - slack, values.max() + slack, BINS + 1)
            file[f"{name}/edges"], file[f"{name}/data"] = edges, np.histogram(values, edges, density=True)[0]
        for predictor_id, run in loops.items():
            for name, values in quantities(plant, run.X, run.U, run.D_hat).items():
                edges = file[f"{name}/edges"][:]
                inside = np.histogram(values, edges)[0] / max(len(values), 1)
                file[f"{name}/loops/{predictor_id.name}"] = inside / np.diff(edges)
