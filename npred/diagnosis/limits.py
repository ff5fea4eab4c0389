"""The question about the limits that a plant declares: which loops break them, and what a safety filter changes."""

import numpy as np

from npred.diagnosis.case import Case, Verdict
from npred.diagnosis.loops import LOOPS, fate, run, step
from npred.loop.safety import SafetyFilter

STEPS, MOST = 20, 2000  # control steps in a delay, at least, and in a loop, at most


def applies(case: Case) -> bool:
    """True where a filter serves the plant, and its loops lead somewhere."""
    return case.plant.declares_safe and SafetyFilter.serves(case.plant) and case.sound and case.leads == "yes"


def kept(case: Case) -> Verdict:
    """The loops from the box, of a known delay, that break a limit once the first command acts, or do not converge."""
    dt = step(case, (STEPS, STEPS))
    t_end = case.D + min(case.times[1], MOST * dt)
    outside, fails = zip(*(_failing(case, dt, t_end, safety) for safety in (None, SafetyFilter())), strict=True)
    shown = case.plant.time_text
    text = (
        f"of {LOOPS} loops from the box, D = {shown(case.D)}, dt = {shown(dt, '.2g')}, in {shown(t_end, '.3g')}: "
        f"{outside[0].mean():.0%} break a limit, with a filter {outside[1].mean():.0%}; {fails[0].mean():.0%} do not "
        f"converge, with a filter {fails[1].mean():.0%}"
    )
    if (fails[1] & ~fails[0]).any():
        return "warn", f"{text}; let kappa rest inside the limits, or take no filter"
    return ("warn", f"{text}; shrink box, or let the limits be wider") if outside[1].any() else ("yes", text)


def _failing(case: Case, dt: float, t_end: float, safety: SafetyFilter | None) -> tuple[np.ndarray, np.ndarray]:
    """The loops (LOOPS,) that break a limit, and those that neither are at the target nor come nearer."""
    loops = run(case, case.D, case.X[:LOOPS], t_end, dt, safety=safety)
    h = loops.safety[:, int(np.ceil(case.D / dt - 1e-9)) :]  # type: ignore[index]
    return np.logical_not((h >= 0).all(axis=(1, 2))), ~fate(case, loops.X, t_end).converges
