"""Questions that loops from the box answer: is a predictor needed, are limits kept, do outputs tell the delay?"""

import numpy as np

from npred.base.errors import ConfigError
from npred.diagnosis.case import Case, Verdict
from npred.diagnosis.loops import HOME, LOOPS, Ensemble, applies, ensemble, fate, run, starts, step
from npred.estimation.delay_observer import DelayObserver
from npred.estimation.observers import EKF
from npred.loop.measurement import Measurement
from npred.loop.safety import SafetyFilter
from npred.plants import inputs
from npred.plants.speed import rates
from npred.prediction.delays import problem_of

SLOWER, FARTHER = 1.1, 0.05  # without a predictor, as good: at most so many times the time, and share of half the box
FEW, FEW_LONG = 20, 2000  # of loops with limits: control steps in a delay, at least, and in a loop, at most
ESTIMATES = (0.5, 0.5, 2.0, 2.0)  # times D, each from two starts in the box
SPAN = 8.0  # delays and usual time constants that such a loop lasts: later it rests, and tells nothing
STEPS, MOST = (20, 50), 4000  # control steps in its delay, and in it at most
CLEAR = 0.25  # of the range of the bounds: a wider spread tells nothing


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


def limits_apply(case: Case) -> bool:
    """True where a filter serves the plant, and its loops lead somewhere."""
    return case.plant.declares_safe and SafetyFilter.serves(case.plant) and case.sound and case.leads == "yes"


def kept(case: Case) -> Verdict:
    """Loops of a known delay that break a limit once a command acts, or do not converge; and by u0, before."""
    dt = step(case, (FEW, FEW))
    t_end = case.D + min(case.times[1], FEW_LONG * dt)
    both = (_failing(case, dt, t_end, safety) for safety in (None, SafetyFilter()))
    (early, _), outside, fails, (_, promised) = zip(*both, strict=True)
    shown = case.plant.time_text
    text = (
        f"of {LOOPS} loops from the box, D = {shown(case.D)}, dt = {shown(dt, '.2g')}, in {shown(t_end, '.3g')}: "
        f"{outside[0].mean():.0%} break a limit, with a filter {outside[1].mean():.0%}; {fails[0].mean():.0%} do not "
        f"converge, with a filter {fails[1].mean():.0%}; {promised.mean():.0%} are promised to keep them for good"
    )
    if early.any():
        u0 = inputs.sentence(case.plant, case.u0, case.limits)
        text += f"; before the first command acts {early.mean():.0%} break one that they kept, by u0: {u0}"
    safety = SafetyFilter()
    values = safety.numbers(case.plant, dt, case.limits)["safety"]
    for doubt in safety.doubts(case.plant, dt, values, case.limits):
        return "warn", f"{text}; {doubt.removeprefix('safety: ')}"
    if (fails[1] & ~fails[0]).any():
        return "warn", f"{text}; let kappa rest inside the limits, or take no filter"
    if outside[1].any():
        return "warn", f"{text}; shrink box, or let the limits be wider"
    return ("warn", f"{text}; set u0, in a pipeline or by --u0, or shrink box") if early.any() else ("yes", text)


def _failing(case: Case, dt: float, t_end: float, safety: SafetyFilter | None) -> tuple[np.ndarray, ...]:
    """The loops (LOOPS,) that break a limit before the first command acts, though they began within all; that break one
    later; those that neither are at the target nor come nearer; and those whose first step is promised.
    """
    loops = run(case, case.D, case.X[:LOOPS], t_end, dt, safety=safety)
    kept, first = np.all(np.asarray(loops.safety) >= 0, axis=2), int(np.ceil(case.D / dt - 1e-9))
    early = kept[:, 0] & ~kept[:, :first].all(axis=1)
    return early, ~kept[:, first:].all(axis=1), ~fate(case, loops.X, t_end).converges, loops.promised[:, 0]


def estimate_applies(case: Case) -> bool:
    """True for a plant with outputs, and loops that an observer of the delay serves."""
    plant = case.plant
    asked = plant.declares_output and plant.traced and not plant.declares_delay and case.experiment is None
    return asked and applies(case) and problem_of(plant).refusal("observer") is None


def found(case: Case) -> Verdict:
    """Whether loops with an observer of the delay and the EKF find D, and what the spread says where they do not."""
    plant, law = case.plant, DelayObserver(bounds=(0.1 * case.D, 4.0 * case.D))
    try:
        of = EKF(plant, offset=True)
    except ConfigError as fault:
        return "warn", f"not tested: {fault}"
    dt = step(case, STEPS)
    t_end = min(SPAN * (case.D + 1.0 / rates(plant).usual), MOST * dt)
    loops = run(
        case, case.D * np.array(ESTIMATES), case.X[[0, 1, 0, 1]], t_end, dt, adaptation=law, observer=of,
        measurement=Measurement(noise=tuple(np.sqrt(of.R).tolist())),
    )  # fmt: skip
    spread, shown = float(loops.D_hat_spread.max()), plant.time_text
    off = float(np.abs(loops.D_hat[:, -1] - case.D).max())
    text = (
        f"from {ESTIMATES[0]:g} D and {ESTIMATES[-1]:g} D, with an EKF and noise of 1 % of half the outputs' range, "
        f"D_hat is {shown(off, '.2g')} off at most after {shown(t_end, '.3g')}, D_hat_spread is {shown(spread, '.2g')}"
    )
    figures = {"D_hat_error": off, "D_hat_spread": spread}
    if spread <= CLEAR * (law.bounds[1] - law.bounds[0]):
        return ("yes" if off <= 2 * spread else "warn"), text, figures
    cure = "move the set-point, measure more, or give D and freeze the estimate"
    return "warn", f"{text}: the outputs do not tell the delay; {cure}", figures
