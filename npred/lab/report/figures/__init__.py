"""Every figure of the product, once: for the page, for papers, and beside the results of the stages."""

from npred.lab.report.figures.accuracy import box, certificate, certified, errors, kinds, learning
from npred.lab.report.figures.evaluation_data import EvaluationData
from npred.lab.report.figures.figure import Figure, write
from npred.lab.report.figures.latency import speed
from npred.lab.report.figures.loops import coverage, delays, figure1, figure1_bounded, margin, scenarios

__all__ = [
    "EvaluationData", "Figure", "box", "certificate", "certified", "coverage", "delays", "errors", "figure1",
    "figure1_bounded", "kinds", "learning", "margin", "scenarios", "speed", "write",
]  # fmt: skip
