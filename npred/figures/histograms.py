"""Histograms of the data and of the states that the loops visit: coverage."""

from functools import partial
from typing import Any

from npred.figures.evaluation_data import Evidence, Histogram
from npred.figures.figure import Key, Panel, Plate
from npred.figures.loops import keys
from npred.figures.notation import quantity
from npred.figures.style import ROLES, Look, look


def coverage(evidence: Evidence) -> Plate:
    """A panel per state, an input, and the delay estimate."""
    histograms = evidence.coverage
    named = {name: quantity(evidence.plant, name) for name in histograms}
    panels = [Panel(f"density of {named[name]}", _alt(named[name], each), partial(_histogram, each))
              for name, each in histograms.items()]  # fmt: skip
    caption = (
        "Filled: the training data; lines: what the closed loops visit, both on a logarithmic scale. A network is only "
        "reliable where it was trained."
    )
    names = next(iter(histograms.values())).loops
    return Plate(
        "coverage", "Coverage of the data", caption, tuple(panels), (Key("data", Look("fill", (), 5)), *keys(names))
    )


def _alt(name: str, histogram: Histogram) -> str:
    return f"The data cover {name} from {histogram.edges[0]:.4g} to {histogram.edges[-1]:.4g}."


def _histogram(histogram: Histogram, axis: Any) -> None:
    edges = histogram.edges
    axis.stairs(histogram.data, edges, fill=True, color=ROLES["fill"][0])
    for contender, density in histogram.loops.items():
        line = look(contender).line
        axis.stairs(density, edges, color=line["color"], linestyle=line["linestyle"], linewidth=1.0)
    axis.set(yscale="log", xlim=(edges[0], edges[-1]))
    axis.tick_params(axis="y", which="both", left=False, labelleft=False)
