"""What a recording tells of a plant: recorded and fitted outputs, the cost of each delay, and what is left over."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from npred.lab.report.figures.figure import Figure, LegendEntry, Panel
from npred.lab.report.figures.notation import quantity, timed
from npred.lab.report.figures.style import DOTTED, ROLES, Axes, LineStyle, short
from npred.plants import Plant

BLUE, MUTED, FILL = (ROLES[role][0] for role in ("blue", "muted", "fill"))


def figures(plant: Plant, drawn: dict[str, Any]) -> Iterator[Figure]:
    """The figures of one identification; `drawn` is what npred.lab.stages.identify has written."""
    yield _recording(plant, drawn)
    yield _delay_costs(plant, drawn)
    yield _residuals(plant, drawn)
    if len(drawn["window_t"]):
        yield _windows(plant, drawn)


def _recording(plant: Plant, drawn: dict[str, Any]) -> Figure:
    def outputs(k: int) -> Callable[[Axes], None]:
        def draw(axis: Axes) -> None:
            axis.plot(drawn["t"], drawn["Y"][:, k], ".", markersize=2.5, color=MUTED)
            axis.plot(drawn["t"], drawn["fitted"][:, k], color=BLUE, linewidth=1.2)
            axis.set_xlabel(timed(plant, "t"))

        return draw

    def commands(j: int) -> Callable[[Axes], None]:
        def draw(axis: Axes) -> None:
            axis.step(drawn["t_U"], drawn["U"][:, j], where="post", color=ROLES["ink"][0], linewidth=1.2)
            axis.set_xlabel(timed(plant, "t"))

        return draw

    panels = [
        Panel(quantity(plant, name), f"{name} as recorded and as fitted.", outputs(k))
        for k, name in enumerate(plant.outputs)
    ]
    panels += [
        Panel(quantity(plant, name), f"The commands {name}.", commands(j)) for j, name in enumerate(plant.inputs)
    ]
    caption = "The outputs as recorded, and as the model has them from the begin of each segment on; the commands."
    entries = [
        LegendEntry("recorded", LineStyle("muted", marker="o", width=0)),
        LegendEntry("model", LineStyle("blue")),
    ]
    return Figure("recording", "The recording", caption, panels, entries)


def _delay_costs(plant: Plant, drawn: dict[str, Any]) -> Figure:
    panels, level = [], drawn["level"]
    for j, name in enumerate(plant.inputs):
        D, rise = drawn[f"profile_{j}"]
        low, high = drawn["interval"][j]

        def draw(axis: Axes, D: Any = D, rise: Any = rise, low: float = low, high: float = high) -> None:
            axis.axvspan(low, high, color=FILL, zorder=0)
            axis.axhline(level, **DOTTED)
            axis.plot(D, rise, color=BLUE, marker=".", markersize=4)
            axis.set_xlabel(timed(plant, "delay"))
            axis.set_ylim(0, min(float(np.nanmax(rise, initial=0.0)), 8 * level) * 1.05 + 1e-9)

        alt = f"Least at {short(drawn['D'][j], 4)}; with 95 % from {short(low, 4)} to {short(high, 4)}."
        panels.append(Panel(f"cost above the least one, by the delay of {name}", alt, draw))
    caption = (
        "How much worse other delays fit, with everything else fitted anew. Dotted: what the data cannot tell from the "
        "best. Shaded: the interval of 95 %, which may be wider, since the segments were drawn anew as well."
    )
    return Figure("profile", "The delay", caption, panels)


def _residuals(plant: Plant, drawn: dict[str, Any]) -> Figure:
    panels, rho = [], drawn["autocorrelation"]
    for name, left in zip(plant.outputs, (drawn["Y"] - drawn["fitted"]).T, strict=True):

        def draw(axis: Axes, left: np.ndarray = left) -> None:
            axis.plot(drawn["t"], left, ".", markersize=2.5, color=MUTED)
            axis.set_xlabel(timed(plant, "t"))

        panels.append(Panel(f"residual of {quantity(plant, name)}", "What is left over.", draw))

    def correlation(axis: Axes) -> None:
        axis.axhline(0.0, color=ROLES["grid"][0], linewidth=1.0)
        axis.plot(np.arange(len(rho)), rho, color=BLUE, marker=".", markersize=4)
        axis.set_xlabel("samples")

    panels.append(Panel("autocorrelation of residuals", "1 at 0.", correlation))
    caption = (
        "Recorded less fitted. White noise has no autocorrelation; what stays on one side is missing in the model."
    )
    return Figure("residuals", "What is left over", caption, panels)


def _windows(plant: Plant, drawn: dict[str, Any]) -> Figure:
    panels, t = [], drawn["window_t"]
    for j, name in enumerate(plant.inputs):

        def draw(axis: Axes, D: Any = drawn["window_D"][:, j], ends: Any = drawn["window_interval"][:, j]) -> None:
            axis.fill_between(t, ends[:, 0], ends[:, 1], color=FILL)
            axis.plot(t, D, color=BLUE, marker=".", markersize=5)
            axis.set_xlabel(timed(plant, "t"))

        panels.append(Panel(timed(plant, f"delay of {name}"), "Delay by window.", draw))
    return Figure("windows", "The delay over time", "The delay of each window, with its interval of 95 %.", panels)
