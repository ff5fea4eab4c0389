"""Every figure of the product, once: for the page, for papers, and beside the results of the stages."""

from npred.figures.accuracy import box, errors, kinds, learning
from npred.figures.certified import certificate, certified
from npred.figures.delay_margin import margin
from npred.figures.evaluation_data import EvaluationData
from npred.figures.figure import Figure, write
from npred.figures.latency import speed
from npred.figures.loops import coverage, figure1, figure1_bounded
from npred.figures.scenarios import delays, scenarios

__all__ = [
    "EvaluationData", "Figure", "box", "certificate", "certified", "coverage", "delays", "errors", "figure1",
    "figure1_bounded", "kinds", "learning", "margin", "scenarios", "speed", "write",
]  # fmt: skip
