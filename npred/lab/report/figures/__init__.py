"""Every figure of the product, once: for the page, for papers, and beside the results of the stages."""

from npred.lab.report.figures.accuracy import box, errors, kinds, learning
from npred.lab.report.figures.certified import certificate, certified
from npred.lab.report.figures.delay_margin import margin
from npred.lab.report.figures.evaluation_data import EvaluationData
from npred.lab.report.figures.figure import Figure, write
from npred.lab.report.figures.latency import speed
from npred.lab.report.figures.loops import coverage, figure1, figure1_bounded
from npred.lab.report.figures.scenarios import delays, scenarios

__all__ = [
    "EvaluationData", "Figure", "box", "certificate", "certified", "coverage", "delays", "errors", "figure1",
    "figure1_bounded", "kinds", "learning", "margin", "scenarios", "speed", "write",
]  # fmt: skip
