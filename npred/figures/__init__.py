"""Every figure of the product, once: for the page, for papers, and beside the results of the stages."""

from npred.figures.accuracy import box, certificate, errors
from npred.figures.certified import certified
from npred.figures.delay_map import delays
from npred.figures.evaluation_data import Evidence
from npred.figures.figure import Plate, write
from npred.figures.histograms import coverage
from npred.figures.kinds import kinds
from npred.figures.latency import speed
from npred.figures.loops import figure1
from npred.figures.losses import learning
from npred.figures.scenarios import scenarios

__all__ = [
    "Evidence",
    "Plate",
    "box",
    "certificate",
    "certified",
    "coverage",
    "delays",
    "errors",
    "figure1",
    "kinds",
    "learning",
    "scenarios",
    "speed",
    "write",
]
