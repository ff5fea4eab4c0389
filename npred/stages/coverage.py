"""Whether the data cover what the loops visit: a network is only known where it was trained."""

from pathlib import Path
from typing import Any

import numpy as np

from npred.closed_loop import Trajectories
from npred.dataset import Dataset
from npred.plants import Plant
from npred.stages import drawing

MARGIN = 1e-3  # of a quantity's range: beyond it a loop is outside
WARN = 0.01  # of a contender's loop steps
BINS = 60


def quantities(plant: Plant, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray) -> dict[str, np.ndarray]:
    """The values of each state, each input and the delay estimate, flat, without those of diverged loops."""
    found = {name: X[..., k] for k, name in enumerate(plant.states)}
    found |= {name: u[..., k] for k, name in enumerate(plant.inputs)} | {"D_hat": D_hat}
    return {name: values[np.isfinite(values)] for name, values in found.items()}


def measure(plant: Plant, data: Dataset, loops: dict[str, Trajectories]) -> dict[str, Any]:
    """For each quantity its range in the training data, and the share of each contender's loop steps outside it."""
    known = quantities(plant, data.X, data.u, data.D_hat)
    ranges = {name: (float(values.min()), float(values.max())) for name, values in known.items()}
    outside: dict[str, dict[str, float]] = {name: {} for name in ranges}
    for contender, run in loops.items():
        for name, values in quantities(plant, run.X, run.U, run.D_hat).items():
            low, high = ranges[name]
            slack = MARGIN * (high - low)
            outside[name][contender] = float(np.mean((values < low - slack) | (values > high + slack)))
    return {name: {"data": list(ranges[name]), "outside": outside[name]} for name in ranges}


def draw(folder: Path, plant: Plant, data: Dataset, loops: dict[str, Trajectories]) -> None:
    """Write coverage.svg and .png: histograms of the data, filled, and of each contender's loops, as lines."""
    known = quantities(plant, data.X, data.u, data.D_hat)
    figure = drawing.figure(7.2, 1.9 * ((len(known) + 1) // 2))
    axes = dict(zip(known, np.ravel(figure.subplots((len(known) + 1) // 2, 2)), strict=False))
    edges = {}
    for name, values in known.items():
        edges[name] = np.linspace(values.min(), values.max(), BINS + 1)
        axes[name].hist(values, edges[name], density=True, color="#DDDDDD", label="data")
        axes[name].set(xlabel=name, yscale="log", yticks=[])
    for number, (contender, run) in enumerate(loops.items()):
        for name, values in quantities(plant, run.X, run.U, run.D_hat).items():
            look = {"color": drawing.COLOURS[number % 7], "histtype": "step", "linewidth": 1.0}
            axes[name].hist(values, edges[name], density=True, label=drawing.words(contender), **look)
    handles = next(iter(axes.values())).get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=5, frameon=False, fontsize=7)
    drawing.save(figure, folder, "coverage")
