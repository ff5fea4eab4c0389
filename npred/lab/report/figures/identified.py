"""The figures of an identification: recorded and fitted outputs, the cost of each delay, and the residuals."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from npred.lab.report.figures.figure import Figure, LegendEntry, Panel, curves
from npred.lab.report.figures.style import DOTTED, ROLES, Axes, LineStyle, short
from npred.plants import Plant
from npred.plants.notation import quantity, timed

FILL = ROLES["fill"][0]
RECORDED, MODEL, COMMANDS = LineStyle("muted", (), 0, "."), LineStyle("blue", width=1.2), LineStyle("ink", width=1.2)
POINTS = LineStyle("blue", marker=".")


def figures(plant: Plant, drawn: dict[str, Any]) -> Iterator[Figure]:
    """The figures of one identification; `drawn` has the arrays that npred.lab.stages.identify wrote."""
    t, time, level, rho = drawn["t"], timed(plant, "t"), drawn["level"], drawn["autocorrelation"]
    panels = []
    for name, recorded, fitted in zip(plant.outputs, drawn["Y"].T, drawn["fitted"].T, strict=True):
        both = curves([(RECORDED, t, recorded), (MODEL, t, fitted)], time)
        panels.append(Panel(quantity(plant, name), f"{name} as recorded and as fitted.", both))
    for name, U in zip(plant.inputs, drawn["U"].T, strict=True):  # each holds until the next
        held = curves([(COMMANDS, np.repeat(drawn["t_U"], 2)[1:], np.repeat(U, 2)[:-1])], time)
        panels.append(Panel(quantity(plant, name), f"The commands {name}.", held))
    caption = "The outputs as recorded, and as the model has them from the begin of each segment on; the commands."
    entries = [LegendEntry("recorded", RECORDED), LegendEntry("model", MODEL)]
    yield Figure("recording", "The recording", caption, panels, entries)

    panels = []
    for j, name in enumerate(plant.inputs):
        D, rise = drawn[f"profile_{j}"]
        low, high = drawn["interval"][j]

        def costs(axis: Axes, D: Any = D, rise: Any = rise, low: float = low, high: float = high) -> None:
            axis.axvspan(low, high if np.isfinite(high) else D.max(), color=FILL, zorder=0)
            axis.axhline(level, **DOTTED.line)
            axis.plot(D, rise, **POINTS.line)
            axis.set_xlabel(timed(plant, "delay"))
            axis.set_ylim(0, min(float(np.nanmax(rise, initial=0.0)), 8 * level) * 1.05 + 1e-9)

        alt = f"Least at {short(drawn['D'][j], 4)}; with 95 % from {short(low, 4)} to {short(high, 4)}."
        panels.append(Panel(f"cost above the least one, by the delay of {name}", alt, costs))
    caption = (
        "How much worse other delays fit, with everything else fitted anew. Dotted: what the data cannot tell from the "
        "best. Shaded: the interval of 95 %, which may be wider, since the segments were drawn anew as well."
    )
    yield Figure("profile", "The delay", caption, panels)

    panels = []
    for name, left in zip(plant.outputs, (drawn["Y"] - drawn["fitted"]).T, strict=True):
        title = f"residual of {quantity(plant, name)}"
        panels.append(Panel(title, "What is left over.", curves([(RECORDED, t, left)], time)))
    zero, lags = LineStyle("grid", width=1.0), np.arange(len(rho))
    correlation = curves([(zero, lags[[0, -1]], [0, 0]), (POINTS, lags, rho)], "samples")
    panels.append(Panel("autocorrelation of residuals", "1 at 0.", correlation))
    caption = (
        "Recorded less fitted. White noise has no autocorrelation; what stays on one side is missing in the model."
    )
    yield Figure("residuals", "What is left over", caption, panels)

    panels, t = [], drawn["window_t"]
    for name, D, ends in zip(plant.inputs, drawn["window_D"].T, drawn["window_interval"].swapaxes(0, 1), strict=True):

        def windows(axis: Axes, D: Any = D, ends: Any = ends) -> None:
            axis.fill_between(t, *ends.T, color=FILL)
            axis.plot(t, D, **POINTS.line)
            axis.set_xlabel(time)

        panels.append(Panel(timed(plant, f"delay of {name}"), "Delay by window.", windows))
    if len(t):
        yield Figure("windows", "The delay over time", "The delay of each window, with its interval of 95 %.", panels)
