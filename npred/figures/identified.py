"""What a recording tells of a plant: recorded and fitted outputs, the cost of each delay, and what is left over."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from npred.figures.figure import Figure, LegendEntry, Panel
from npred.figures.notation import quantity, timed
from npred.figures.style import ROLES, Axes, LineStyle, short
from npred.plants import Plant

RECORDED, FITTED = LineStyle("muted", marker="o", width=0), LineStyle("blue")


def plates(plant: Plant, drawn: dict[str, Any]) -> Iterator[Figure]:
    """The figures of one identification; `drawn` is what npred.stages.identify has written."""
    yield _outputs(plant, drawn)
    yield _profiles(plant, drawn)
    yield _residuals(plant, drawn)
    if len(drawn["window_t"]):
        yield _windows(plant, drawn)


def _outputs(plant: Plant, drawn: dict[str, Any]) -> Figure:
    t, Y, fitted = drawn["t"], drawn["Y"], drawn["fitted"]
    panels = [
        Panel(
            quantity(plant, name),
            f"{name} as recorded and as fitted.",
            partial(_output, t, Y[:, k], fitted[:, k], plant),
        )
        for k, name in enumerate(plant.outputs)
    ]
    panels += [
        Panel(quantity(plant, name), f"The commands {name}.", partial(_commands, drawn["t_U"], drawn["U"][:, j], plant))
        for j, name in enumerate(plant.inputs)
    ]
    caption = "The outputs as recorded, and as the model has them from the begin of each segment on; the commands."
    return Figure(
        "recording",
        "The recording",
        caption,
        tuple(panels),
        (LegendEntry("recorded", RECORDED), LegendEntry("model", FITTED)),
    )


def _output(t: np.ndarray, y: np.ndarray, fitted: np.ndarray, plant: Plant, axis: Axes) -> None:
    axis.plot(t, y, ".", markersize=2.5, color=ROLES["muted"][0])
    axis.plot(t, fitted, color=ROLES["blue"][0], linewidth=1.2)
    axis.set_xlabel(timed(plant, "t"))


def _commands(t: np.ndarray, U: np.ndarray, plant: Plant, axis: Axes) -> None:
    axis.step(t, U, where="post", color=ROLES["ink"][0], linewidth=1.2)
    axis.set_xlabel(timed(plant, "t"))


def _profiles(plant: Plant, drawn: dict[str, Any]) -> Figure:
    panels = []
    for j, name in enumerate(plant.inputs):
        D, rise = drawn[f"profile_{j}"]
        low, high = drawn["interval"][j]
        alt = f"Least at {short(drawn['D'][j], 4)}; with 95 % from {short(low, 4)} to {short(high, 4)}."
        draw = partial(_profile, D, rise, drawn["level"], (low, high), plant)
        panels.append(Panel(f"cost above the least one, by the delay of {name}", alt, draw))
    caption = (
        "How much worse other delays fit, with everything else fitted anew. Dotted: what the data cannot tell from the "
        "best. Shaded: the interval of 95 %, which may be wider, since the segments were drawn anew as well."
    )
    return Figure("profile", "The delay", caption, tuple(panels))


def _profile(
    D: np.ndarray, rise: np.ndarray, level: float, interval: tuple[float, float], plant: Plant, axis: Axes
) -> None:
    axis.axvspan(*interval, color=ROLES["fill"][0], zorder=0)
    axis.axhline(level, color=ROLES["muted"][0], linestyle=(0, (1, 2)), linewidth=1.2)
    axis.plot(D, rise, color=ROLES["blue"][0], marker=".", markersize=4)
    axis.set_xlabel(timed(plant, "delay"))
    axis.set_ylim(0, min(float(np.nanmax(rise, initial=0.0)), 8 * level) * 1.05 + 1e-9)


def _residuals(plant: Plant, drawn: dict[str, Any]) -> Figure:
    panels = []
    for k, name in enumerate(plant.outputs):
        left = drawn["Y"][:, k] - drawn["fitted"][:, k]
        panels.append(
            Panel(f"residual of {quantity(plant, name)}", "What is left over.", partial(_left, drawn["t"], left, plant))
        )
    rho = drawn["autocorrelation"]
    panels.append(Panel("autocorrelation of residuals", "1 at 0.", partial(_correlation, rho)))
    caption = (
        "Recorded less fitted. White noise has no autocorrelation; what stays on one side is missing in the model."
    )
    return Figure("residuals", "What is left over", caption, tuple(panels))


def _left(t: np.ndarray, r: np.ndarray, plant: Plant, axis: Axes) -> None:
    axis.plot(t, r, ".", markersize=2.5, color=ROLES["muted"][0])
    axis.set_xlabel(timed(plant, "t"))


def _correlation(rho: np.ndarray, axis: Axes) -> None:
    axis.axhline(0.0, color=ROLES["grid"][0], linewidth=1.0)
    axis.plot(np.arange(len(rho)), rho, color=ROLES["blue"][0], marker=".", markersize=4)
    axis.set_xlabel("samples")


def _windows(plant: Plant, drawn: dict[str, Any]) -> Figure:
    t, D, interval = drawn["window_t"], drawn["window_D"], drawn["window_interval"]
    panels = tuple(
        Panel(timed(plant, f"delay of {name}"), "Delay by window.", partial(_window, t, D[:, j], interval[:, j], plant))
        for j, name in enumerate(plant.inputs)
    )
    return Figure("windows", "The delay over time", "The delay of each window, with its interval of 95 %.", panels)


def _window(t: np.ndarray, D: np.ndarray, interval: np.ndarray, plant: Plant, axis: Axes) -> None:
    axis.fill_between(t, interval[:, 0], interval[:, 1], color=ROLES["fill"][0])
    axis.plot(t, D, color=ROLES["blue"][0], marker=".", markersize=5)
    axis.set_xlabel(timed(plant, "t"))
