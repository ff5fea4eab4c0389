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

COLOURS = ("#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito


def first(config: Evaluate, loops: Trajectories) -> Trajectories:
    """The loop of Fig. 1, the first of the batch, up to t_end."""
    rows = slice(0, int(np.searchsorted(loops.t, config.t_end + 1e-9)))
    series = {name: getattr(loops, name)[0, rows] for name in ("X", "U", "D_hat", "N", "energy")}
    return replace(loops, t=loops.t[rows], escaped=loops.escaped[0], **series)


def numbers(plant: Plant, config: Evaluate, loops: Trajectories) -> dict[str, Any]:
    """Where the loop of Fig. 1 ends: state, delay estimate, radius, and when it settled."""
    loop, X_star = first(config, loops), plant.equilibrium
    return {
        "X_end": loop.X[-1].tolist(),
        "D_hat_end": float(loop.D_hat[-1]),
        "radius": metrics.number(metrics.radius(loop, X_star)),
        "settle_time": metrics.number(metrics.settle_time(loop, X_star)),
    }


def draw(folder: Path, plant: Plant, config: Evaluate, loops: dict[str, Trajectories]) -> None:
    """Write figure1.svg, figure1.png and the loops as figure1.h5, the same bytes for the same loops."""
    chosen = {name: first(config, run) for name, run in loops.items()}
    with h5py.File(folder / "figure1.h5", "w") as file:
        for name, run in chosen.items():
            for series in ("t", "X", "U", "D_hat", "N"):
                file[f"{name}/{series}"] = getattr(run, series)
    _figure(folder, plant, config, chosen)


def _figure(folder: Path, plant: Plant, config: Evaluate, loops: dict[str, Trajectories]) -> None:
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    matplotlib.rcParams["svg.hashsalt"] = "npred"  # else the identifiers inside an SVG are random
    figure = Figure(figsize=(7.2, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    rows = [(name, lambda run, k=k: run.X[:, k]) for k, name in enumerate(plant.states)]
    rows += [(name, lambda run, k=k: run.U[:, k]) for k, name in enumerate(plant.inputs)]
    rows += [("delay estimate (s)", lambda run: run.D_hat)]
    axes = np.ravel(figure.subplots((len(rows) + 1) // 2, 2, sharex=True))
    for axis, (label, values) in zip(axes, rows, strict=False):
        for number, (name, run) in enumerate(loops.items()):
            _line(axis, number, name, run, values(run))
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    for axis, value in zip(axes, plant.equilibrium, strict=False):
        axis.axhline(value, color="#888888", linewidth=0.8, linestyle=":")
    axes[len(rows) - 1].axhline(config.D, color="#888888", linewidth=0.8, linestyle=":")
    for axis in axes[-2:]:
        axis.set_xlabel("t (s)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False, fontsize=8)
    figure.savefig(folder / "figure1.svg", metadata={"Date": None})
    figure.savefig(folder / "figure1.png", dpi=160, metadata={"Software": None})


def _line(axis: Any, number: int, name: str, run: Trajectories, values: np.ndarray) -> None:
    style = ("-", "--", "-.", ":")[number % 4]
    axis.plot(run.t, values, style, color=COLOURS[number % len(COLOURS)], linewidth=1.3, label=name.replace("_", " "))
