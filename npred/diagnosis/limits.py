"""The question about the limits that a plant declares: which loops break them, and what a safety filter changes."""

import numpy as np

from npred.diagnosis.case import Case, Verdict
from npred.diagnosis.equilibrium import FALLING, HOME, LOOPS, distances, times
from npred.loop.closed_loop import simulate
from npred.loop.safety import SafetyFilter
from npred.loop.trajectories import Trajectories
from npred.prediction.methods import RK4

STEPS, MOST = 20, 2000  # control steps in a delay, at least, and in a loop, at most


def applies(case: Case) -> bool:
    """True where a filter serves the plant, and its loops lead somewhere."""
    return case.plant.declares_safe and SafetyFilter.serves(case.plant) and case.sound and case.leads == "yes"


def kept(case: Case) -> Verdict:
    """The loops from the box, of a known delay, that break a limit once the first command acts, or do not converge."""
    h, seconds, _ = times(case)
    dt = min(case.delay / STEPS, h)
    t_end = case.delay + min(seconds, MOST * dt)
    outside, lost = zip(*(_failing(case, dt, t_end, safety) for safety in (None, SafetyFilter())), strict=True)
    shown = case.plant.time_text
    text = (
        f"of {LOOPS} loops from the box, D = {shown(case.delay)}, dt = {shown(dt, '.2g')}, in {shown(t_end, '.3g')}: "
        f"{outside[0].mean():.0%} break a limit, with a filter {outside[1].mean():.0%}; {lost[0].mean():.0%} do not "
        f"converge, with a filter {lost[1].mean():.0%}"
    )
    if (lost[1] & ~lost[0]).any():
        return "warn", f"{text}; let kappa rest inside the limits, or take no filter"
    return ("warn", f"{text}; shrink box, or let the limits be wider") if outside[1].any() else ("yes", text)


def _failing(case: Case, dt: float, t_end: float, safety: SafetyFilter | None) -> tuple[np.ndarray, np.ndarray]:
    """The loops (LOOPS,) that break a limit, and those that neither are at the target nor come nearer."""
    loops = _run(case, dt, t_end, safety)
    since = int(np.ceil(case.delay / dt - 1e-9))
    h = loops.safety[:, since:]  # type: ignore[index]
    with np.errstate(all="ignore"):
        _, middle, _, end = (part.max(axis=1) for part in np.array_split(distances(case, loops.X, t_end), 4, axis=1))
    broken = np.logical_not((h >= 0).all(axis=(1, 2)))
    return broken, ~((end <= HOME) | (end < FALLING * middle))


def _run(case: Case, dt: float, t_end: float, safety: SafetyFilter | None) -> Trajectories:
    return simulate(
        case.plant, RK4(case.plant, 41), D=case.delay, D_hat=case.delay, X0=case.X[:LOOPS], t_end=t_end, dt=dt,
        u0=case.u0, input_bounds=case.limits, actuator="history", safety=safety, progress=False,
    )  # fmt: skip
