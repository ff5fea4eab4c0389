"""Whether the data cover what the loops visit: histograms of both."""

from functools import partial
from typing import Any

from npred.figures.evaluation_data import Evidence, Histogram
from npred.figures.figure import Key, Panel, Plate
from npred.figures.loops import keys
from npred.figures.notation import quantity
from npred.figures.style import ROLES, Look, look


def coverage(evidence: Evidence) -> Plate:
    """A panel per state, an input, and the delay estimate."""
    found = evidence.coverage
    named = {name: quantity(evidence.plant, name) for name in found}
    panels = [Panel(f"density of {named[name]}", _told(named[name], each), partial(_histogram, each))
              for name, each in found.items()]  # fmt: skip
    caption = (
        "Filled: the training data; lines: what the closed loops visit, both on a logarithmic scale. A network is only "
        "known where it was trained."
    )
    names = next(iter(found.values())).loops
    return Plate(
        "coverage", "Coverage of the data", caption, tuple(panels), (Key("data", Look("fill", (), 5)), *keys(names))
    )


def _told(name: str, found: Histogram) -> str:
    return f"The data cover {name} from {found.edges[0]:.4g} to {found.edges[-1]:.4g}."


def _histogram(found: Histogram, axis: Any) -> None:
    axis.stairs(found.data, found.edges, fill=True, color=ROLES["fill"][0])
    for name, density in found.loops.items():
        style = look(name)
        axis.stairs(density, found.edges, color=style.colour, linewidth=1.0)
    axis.set(yscale="log", xlim=(found.edges[0], found.edges[-1]))
    axis.tick_params(axis="y", which="both", left=False, labelleft=False)
