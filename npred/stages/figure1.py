"""Fig. 1 of [DAPF]: states, input and delay estimate of one loop with each predictor."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from npred import metrics
from npred.closed_loop import Trajectories
from npred.config import Evaluate
from npred.plants import Plant
from npred.stages import drawing

FOCUS = "numerical"  # a loop that is lost may leave the picture, so that the others can be told apart
SERIES = ("t", "X", "U", "D_hat", "N")


def first(config: Evaluate, loops: Trajectories) -> Trajectories:
    """The loop of Fig. 1, the first of the batch, up to t_end."""
    rows = slice(0, int(np.searchsorted(loops.t, config.t_end + 1e-9)))
    series = {name: getattr(loops, name)[0, rows] for name in ("X", "U", "D_hat", "N", "energy")}
    return replace(loops, t=loops.t[rows], escaped=loops.escaped[0], **series)


def numbers(plant: Plant, loop: Trajectories) -> dict[str, Any]:
    """Where the loop of Fig. 1 ends: state, delay estimate, radius, and when it settled."""
    return {
        "X_end": [metrics.number(x) for x in loop.X[-1]],
        "D_hat_end": metrics.number(loop.D_hat[-1]),
        "radius": metrics.number(metrics.radius(loop, plant.target(loop.t))),
        "settle_time": metrics.number(metrics.settle_time(loop, plant.target(loop.t))),
    }


def draw(folder: Path, plant: Plant, D: float, loops: dict[str, Trajectories]) -> None:
    """Write figure1.svg, figure1.png and the loops as figure1.h5."""
    with h5py.File(folder / "figure1.h5", "w") as file:
        for name, loop in loops.items():
            for series in SERIES:
                file[f"{name}/{series}"] = getattr(loop, series)
    figure = drawing.figure(7.2, 5.2)
    axes = np.ravel(figure.subplots((plant.n + plant.m + 2) // 2, 2, sharex=True))
    for number, (name, loop) in enumerate(loops.items()):
        columns = np.concatenate([loop.X, loop.U, loop.D_hat[:, None]], axis=1)
        look = {"color": drawing.COLOURS[number % 7], "linestyle": drawing.STYLES[number % 4], "linewidth": 1.3}
        for axis, column in zip(axes, columns.T, strict=False):
            axis.plot(loop.t, column, label=drawing.words(name), **look)
            if name == FOCUS:
                axis.set_ylim(*_around(column))
    t = next(iter(loops.values())).t
    labels = [*plant.states, *plant.inputs, "delay estimate (s)"]
    for axis, label, goal in zip(axes, labels, _goals(plant, D, t), strict=False):
        look = {"color": "#888888", "linewidth": 0.8, "linestyle": ":"}
        axis.plot(t, goal, **look) if np.ndim(goal) else axis.axhline(goal, **look)
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    for axis in axes[-2:]:
        axis.set_xlabel("t (s)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False, fontsize=8)
    drawing.save(figure, folder, "figure1")


def _goals(plant: Plant, D: float, t: np.ndarray) -> list[Any]:
    """Where each quantity should go, numbers or series (nt,): the input leads by D."""
    return [*plant.target(t).T, *plant.u_target(t + D).T, D]


def _around(values: np.ndarray) -> tuple[float, float]:
    """The range of the values with room on both sides."""
    low, high = float(np.min(values)), float(np.max(values))
    room = 0.15 * (high - low) or 1.0
    return low - room, high + room
