"""Theorem 3 of [DAPF] as a picture: the error of a predictor against the radius its loops end in, over delays too."""

from pathlib import Path
from typing import Any

import numpy as np

from npred import lyapunov, metrics
from npred.closed_loop import Trajectories
from npred.config import Evaluate
from npred.plants import Plant
from npred.stages import drawing


def delay_map(plant: Plant, config: Evaluate, loops: Trajectories, reference: Trajectories) -> dict[str, Any]:
    """Which loops of the map D x D_hat(0) converge, and what share of those that do with the numerical predictor.

    `band` is the range of D in which no loop is lost that the numerical predictor brings home.
    """
    shape = (len(config.map_D), len(config.map_D_hat0))
    found, wanted = (_home(plant, run).reshape(shape) for run in (loops, reference))
    safe = [D for D, row, goal in zip(config.map_D, found, wanted, strict=True) if (row | ~goal).all()]
    return {
        "D": config.map_D,
        "D_hat0": config.map_D_hat0,
        "converged": found.tolist(),
        "share": float((found & wanted).sum() / max(wanted.sum(), 1)),
        "band": [min(safe), max(safe)] if safe else None,
    }


def _home(plant: Plant, loops: Trajectories) -> np.ndarray:
    target = plant.target(loops.t)
    return metrics.converged(metrics.radius(loops, target), target)


def draw(folder: Path, config: Evaluate, models: dict[str, Any], gain: float, figure1: dict[str, Trajectories]) -> None:
    """Write certificate.svg and .png: eps_kappa against the radius, W(t) of Fig. 1's loops, and the maps."""
    maps = {name: row["map"] for name, row in models.items() if row["map"]}
    figure = drawing.figure(7.2, 5.4 if maps else 2.8)
    top, bottom = figure.subfigures(2, 1) if maps else (figure, None)
    left, right = top.subplots(1, 2)
    _radii(left, models, gain)
    _lyapunov(right, config, figure1)
    if bottom:
        for axis, (name, cells) in zip(np.ravel(bottom.subplots(1, len(maps), sharey=True)), maps.items(), strict=True):
            _map(axis, name, cells)
    drawing.save(figure, folder, "certificate")


def _radii(axis: Any, models: dict[str, Any], gain: float) -> None:
    """Median and worst radius of the cases over eps_kappa, beside the radius of a constant error."""
    rows = [(name, row) for name, row in models.items() if row["eps_kappa"] and row["radius"]["median"]]
    for number, (name, row) in enumerate(rows):
        ends = [row["radius"]["median"], row["radius"]["worst"] or np.nan]
        axis.plot(
            [row["eps_kappa"]] * 2, ends, "_-", color=drawing.COLOURS[(number + 1) % 7], label=drawing.words(name)
        )
    if rows:
        span = np.array([min(r["eps_kappa"] for _, r in rows) / 2, max(r["eps_kappa"] for _, r in rows) * 2])
        axis.plot(span, gain * span, color="#888888", linestyle=":", label=f"constant error: {gain:.4g} ε")
        axis.legend(fontsize=6, frameon=False)
    axis.set(xscale="log", yscale="log", xlabel="ε κ on held-out rollouts", ylabel="radius: median to worst")
    for side in (axis.xaxis, axis.yaxis):  # within a decade matplotlib labels the minor ticks, one over the other
        side.set_minor_formatter("")
    axis.grid(alpha=0.3)


def _lyapunov(axis: Any, config: Evaluate, loops: dict[str, Trajectories]) -> None:
    """W(t) along the loops of Fig. 1; it is not defined without adaptation."""
    for number, loop in enumerate(loops.values()):
        W = lyapunov.W(loop.N, config.D, loop.D_hat, config.gamma, config.b)
        if np.isfinite(W).any():
            axis.plot(loop.t, W, drawing.STYLES[number % 4], color=drawing.COLOURS[number % 7], linewidth=1.2)
    axis.set(yscale="log", xlabel="t (s)", ylabel="W(t), Fig. 1")
    axis.grid(alpha=0.3)


def _map(axis: Any, name: str, cells: dict[str, Any]) -> None:
    x, y = (np.array(cells[key]) for key in ("D_hat0", "D"))
    axis.pcolormesh(
        x, y, np.array(cells["converged"], dtype=float), cmap="Greys_r", vmin=-1.2, vmax=1, shading="nearest"
    )
    axis.set(title=f"{drawing.words(name)}: {cells['share']:.0%}", xlabel="D̂(0) (s)", ylabel="D (s)")
    axis.title.set_fontsize(8)
    axis.label_outer()
