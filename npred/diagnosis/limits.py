"""The question about the limits that a plant declares: which loops break them, and what a safety filter changes."""

import numpy as np

from npred.diagnosis.case import Case, Verdict
from npred.diagnosis.loops import LOOPS, fate, run, step
from npred.loop.safety import SafetyFilter
from npred.plants import inputs

STEPS, MOST = 20, 2000  # control steps in a delay, at least, and in a loop, at most


def applies(case: Case) -> bool:
    """True where a filter serves the plant, and its loops lead somewhere."""
    return case.plant.declares_safe and SafetyFilter.serves(case.plant) and case.sound and case.leads == "yes"


def kept(case: Case) -> Verdict:
    """Loops of a known delay that break a limit once a command acts, or do not converge; and by u0, before."""
    dt = step(case, (STEPS, STEPS))
    t_end = case.D + min(case.times[1], MOST * dt)
    both = (_failing(case, dt, t_end, safety) for safety in (None, SafetyFilter()))
    (early, _), outside, fails = zip(*both, strict=True)
    shown = case.plant.time_text
    text = (
        f"of {LOOPS} loops from the box, D = {shown(case.D)}, dt = {shown(dt, '.2g')}, in {shown(t_end, '.3g')}: "
        f"{outside[0].mean():.0%} break a limit, with a filter {outside[1].mean():.0%}; {fails[0].mean():.0%} do not "
        f"converge, with a filter {fails[1].mean():.0%}"
    )
    if early.any():
        u0 = inputs.sentence(case.plant, case.u0, case.limits)
        text += f"; before the first command acts {early.mean():.0%} break one that they kept, by u0: {u0}"
    if (fails[1] & ~fails[0]).any():
        return "warn", f"{text}; let kappa rest inside the limits, or take no filter"
    if outside[1].any():
        return "warn", f"{text}; shrink box, or let the limits be wider"
    return ("warn", f"{text}; set u0, in a pipeline or by --u0, or shrink box") if early.any() else ("yes", text)


def _failing(case: Case, dt: float, t_end: float, safety: SafetyFilter | None) -> tuple[np.ndarray, ...]:
    """The loops (LOOPS,) that break a limit before the first command acts, though they began within all; that break one
    later; and those that neither are at the target nor come nearer.
    """
    loops = run(case, case.D, case.X[:LOOPS], t_end, dt, safety=safety)
    kept, first = np.all(np.asarray(loops.safety) >= 0, axis=2), int(np.ceil(case.D / dt - 1e-9))
    early = kept[:, 0] & ~kept[:, :first].all(axis=1)
    return early, ~kept[:, first:].all(axis=1), ~fate(case, loops.X, t_end).converges
