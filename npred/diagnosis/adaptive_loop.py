"""The question about loops whose delay is unknown: do they converge with the paper's law, and if not, with what?"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from npred.base.registry import FROZEN, OBSERVER, PAPER
from npred.diagnosis.case import Case, Verdict
from npred.diagnosis.loops import FOLLOWS, HOME, LARGEST, fate
from npred.estimation.adaptation import DelayAdaptation
from npred.estimation.delay_observer import DelayObserver
from npred.loop.closed_loop import simulate
from npred.loop.trajectories import Trajectories
from npred.prediction.delays import problem_of
from npred.prediction.methods import RK4

STARTS = 3  # starts in the box
ESTIMATES = (0.5, 1.5, 2.0)  # times D, where no experiment gives first estimates
DELAYS = 40.0  # how long loops run at least
MOST = 4000  # control steps in a loop, at most
WEAKER = (0.1, 0.01)  # gains that are tried if loops do not converge, times the law's gain
# Nodes of the predictor at most, and control steps in a delay, where they are not given or would be too many.
TRACED, UNTRACED = (31, 50), (11, 10)  # an f that runs in Python is slow


@dataclass(frozen=True)
class AdaptiveLoops:
    """Loops of the paper's law from the starts X0 (S, n) and the estimates D_hat (E,).

    `derived` says that nobody chose gamma. `run` simulates these loops with the delay law of a name, (S, E) of them,
    and keeps every so many control steps.
    """

    law: DelayAdaptation
    D: float
    D_hat: np.ndarray
    X0: np.ndarray
    dt: float
    seconds: float
    nodes: int
    derived: bool
    run: Callable[["AdaptiveLoops", str, RK4, int], Trajectories]


def applies(case: Case) -> bool:
    """True where the paper's law runs, and loops of kappa converge without delay."""
    runs = problem_of(case.plant).refusal("adaptation") is None and case.plant.declares_V
    asked = case.experiment.adaptive is not None if case.experiment else case.plant.n <= LARGEST
    return runs and case.sound and case.leads == "yes" and asked


def converges(case: Case) -> Verdict:
    """Whether loops of the paper's law come to their target, from the box and from first estimates on both sides of D.

    They are those of the experiment, else those of the law with nothing but the delay given. If some do not converge,
    a weaker gain is sought with which all do.
    """
    experiment, (most_nodes, steps) = case.experiment, TRACED if case.plant.traced else UNTRACED
    if experiment and experiment.adaptive:
        loops = experiment.adaptive(case)
    else:
        D, D_hat, X0 = case.delay, case.delay * np.array(ESTIMATES), case.X[:STARTS]
        law, dt = DelayAdaptation().suited(case.plant, D, D_hat), D / steps
        loops = AdaptiveLoops(law, D, D_hat, X0, dt, case.times[1], most_nodes, True, _run)
    seconds = max(loops.seconds, DELAYS * loops.D)
    dt = max(loops.dt, min(seconds / MOST, loops.D / steps))  # longer, then in a shorter time, for MOST steps
    loops = replace(loops, dt=dt, seconds=min(seconds, MOST * dt), nodes=min(loops.nodes, most_nodes))

    converge, shown = _converge(case, loops), case.plant.time_text
    estimates = ", ".join(f"{D_hat:g}" for D_hat in loops.D_hat)
    gain = f"gamma = {loops.law.gamma:g}" + (", which was derived from the plant and D," if loops.derived else "")
    came = f"{converge.size} loops with D = {shown(loops.D)}, {gain} and D_hat(0) = {estimates}"
    if converge.all():
        return "yes", f"all {came} converge in {shown(loops.seconds, '.3g')}"
    start, estimate = (int(k) for k in np.argwhere(~converge)[0])
    where = f"as from D_hat(0) = {shown(loops.D_hat[estimate])} at {case.state(loops.X0[start])}"
    return "warn", f"{(~converge).mean():.0%} of {came} do not converge, {where}; {_cure(case, loops, converge)}"


def _run(loops: AdaptiveLoops, adaptation: str, rk4: RK4, every: int) -> Trajectories:
    law = {PAPER: loops.law, OBSERVER: DelayObserver(bounds=loops.law.bounds), FROZEN: None}[adaptation]
    return simulate(
        rk4.plant, rk4, D=loops.D, D_hat=loops.D_hat, X0=loops.X0[:, None], t_end=loops.seconds, dt=loops.dt,
        every=every, adaptation=law, progress=False,
    )  # fmt: skip


def _converge(case: Case, loops: AdaptiveLoops, adaptation: str = PAPER) -> np.ndarray:
    """True (S, E) for loops that have converged, or still do, with the paper's law or the one that is named."""
    run = loops.run(loops, adaptation, RK4(case.plant, loops.nodes), max(round(loops.D / loops.dt / 10), 1))
    X = run.X.reshape(-1, *run.X.shape[-2:])
    near = HOME if case.plant.rests else FOLLOWS
    return fate(case, X, float(run.t[-1]), near).converges.reshape(run.X.shape[:-2])


def _cure(case: Case, loops: AdaptiveLoops, converge: np.ndarray) -> str:
    """Keys with which all loops converge: a weaker gain, first estimates, or another law."""
    for share in WEAKER:
        law = replace(loops.law, gamma=float(f"{share * loops.law.gamma:g}"))
        if _converge(case, replace(loops, law=law)).all():
            return f"give gamma = {law.gamma:g}"
    cures = []
    if (good := converge.all(axis=0)).any():
        low, high = loops.D_hat[good].min(), loops.D_hat[good].max()
        cures.append(f"start the estimate within {low:g} to {case.plant.time_text(high)}")
    if _converge(case, loops, OBSERVER).all():
        cures.append(f'set adaptation = "{OBSERVER}"')
    if not good.any() and _converge(case, replace(loops, D_hat=np.array([loops.D])), FROZEN).all():
        cures.append(f'set adaptation = "{FROZEN}" and D_hat = D if the delay is known')
    return ", or ".join(cures) or f'with "{OBSERVER}", or a known delay, some do not either; shorten D, or shrink box'
