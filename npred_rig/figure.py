"""What the log of a rig has: samples, commands, the delay estimate, how old the samples are."""

from functools import partial
from typing import Any

import numpy as np

from npred.lab.report.figures.figure import Figure, LegendEntry, Panel
from npred.lab.report.figures.notation import quantity, timed
from npred.lab.report.figures.style import ROLES, Axes, LineStyle
from npred.plants import Plant

ESTIMATE, STAMPS = LineStyle("blue"), LineStyle("ink", (4, 2))


def rig(plant: Plant, name: str, calls: dict[str, Any], samples: dict[str, Any]) -> Figure:
    """The figure of that name; columns of a log by their names, of its calls and of its samples."""
    order, t = np.argsort(samples["t"]), calls["t"]
    taken = samples["t"][order]
    panels = [
        Panel(quantity(plant, x), f"{x} as measured.", partial(_line, plant, taken, samples[x][order]))
        for x in dict.fromkeys([*plant.outputs, *plant.states])
        if x in samples
    ]
    panels += [
        Panel(quantity(plant, U), f"The commands {U}.", partial(_line, plant, t, calls[U])) for U in plant.inputs
    ]
    ends = calls["rig.D_hat"][-1], samples["rig.delay"][order][-1]
    alt = "D_hat ends at {:.4g}, the stamps say {:.4g}.".format(*ends)

    def drawn(axis: Axes) -> None:
        axis.plot(t, calls["rig.D_hat"], **ESTIMATE.line)
        axis.plot(taken, samples["rig.delay"][order], **STAMPS.line)
        axis.set_xlabel(timed(plant, "t"))

    panels.append(Panel(f"delay estimate {quantity(plant, 'D_hat')}", alt, drawn))
    age = calls["rig.age"]
    alt = f"In the middle {np.median(age):.3g}, at most {age.max():.3g}."
    panels.append(Panel(timed(plant, "age of the sample"), alt, partial(_line, plant, t, age)))
    caption = "A loop on a real clock: the samples that arrived, the commands, D̂ and the delay that the stamps say."
    keys = (LegendEntry("D̂ of the controller", ESTIMATE), LegendEntry("delay by the stamps, its mean so far", STAMPS))
    return Figure(name, "The rig", caption, tuple(panels), keys)


def _line(plant: Plant, t: np.ndarray, values: np.ndarray, axis: Axes) -> None:
    axis.plot(t, values, color=ROLES["blue"][0], linewidth=1.0)
    axis.set_xlabel(timed(plant, "t"))
