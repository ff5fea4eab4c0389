"""Questions about kappa without delay: has it an equilibrium or a reference, is that stable, do loops come there?"""

from typing import Any

import numpy as np

from npred.base import source_lines
from npred.diagnosis.case import Case, Verdict
from npred.formulas import array_math, programs
from npred.formulas.tape import names
from npred.formulas.trace import Trace, python
from npred.plants import inputs
from npred.plants.base import Plant
from npred.prediction.methods import RK4

HORIZON = 100.0  # s, over which a reference and its loops are looked at where no experiment says how long
SLIP = 1e-6  # how far a reference may be from a trajectory, as a share of 1 + its rate
STEPS = (1e-5, 1e-6, 1e-7)  # s, of differences in time: short for what is fast, long against rounding
LOOPS = 64  # starts, of the states of the box
STEP = 0.5  # of a step of RK4, times the fastest rate on the box
MOST = 20_000  # steps
SPAN = 30.0  # time constants of the slowest rate at the equilibrium
HOME = 0.01  # of the box: this close to its target a loop has converged
FALLING = 0.9  # a loop that still converges is this much closer in the last quarter than in the second


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


def stability(case: Case) -> Verdict:
    """Whether the loop of kappa without delay is stable: the eigenvalues of f_X + f_U kappa' at the equilibrium."""
    plant = case.plant
    A, _ = plant.linearised()
    if not np.isfinite(A).all():
        return "no", f"{plant.location('kappa')}: no derivative at the equilibrium; guard the term that has none"
    rates = sorted(np.linalg.eigvals(A), key=lambda rate: -rate.real)  # the slowest first
    values = ", ".join(f"{rate.real:.3g}" + (f" {rate.imag:+.3g}i" if rate.imag else "") for rate in rates)
    if rates[0].real < 0:
        return "yes", f"eigenvalues of the loop without delay: {values}"
    at = f"eigenvalues {values} at {case.state(plant.equilibrium)}, expected all negative"
    cure = "check its signs and gains, or move guess to the rest that it holds"
    return "no", f"{plant.location('kappa')} does not stabilise without delay: {at}; {cure}"


def reference(case: Case) -> Verdict:
    """Whether the declared reference is a trajectory of f with kappa, over the experiment's or HORIZON seconds."""
    plant = case.plant
    if not plant.tracks:
        text = "f or kappa depends on time and no reference(t, p, M) says what it follows: its loops have no radius"
        return "warn", f"{text}; declare one to evaluate the plant"
    seconds = case.experiment.seconds if case.experiment else HORIZON
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
    if plant.traced:
        trace = Trace(plant)
        clock = trace.input("t")
        by_t = programs.derivative(trace.reference(clock), [clock], [1.0])
        with np.errstate(all="ignore"):
            values = python(by_t, ["t", *names("p", len(plant.p))])(t, *plant.p)
        slopes = [array_math.stack(values, t)]
    else:  # differences, of which the nearest counts
        slopes = [(plant.target(t + h) - plant.target(t - h)) / (2 * h) for h in STEPS]
    gaps = [np.linalg.norm(s - right, axis=-1) / (1 + np.linalg.norm(s, axis=-1)) for s in slopes]
    gap = np.min(np.nan_to_num(gaps, nan=np.inf, posinf=np.inf), axis=0)
    return float(gap.max()), float(t[np.argmax(gap)])


def limited(case: Case) -> Verdict:
    """The share of kappa on the box that lies outside the input bounds; without any, those of a controller."""
    if not np.isfinite(case.limits).any():
        widest = inputs.widest(case.plant, case.limits)
        kept = source_lines.ranges(case.plant.inputs, widest)
        return "yes", f"none declared; a controller keeps {kept}, {inputs.SPARE:g} times the largest kappa of the box"
    with np.errstate(all="ignore"):
        U = case.plant.kappa(case.X)
    outside = (np.clip(U, *case.limits.T) != U).any(axis=-1)
    pairs = source_lines.ranges(case.plant.inputs, case.limits)
    if not outside.any():
        return "yes", f"kappa is within {pairs} at {len(U)} states of the box"
    worst = int(np.argmax(outside))
    share = f"{outside.mean():.0%} of {len(U)} states of the box"
    return "warn", f"kappa is outside {pairs} at {share}, as at {case.state(case.X[worst])}, and is clipped there"


def converges(case: Case) -> Verdict:
    """Whether loops of the clipped kappa without delay come from the box to the equilibrium or the reference."""
    X0, (_, seconds, horizon) = case.X[:LOOPS], times(case)
    middle, end = approach(case, X0)
    home, shown = end <= HOME, case.plant.time_text(seconds, ".3g")
    if home.all():
        return "yes", f"{len(X0)} loops from the box, without delay, converge in {shown}"
    lost = ~home & ~(end < FALLING * middle)
    if seconds < horizon:
        text = f"{home.mean():.0%} of {len(X0)} loops without delay converged in {shown}, as long as was looked"
        return "warn", f"{text}: its slowest rate is {horizon / seconds:.2g} times slower"
    if not lost.any():
        text = f"{home.mean():.0%} of {len(X0)} loops without delay have converged after {shown}"
        return "warn", f"{text}, the others still converge"
    start = case.state(X0[np.argmax(lost)])
    failing = f"{lost.mean():.0%} of {len(X0)} loops without delay do not converge, as from {start}"
    cure = "shrink box" + (", or widen input_bounds" if np.isfinite(case.limits).any() else ", or change kappa there")
    return "no", f"{case.plant.location('kappa')}: {failing}; {cure}"


def approach(case: Case, X0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The largest distance to the target in the second and the last quarter of loops without delay from X0 (B, n)."""
    closed, (h, seconds, _) = _closed(case), times(case)
    nodes = max(int(seconds / h), 4) + 1
    X = RK4(closed, nodes)(X0, np.zeros((nodes, closed.m)), seconds)
    _, middle, _, end = (part.max(axis=1) for part in np.array_split(distances(case, X, seconds), 4, axis=1))
    return middle, end


def times(case: Case) -> tuple[float, float, float]:
    """The step, the seconds to look at, and the seconds that are needed: SPAN time constants, or HORIZON."""
    plant, X = case.plant, case.X
    f_X, f_U = plant.jacobians(X, case.u)
    rates = np.abs(np.linalg.eigvals(np.concatenate([f_X, f_X + f_U @ plant.kappa_jacobian(X)]))).max()
    horizon = HORIZON
    if plant.rests:
        eigenvalues = np.linalg.eigvals(plant.linearised()[0])
        rates, horizon = max(rates, np.abs(eigenvalues).max()), SPAN / -eigenvalues.real.max()
    h = STEP / rates if rates > 0 else horizon / MOST
    return h, min(horizon, MOST * h), horizon


def distances(case: Case, X: np.ndarray, seconds: float) -> np.ndarray:
    """Distances of loops X (B, nt, n) from their target, in widths of the box, (B, nt)."""
    target = case.plant.target(np.linspace(0.0, seconds, X.shape[1]))
    width = np.ptp(case.ends, axis=1)
    width = np.where(width > 0, width, np.maximum(np.abs(case.ends[:, 0]), 1.0))
    with np.errstate(all="ignore"):
        return np.linalg.norm((X - target) / width, axis=-1)


def _closed(case: Case) -> Plant:
    """The plant with the clipped kappa for its input: X' = f(X, kappa(X, t), t), and an input that does nothing."""
    plant, limits = case.plant, case.limits

    def kappa(x: Any, t: Any, p: Any, M: Any) -> list[Any]:
        U = plant.call("kappa", [*x], None, t, [*p], M)
        for k, (low, high) in enumerate(limits):
            U[k] = M.maximum(U[k], low) if low > -np.inf else U[k]
            U[k] = M.minimum(U[k], high) if high < np.inf else U[k]
        return U

    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> list[Any]:
        return plant.call("f", [*x], kappa(x, t, p, M), t, [*p], M)

    def kappa_of_rows(X: np.ndarray, t: Any, p: Any) -> np.ndarray:
        return np.clip(plant.kappa(X, t), *limits.T)

    def f_of_rows(X: np.ndarray, u: Any, t: Any, p: Any) -> np.ndarray:
        return plant.f(X, kappa_of_rows(X, t, p), t)

    functions: dict[str, Any] = {"f": f, "kappa": kappa}
    if not plant.traced:
        functions = {"f": f_of_rows, "kappa": kappa_of_rows}
    parts = {name: getattr(plant, name) for name in ("states", "inputs", "parameters", "period", "guess", "traced")}
    parts |= {name: staticmethod(function) for name, function in functions.items()}
    return type(plant)(f"{plant.name}, controlled", type("Closed", (), parts), {}, plant.source)
