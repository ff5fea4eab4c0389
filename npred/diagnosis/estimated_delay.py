"""The question whether the outputs of a plant tell its delay, where its state is not measured."""

import numpy as np

from npred.base.errors import ConfigError
from npred.diagnosis import loops
from npred.diagnosis.case import Case, Verdict
from npred.estimation.delay_observer import DelayObserver
from npred.estimation.observers import EKF
from npred.loop.measurement import Measurement
from npred.plants.speed import rates
from npred.prediction.delays import problem_of

ESTIMATES = (0.5, 0.5, 2.0, 2.0)  # times D, each from two starts in the box
SPAN = 8.0  # delays and usual time constants that a loop lasts: later it rests, and tells nothing
STEPS, MOST = (20, 50), 4000  # control steps in a delay, and in a loop at most
CLEAR = 0.25  # of the range of the bounds: a wider spread tells nothing


def applies(case: Case) -> bool:
    """True for a plant with outputs, and loops that an observer of the delay serves."""
    plant = case.plant
    asked = plant.declares_output and plant.traced and not plant.declares_delay and case.experiment is None
    return asked and loops.applies(case) and problem_of(plant).refusal("observer") is None


def found(case: Case) -> Verdict:
    """Whether loops with an observer of the delay and the EKF find D, and what the spread says where they do not."""
    plant, law = case.plant, DelayObserver(bounds=(0.1 * case.D, 4.0 * case.D))
    try:
        of = EKF(plant, offset=True)
    except ConfigError as fault:
        return "warn", f"not tested: {fault}"
    dt = loops.step(case, STEPS)
    t_end = min(SPAN * (case.D + 1.0 / rates(plant).usual), MOST * dt)
    run = loops.run(
        case, case.D * np.array(ESTIMATES), case.X[[0, 1, 0, 1]], t_end, dt, adaptation=law, observer=of,
        measurement=Measurement(noise=tuple(np.sqrt(of.R).tolist())),
    )  # fmt: skip
    spread, shown = float(run.D_hat_spread.max()), plant.time_text
    off = float(np.abs(run.D_hat[:, -1] - case.D).max())
    text = (
        f"from {ESTIMATES[0]:g} D and {ESTIMATES[-1]:g} D, with an EKF and noise of 1 % of half the outputs' range, "
        f"D_hat is {shown(off, '.2g')} off at most after {shown(t_end, '.3g')}, D_hat_spread is {shown(spread, '.2g')}"
    )
    figures = {"D_hat_error": off, "D_hat_spread": spread}
    if spread <= CLEAR * (law.bounds[1] - law.bounds[0]):
        return ("yes" if off <= 2 * spread else "warn"), text, figures
    cure = "move the set-point, measure more, or give D and freeze the estimate"
    return "warn", f"{text}: the outputs do not tell the delay; {cure}", figures
