"""The question how far a constant disturbance of an input moves the rest, and whether integral action helps."""

from typing import Any

import numpy as np

from npred.base.errors import ConfigError
from npred.diagnosis import loops
from npred.diagnosis.case import Case, Verdict
from npred.diagnosis.loops import Ensemble, simulated
from npred.estimation.observers import EKF

SHARE = 0.1  # the disturbance, relative to the range of an input
NEAR = 0.005  # relative to the box, 1 % of half of it: a smaller offset does not count


def applies(case: Case) -> bool:
    """True where the plant rests, and loops of it are simulated."""
    return case.plant.rests and loops.applies(case)


def rejected(case: Case) -> Verdict:
    """The steady offset that a constant disturbance of each input leaves, and whether the EKF takes it away."""
    plant, span = case.plant, np.ptp(case.limits, axis=1)
    sizes = SHARE * np.where(np.isfinite(span), span, np.ptp(case.u, axis=0))
    pushes = np.diag(sizes)[sizes > 0]
    if not len(pushes):
        return "yes", "not tested: the inputs have no range, from which to take the size of a disturbance"
    bare = [_disturbed(case, push) for push in pushes]
    offsets = np.array([each.offset for each in bare])
    with np.errstate(invalid="ignore"):
        worst = int(np.argmax(np.nan_to_num(np.abs(offsets / case.width).max(axis=1), nan=np.inf)))
    k = int(np.argmax(pushes[worst]))
    size = case.amount(plant.inputs[k], sizes[k])
    text = f"a constant disturbance of {size} at {plant.inputs[k]}, a tenth of its range,"
    figures: dict[str, Any] = {"disturbance": loops.numbers(plant.inputs, sizes)}
    figures["offset"] = loops.numbers(plant.states, offsets[worst])
    if all(each.fate.settled.all() for each in bare):
        return "yes", f"{text} leaves every state within 1 % of half the box", figures
    far = np.abs(offsets[worst])
    if bare[worst].still.all():
        text += f" moves the rest: {case.amounts(far, far > NEAR * case.width)}"
    elif bare[worst].diverges.any():
        text += " makes the loop diverge"
    else:
        text += f" moves the loop away from rest; it still moves after {plant.time_text(bare[worst].looked[0], '.3g')}"
    cure, seconds = _cure(case, pushes)
    figures["settling_time_with_offset"] = seconds
    return "yes" if cure else "warn", f"{text}{cure}", figures


def _disturbed(case: Case, push: np.ndarray, **parts: Any) -> Ensemble:
    """The loop with D_hat = D from rest, and a constant disturbance (m,)."""
    rest = case.plant.equilibrium[None]
    return simulated(case, case.D, rest, NEAR, u0="equilibrium", disturbance=lambda t: push, **parts)


def _cure(case: Case, pushes: np.ndarray) -> tuple[str, float | None]:
    """What the EKF with offset does, and in what time; empty if it does not remove all disturbances."""
    try:
        each = [_disturbed(case, push, observer=EKF(case.plant, offset=True)) for push in pushes]
    except ConfigError:  # there is none for this plant
        return "", None
    if not all(one.fate.settled.all() for one in each):
        return "", None
    seconds = max(float(one.fate.seconds.max()) for one in each)
    took = f"to 1 % of half the box in {case.plant.time_text(seconds, '.3g')}"
    return f"; an observer with offset=True removes this, {took}", seconds
