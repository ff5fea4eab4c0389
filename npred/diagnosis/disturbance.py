"""The question how far a constant disturbance of an input moves the rest, and whether integral action helps."""

from typing import Any

import numpy as np

from npred.base.errors import ConfigError
from npred.diagnosis import loops
from npred.diagnosis.case import Case, Verdict
from npred.diagnosis.loops import Ensemble, simulated
from npred.estimation.observers import EKF
from npred.loop.metrics import law
from npred.prediction.methods import RK4

SHARE = 0.1  # the disturbance, relative to the range of an input
NEAR = 0.005  # relative to the box, 1 % of half of it: a smaller offset does not count
NEWTON, STEP, EXACT = 12, 1e-6, 1e-6  # steps of Newton's method, its differences and its error, relative to the box


def applies(case: Case) -> bool:
    """True where the plant rests, and loops of it are simulated."""
    return case.plant.rests and loops.applies(case)


def rejected(case: Case) -> Verdict:
    """The steady offset that a constant disturbance of each input leaves, and whether the EKF takes it away."""
    plant, size_of = case.plant, sizes(case)
    pushes = np.diag(size_of)[size_of > 0]
    if not len(pushes):
        return "yes", "not tested: the inputs have no range, from which to take the size of a disturbance"
    bare = [_disturbed(case, push) for push in pushes]
    rests = [_rest(case, push, one) for push, one in zip(pushes, bare, strict=True)]
    ends = zip(rests, bare, strict=True)
    gone = [np.where(one.far, np.nan, one.offset) if rest is None else rest - plant.equilibrium for rest, one in ends]
    offsets = np.array(gone)
    settled, lost = all(one.fate.settled.all() for one in bare), [rest is None for rest in rests]
    with np.errstate(invalid="ignore"):
        shares = np.nan_to_num(np.abs(offsets / case.width).max(axis=1), nan=np.inf)
    worst = int(np.argmax(np.where(lost, np.inf, shares) if not settled and shares.max() <= NEAR else shares))
    k = int(np.argmax(pushes[worst]))
    size = case.amount(plant.inputs[k], size_of[k])
    text = f"a constant disturbance of {size} at {plant.inputs[k]}, a tenth of its range,"
    figures: dict[str, Any] = {"disturbance": loops.numbers(plant.inputs, size_of)}
    figures["offset"] = loops.numbers(plant.states, offsets[worst])
    if settled or (shares.max() <= NEAR and not any(lost)):
        return "yes", f"{text} leaves every state within 1 % of half the box", figures
    far = np.abs(offsets[worst])
    if rests[worst] is not None:
        text += f" moves the rest: {case.amounts(far, far > NEAR * case.width)}"
    else:
        text += f" takes loops from rest, and they {bare[worst].text().removeprefix('all ')}"
    cure, seconds = _cure(case, pushes)
    figures["settling_time_with_offset"] = seconds
    return "yes" if cure else "warn", f"{text}{cure}", figures


def sizes(case: Case) -> np.ndarray:
    """The disturbance of each input (m,): a tenth of its range, that of its bounds or of kappa on the box."""
    span = np.ptp(case.limits, axis=1)
    return SHARE * np.where(np.isfinite(span), span, np.ptp(case.u, axis=0))


def _disturbed(case: Case, push: np.ndarray, **parts: Any) -> Ensemble:
    """The loop with D_hat = D from rest, and a constant disturbance (m,)."""
    rest = case.plant.equilibrium[None]
    return simulated(case, case.D, rest, NEAR, u0="equilibrium", disturbance=lambda t: push, **parts)


def _rest(case: Case, push: np.ndarray, loop: Ensemble) -> np.ndarray | None:
    """The rest (n,) to which that disturbed loop goes, however slowly; None where it goes to none.

    There f(X, U + push) = 0 and U = kappa(P): P, the prediction that does not know the push, is where X' = f(X, U) ends
    a delay later. Newton's method starts where the loop is; then its distances to that rest must fall.
    """
    plant, rk4 = case.plant, RK4(case.plant, loops.nodes(case, case.D))
    if plant.declares_delay or loop.far[0]:
        return None

    def gap(z: np.ndarray) -> np.ndarray:
        """What is 0 at rest, for (X, U) (B, n + m)."""
        X, U = z[:, : plant.n], z[:, plant.n :]
        P = rk4(X, np.repeat(U[:, None], rk4.nx, axis=1), case.D)
        U_next = np.clip(law(plant, P, 0.0, case.D), *case.limits.T)
        return np.concatenate([plant.f(X, U + push), U_next - U], axis=1)

    z = np.concatenate([(loop.last_low + loop.last_high)[0] / 2, plant.u_equilibrium])
    unit = np.concatenate([case.width, np.full(plant.m, np.abs(push).max())])
    with np.errstate(all="ignore"):
        for _ in range(NEWTON):
            values = gap(np.concatenate([z[None], z + STEP * np.diag(unit)]))
            slopes = (values[1:] - values[0]).T / STEP  # per unit of (X, U)
            if not np.isfinite(slopes).all():
                return None
            z = z - unit * np.linalg.lstsq(slopes, values[0])[0]
        if not (np.abs(gap(z[None])[0]) <= EXACT * np.abs(slopes).sum(axis=1)).all():
            return None
    rest = z[: plant.n]
    near = loop.still[0] and (np.abs(loop.offset + plant.equilibrium - rest) <= NEAR * case.width).all()
    return rest if near or _disturbed(case, push, target=rest).fate.converges.all() else None


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
