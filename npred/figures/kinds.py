"""The errors of networks on held-out rows of each kind."""

from functools import partial

import numpy as np

from npred.figures.accuracy import distribution
from npred.figures.evaluation_data import OF, Evidence
from npred.figures.figure import Panel, Plate
from npred.figures.loops import keys
from npred.figures.style import short
from npred.results import Contender

ABOUT = {
    "nominal": "nominal rollouts have the experiment's delays",
    "exploring": "exploring ones wider ranges of delays and estimates",
    "redrawn": "a redrawn D̂ is not the loop's",
}


def kinds(evidence: Evidence) -> Plate | None:
    """The distribution of the error on rows of each kind, all on one scale; None where there is one kind alone."""
    if len(evidence.kinds) < 2:
        return None
    about = ", ".join(ABOUT[kind] for kind in evidence.kinds if kind in ABOUT)
    caption = f"The share of held-out rows whose largest |P̂ − P| over x is below ε, by kind of row: {about}."
    span = _span(evidence)
    panels = [Panel(OF[kind], _alt(sup), partial(distribution, sup, xlim=span)) for kind, sup in evidence.kinds.items()]
    return Plate("kinds", "By kind of row", caption, tuple(panels), keys(evidence.errors))


def _span(evidence: Evidence) -> tuple[float, float]:
    """From the smallest positive error to the largest."""
    errors = np.concatenate([sup for networks in evidence.kinds.values() for sup in networks.values()])
    errors = errors[errors > 0]
    return (errors.min() / 2, errors.max() * 2) if len(errors) else (0.1, 1.0)


def _alt(networks: dict[Contender, np.ndarray]) -> str:
    said = [f"{contender.label} {short(np.median(sup))} and {short(sup.max())}" for contender, sup in networks.items()]
    return f"Median and largest error: {'; '.join(said)}."
