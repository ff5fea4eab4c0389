"""Questions about the target of kappa: is there an equilibrium, is it stable, is a reference a trajectory?"""

import numpy as np

from npred.diagnosis.case import Case, Verdict
from npred.loop.suited_gain import closed_loop
from npred.plants.base import Plant
from npred.symbolic import array_math, programs, source_lines
from npred.symbolic.tape import names
from npred.symbolic.trace import Trace, python

HORIZON = 100.0  # s, over which a reference is looked at where no pipeline says how long
SLIP = 1e-6  # how far a reference may be from a trajectory, as a share of 1 + its rate
STEPS = (1e-5, 1e-6, 1e-7)  # s, of differences in time: short for what is fast, long against rounding


def equilibrium(case: Case) -> Verdict:
    """Whether f(X*, kappa(X*)) = 0 has a solution near `guess`, with an input that the plant accepts."""
    plant = case.plant
    X, u = plant.equilibrium, plant.u_equilibrium
    values = source_lines.values(plant.inputs, u)
    if (u < case.limits[:, 0]).any() or (u > case.limits[:, 1]).any():
        outside = f"outside input_bounds {case.limits.tolist()}"
        return "no", f"plant {plant.name}: rests with {values}, {outside}; move the set point"
    ranges = [(name, x, *case.box[name]) for name, x in zip(plant.states, X, strict=True) if name in case.box]
    beyond = [f"{name} in [{a:g}, {b:g}]" for name, x, a, b in ranges if not a <= x <= b]
    if beyond:
        outside = f"outside the box, {', '.join(beyond)}, so loops start on one side of it"
        return "warn", f"{case.state(X)}, with {values}: {outside}"
    return "yes", f"{case.state(X)}, with {values}"


def exists(case: Case) -> bool:
    """Whether the plant rests, and an equilibrium was not asked for in vain."""
    return case.plant.rests and case.verdict("equilibrium") != "no"


def stability(case: Case) -> Verdict:
    """Whether the loop of kappa without delay is stable: the eigenvalues of f_X + f_U kappa' at the equilibrium."""
    plant = case.plant
    A = closed_loop(plant)
    if not np.isfinite(A).all():
        return (
            "no",
            f"{plant.location('kappa')}: no derivative at the equilibrium; guard the term that has none",
        )
    rates = sorted(np.linalg.eigvals(A), key=lambda rate: -rate.real)  # the slowest first
    values = ", ".join(f"{rate.real:.3g}" + (f" {rate.imag:+.3g}i" if rate.imag else "") for rate in rates)
    if rates[0].real < 0:
        return "yes", f"eigenvalues of the loop without delay: {values}"
    at = f"eigenvalues {values} at {case.state(plant.equilibrium)}, expected all negative"
    return "no", f"{plant.location('kappa')} does not stabilise without delay: {at}; check its signs and gains"


def reference(case: Case) -> Verdict:
    """Whether the declared reference is a trajectory of f with kappa, over the pipeline's case or HORIZON seconds."""
    plant = case.plant
    if not plant.tracks:
        text = "f or kappa depends on time and no reference(t, p, M) says what it follows: its loops have no radius"
        return "warn", f"{text}; declare one to evaluate the plant"
    seconds = case.pipeline.evaluate.case_t_end if case.pipeline else HORIZON
    excess, t = slip(plant, seconds)
    if excess <= SLIP:
        return "yes", f"a trajectory of f with kappa for {plant.time_text(seconds)}, to {excess:.1g}"
    came = f"got one that differs from it by {excess:.2g} at t = {plant.time_text(t, '.3g')}"
    cure = "let its derivative be f(reference, kappa(reference, t), t)"
    return "no", f"{plant.location('reference')} expected a trajectory of f with kappa, {came}; {cure}"


def slip(plant: Plant, t_end: float) -> tuple[float, float]:
    """sup |reference' - f(reference, kappa)| / (1 + |reference'|) over t_end seconds, and the time where it is."""
    t = np.linspace(0.0, t_end, 1001)
    right = plant.f(plant.target(t), plant.u_target(t), t)
    gaps = [np.linalg.norm(s - right, axis=-1) / (1 + np.linalg.norm(s, axis=-1)) for s in _slopes(plant, t)]
    gap = np.min(np.nan_to_num(gaps, nan=np.inf, posinf=np.inf), axis=0)
    return float(gap.max()), float(t[np.argmax(gap)])


def _slopes(plant: Plant, t: np.ndarray) -> list[np.ndarray]:
    """reference' (T, n): exact, or of a plant that is not traced by differences, of which the nearest counts."""
    if not plant.traced:
        return [(plant.target(t + h) - plant.target(t - h)) / (2 * h) for h in STEPS]
    trace = Trace(plant)
    clock = trace.input("t")
    by_t = programs.derivative(trace.reference(clock), [clock], [1.0])
    with np.errstate(all="ignore"):
        values = python(by_t, ["t", *names("p", len(plant.p))])(t, *plant.p)
    return [array_math.stack(values, t)]
