"""How wrong a constant delay estimate may be: how fast the linearised loop decays, by the estimate's error."""

import numpy as np

from npred.diagnosis.delay_margin import MismatchedLoop, delay_margin
from npred.lab.report.figures.figure import Figure, Panel
from npred.lab.report.figures.notation import timed, with_unit
from npred.lab.report.figures.style import ROLES, Axes
from npred.plants import Plant

POINTS, BEYOND = 80, 1.5  # estimates that are looked at, up to so many times the margin
FAR = 2.0  # in D, where the margin has no end


def margin(plant: Plant, name: str, D: float) -> Figure:
    """The real part of the rightmost root over D_hat - D, the margin shaded; raises as npred.delay_margin does."""
    low, high = delay_margin(plant, D)
    loop = MismatchedLoop(plant, D)
    errors = np.linspace(max(BEYOND * low, -D), BEYOND * (high if np.isfinite(high) else FAR * D), POINTS)
    rates = np.array([loop.rightmost(max(D + error, 0.0)) for error in errors])

    def draw(axis: Axes) -> None:
        axis.axvspan(low, min(high, errors[-1]), color=ROLES["fill"][0], linewidth=0)
        axis.axhline(0.0, color=ROLES["muted"][0], linewidth=0.8)
        axis.plot(errors, rates, color=ROLES["blue"][0], linewidth=1.4)
        axis.set(xlabel=timed(plant, "D̂ − D"), xlim=(errors[0], errors[-1]))

    first, last = (plant.time_text(end, ".4g") if np.isfinite(end) else "any longer one" for end in (low, high))
    caption = (
        f"Small states of the loop of {plant.name}, D = {plant.time_text(D)}, with a constant D̂ decay where the "
        f"rightmost root is left of 0: for D̂ − D from {first} to {last}, shaded."
    )
    title = with_unit("rightmost root, real part", f"1/{plant.time_unit}")
    return Figure(name, "The delay margin", caption, [Panel(title, caption, draw)])
