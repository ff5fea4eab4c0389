"""The question about loops whose delay is unknown: does the paper's law keep them, and if not, what would?"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from npred.config import FROZEN, PAPER, Loop
from npred.delays import problem_of
from npred.diagnosis.case import OBSERVER, Case, Verdict
from npred.diagnosis.equilibrium import FALLING, HOME, distances, times
from npred.loop.adaptation import DelayAdaptation
from npred.loop.delay_law import resolve
from npred.predictors import RK4

STARTS = 3  # of the box
ESTIMATES = (0.5, 1.5, 2.0)  # times D, where no pipeline gives first estimates
DELAYS = 40.0  # how long loops run at least
MOST = 4000  # control steps in a loop, at most
LARGEST = 6  # states up to which a plant is asked without a pipeline: the kernels of larger ones compile for a minute
NEAR = 0.05  # of the box: a loop that follows a reference is kept so close, for held commands are late by dt / 2
WEAKER = (0.1, 0.01)  # gains that are tried where loops are lost, times that of the law


class Mesh(NamedTuple):
    """Nodes of the predictor at most, and control steps in a delay, where they are not given or would be too many."""

    nodes: int
    steps: int


TRACED, UNTRACED = Mesh(31, 50), Mesh(11, 10)  # an f that runs in Python is slow


class Trial(NamedTuple):
    """Loops of the law from the starts X0 (S, n) and the estimates D_hat (E,), in seconds."""

    law: DelayAdaptation
    D: float
    D_hat: np.ndarray
    X0: np.ndarray
    dt: float
    seconds: float
    table: Loop | None


def applies(case: Case) -> bool:
    """True where the paper's law runs, and loops of kappa converge without delay."""
    runs = problem_of(case.plant).refusal("adaptation") is None and case.plant.declares_V
    table = case.pipeline.evaluate if case.pipeline else None
    asked = case.plant.n <= LARGEST if table is None else table.adaptation == PAPER
    return runs and case.sound and case.leads == "yes" and asked


def converges(case: Case) -> Verdict:
    """Whether loops of the paper's law come to their target, from the box and from first estimates on both sides of D.

    Where some do not, a weaker gain is looked for that keeps all.
    """
    loops = _loops(case)
    kept = _kept(case, loops)
    shown = case.plant.time_text
    estimates = ", ".join(f"{D_hat:g}" for D_hat in loops.D_hat)
    stated = case.pipeline is not None and case.pipeline.evaluate.gamma is not None
    gain = f"gamma = {loops.law.gamma:g}" + ("" if stated else ", which was derived from the plant and D,")
    came = f"{kept.size} loops with D = {shown(loops.D)}, {gain} and D_hat(0) = {estimates}"
    if kept.all():
        return "yes", f"{came} converge in {shown(loops.seconds, '.3g')}"
    start, estimate = (int(k) for k in np.argwhere(~kept)[0])
    where = f"as from D_hat(0) = {shown(loops.D_hat[estimate])} at {case.state(loops.X0[start])}"
    return "warn", f"{(~kept).mean():.0%} of {came} are lost, {where}; {_cure(case, loops, kept)}"


def _loops(case: Case) -> Trial:
    """Those of the pipeline's table [evaluate], else those of the law with nothing but the delay given."""
    X0, seconds = case.X[:STARTS], times(case)[1]
    if case.pipeline is None:
        D_hat, dt = case.delay * np.array(ESTIMATES), case.delay / _mesh(case).steps
        law = DelayAdaptation().suited(case.plant, case.delay, D_hat)
        return _timed(case, Trial(law, case.delay, D_hat, X0, dt, max(seconds, DELAYS * case.delay), None))
    table, law = case.pipeline.evaluate, resolve(case.pipeline.evaluate, case.plant)
    assert isinstance(law, DelayAdaptation)
    D_hat = np.array(sorted({table.D_hat0, *table.case_D_hat0}))
    X0 = np.concatenate([[table.X0], X0[1:]]) if len(table.X0) == case.plant.n else X0
    return _timed(case, Trial(law, table.D, D_hat, X0, table.dt, max(seconds, DELAYS * table.D), table))


def _timed(case: Case, loops: Trial) -> Trial:
    """The same with a longer step, and then in a shorter time, where there would be more steps than MOST."""
    dt = max(loops.dt, min(loops.seconds / MOST, loops.D / _mesh(case).steps))
    return loops._replace(dt=dt, seconds=min(loops.seconds, MOST * dt))


def _mesh(case: Case) -> Mesh:
    return TRACED if case.plant.traced else UNTRACED


def _kept(case: Case, loops: Trial, adaptation: str = PAPER) -> np.ndarray:
    """True (S, E) for loops that have converged, or still do, with another law where one is named."""
    from npred.conditions import Condition  # they load slowly
    from npred.loop import closed_loop
    from npred.loop.delay_observer import DelayObserver

    nodes = _mesh(case).nodes
    nodes = min(loops.table.nx, nodes) if loops.table else nodes
    X0, every, rk4 = loops.X0[:, None], max(round(loops.D / loops.dt / 10), 1), RK4(case.plant, nodes)
    if loops.table is None:
        law = {PAPER: loops.law, OBSERVER: DelayObserver(bounds=loops.law.bounds), FROZEN: None}[adaptation]
        run = closed_loop.simulate(
            case.plant, rk4, D=loops.D, D_hat=loops.D_hat, X0=X0, t_end=loops.seconds, dt=loops.dt, every=every,
            adaptation=law,
        )  # fmt: skip
    else:
        settings = {"gamma": loops.law.gamma, "dt": loops.dt, "adaptation": adaptation}
        table = loops.table.model_copy(update=settings)
        run = Condition(table, X0, loops.D, loops.D_hat, loops.seconds, seed=0).loops(case.plant, rk4, every=every)
    X = run.X.reshape(-1, *run.X.shape[-2:])
    gaps = distances(case, X, float(run.t[-1]))
    _, middle, _, end = (part.max(axis=1) for part in np.array_split(gaps, 4, axis=1))
    return ((end <= (HOME if case.plant.rests else NEAR)) | (end < FALLING * middle)).reshape(run.X.shape[:-2])


def _cure(case: Case, loops: Trial, kept: np.ndarray) -> str:
    """The keys to give, of those with which all loops are kept: a weaker gain, first estimates, or another law."""
    for share in WEAKER:
        law = replace(loops.law, gamma=float(f"{share * loops.law.gamma:g}"))
        if _kept(case, loops._replace(law=law)).all():
            return f"give gamma = {law.gamma:g}"
    cures = []
    if (good := kept.all(axis=0)).any():
        low, high = loops.D_hat[good].min(), loops.D_hat[good].max()
        cures.append(f"start the estimate within {low:g} to {case.plant.time_text(high)}")
    if _kept(case, loops, OBSERVER).all():
        cures.append(f'set adaptation = "{OBSERVER}"')
    if not good.any() and _kept(case, loops._replace(D_hat=np.array([loops.D])), FROZEN).all():
        cures.append(f'set adaptation = "{FROZEN}" and D_hat0 = D where the delay is known')
    return ", or ".join(cures) or f'neither "{OBSERVER}" nor the known delay keeps all; shorten D, or shrink box'
