"""The question whether a predictor is needed: loops from the box with the exact prediction, and without one."""

import numpy as np

from npred.diagnosis.case import Case, Verdict
from npred.diagnosis.loops import HOME, Ensemble, ensemble, starts, step

SLOWER, FARTHER = 1.1, 0.05  # without a predictor, as good: at most so many times the time, and share of half the box


def needed(case: Case) -> Verdict:
    """How loops with D_hat = D end, and loops with D_hat = 0."""
    shown = case.plant.time_text
    exact, bare = ensemble(case, case.D), ensemble(case, 0.0)
    figures = {"D": case.D, "dt": step(case), "with": exact.figures, "without": bare.figures}
    where = f"{len(starts(case))} loops from the box, D = {shown(case.D)}, dt = {shown(step(case), '.2g')}"
    each = f"with D_hat = D {_said(exact)}; with D_hat = 0 {_said(bare)}"
    if exact.fails.any():
        return "warn", f"{where}: {each}; shrink box, or shorten D", figures
    if spares(exact, bare):
        return "yes", f"no predictor is needed: {where}: {each}", figures
    return "yes", f"{where}: {each}", figures


def spares(exact: Ensemble, bare: Ensemble) -> bool:
    """True if loops that are not predicted all settle, about as fast and, taken together, without going farther."""
    if not (exact.fate.settled.all() and bare.fate.settled.all()):
        return False
    slowest = [(np.median(each.fate.seconds), each.fate.seconds.max()) for each in (exact, bare)]
    reaches = [np.array([each.high.max(axis=0), -each.low.min(axis=0), each.overshoot]) for each in (exact, bare)]
    farther = (reaches[1] - reaches[0]) / (exact.case.width / 2)
    return bool((np.array(slowest[1]) <= SLOWER * np.array(slowest[0])).all() and (farther <= FARTHER).all())


def _said(each: Ensemble) -> str:
    """How loops end, and how far those that settle go past the target."""
    case, beyond = each.case, each.overshoot > HOME * each.case.width
    if not each.fate.settled.all() or not beyond.any():
        return each.text()
    return f"{each.text()}, overshoot {case.amounts(each.overshoot, beyond)}"
