"""Questions about kappa without delay: has it an equilibrium or a reference, is that stable, do loops come there?

And does V fall along its loop? If not, x'Sx of the Lyapunov equation is offered.
"""

from typing import Any

import numpy as np

from npred.base import source_lines
from npred.diagnosis.case import Case, Verdict
from npred.diagnosis.loops import LOOPS, Fate, fate
from npred.estimation.adaptation import undeclared
from npred.formulas import array_math, programs
from npred.formulas.tape import names
from npred.formulas.trace import Trace, python
from npred.laws.law import error
from npred.laws.regulator import lyapunov
from npred.plants import inputs, setpoint, speed
from npred.plants.base import Plant
from npred.prediction.methods import RK4

SLIP = 1e-6  # how far a reference may be from a trajectory, as a share of the usual rate + its own
STEPS = (1e-5, 1e-6, 1e-7)  # times the usual time constant, of differences: short for what is fast, not for rounding
NEAR = 0.01  # share of the box, around rest: loops come there from all sides, whichever side the box is on
DECLARE = 'npred plants check offers one; or set adaptation = "delay-observer", "l1" or "frozen", which need none'
ROUNDING, DIFFERENCES = 1e-9, 1e-6  # relative: what of S and of a rest is rounding, and where f_X is a difference
SAME = 1e-3  # share of its largest value: this close to x'Sx a V is taken for it


def equilibrium(case: Case) -> Verdict:
    """Whether f(X*, kappa(X*)) = 0 has a solution near `guess`, with an input that the plant accepts, within its
    `state_bounds`, and where its limits `safe` are kept."""
    plant = case.plant
    X, u = plant.equilibrium, plant.u_equilibrium
    values = source_lines.values(plant.inputs, u)
    if outside := setpoint.beyond(plant, np.append(X, u), setpoint.bounds(plant, case.limits)):
        of_inputs = f"input_bounds {case.limits.tolist()} or state_bounds"
        return "no", f"plant {plant.name}: rests with {outside}, outside {of_inputs}; move the set point, or the bounds"
    with np.errstate(all="ignore"):
        limits = plant.safe(X) if plant.declares_safe else np.zeros(0)
    broken = ~(limits >= 0)  # NaN is not kept
    if broken.any():
        names = [f"limit {k + 1} of {len(limits)}" for k in np.flatnonzero(broken)]
        broken = source_lines.values(names, limits[broken])
        return "warn", f"{case.state(X)}, with {values}: outside safe, {broken}; move the set point, or the limits"
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
        return "no", f"{plant.location('kappa')}: no derivative at rest; guard the term that has none"
    rates = sorted(np.linalg.eigvals(A), key=lambda rate: -rate.real)  # the slowest first
    values = ", ".join(f"{rate.real:.3g}" + (f" {rate.imag:+.3g}i" if rate.imag else "") for rate in rates)
    if rates[0].real < 0:
        return "yes", f"eigenvalues of the loop without delay: {values}"
    at = f"eigenvalues {values} at {case.state(plant.equilibrium)}, expected all negative"
    cure = "check its signs and gains, or move guess to the rest of kappa"
    return "no", f"{plant.location('kappa')} does not stabilise without delay: {at}; {cure}"


def reference(case: Case) -> Verdict:
    """Whether the declared reference is a trajectory of f with kappa, as long as loops last, or `speed.settled`."""
    plant = case.plant
    if not plant.tracks:
        text = "f or kappa depends on time, and no reference(t, p, M) says what they follow: loops have no radius"
        return "warn", f"{text}; declare one to evaluate the plant"
    seconds = case.experiment.seconds if case.experiment else speed.settled(plant)
    excess, t = slip(plant, seconds)
    if excess <= SLIP:
        return "yes", f"a trajectory of f with kappa for {plant.time_text(seconds, '.3g')}, to {excess:.1g}"
    came = f"got one that differs from it by {excess:.2g} at t = {plant.time_text(t, '.3g')}"
    cure = "let its derivative be f(reference, kappa(reference, t), t)"
    return "no", f"{plant.location('reference')} expected a trajectory of f with kappa, {came}; {cure}"


def slip(plant: Plant, t_end: float) -> tuple[float, float]:
    """sup |reference' - f(reference, kappa)| / (r + |reference'|) over t_end, r the usual rate; and when it is."""
    t, usual = np.linspace(0.0, t_end, 1001), speed.rates(plant).usual
    right = plant.f(plant.target(t), plant.u_target(t), t)
    if plant.traced:
        trace = Trace(plant)
        clock = trace.input("t")
        by_t = programs.derivative(trace.reference(clock), [clock], [1.0])
        with np.errstate(all="ignore"):
            values = python(by_t, ["t", *names("p", len(plant.p))])(t, *plant.p)
        slopes = [array_math.stack(values, t)]
    else:  # differences, of which the nearest counts
        slopes = [(plant.target(t + h) - plant.target(t - h)) / (2 * h) for h in np.array(STEPS) / usual]
    gaps = [np.linalg.norm(s - right, axis=-1) / (usual + np.linalg.norm(s, axis=-1)) for s in slopes]
    gap = np.min(np.nan_to_num(gaps, nan=np.inf, posinf=np.inf), axis=0)
    return float(gap.max()), float(t[np.argmax(gap)])


def limited(case: Case) -> Verdict:
    """The share of kappa on the box that lies outside the input bounds; without any, those of a controller."""
    if not np.isfinite(case.limits).any():
        widest = inputs.widest(case.plant, case.limits)
        within = source_lines.ranges(case.plant.inputs, widest)
        times = f"{inputs.SPARE:g} times the largest kappa of the box"
        return "yes", f"none are declared; a controller keeps {within}, {times}"
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
    X0, (_, seconds, horizon) = case.X[:LOOPS], case.times
    loops, shown = approach(case, X0), case.plant.time_text(seconds, ".3g")
    home, fails = loops.settled, ~loops.converges
    if home.all():
        return "yes", f"all {len(X0)} loops from the box, without delay, {loops.text(case)}", loops.figures
    if seconds < horizon:
        text = f"{home.mean():.0%} of {len(X0)} loops without delay settled in {shown}, the longest time simulated"
        return "warn", f"{text}; the slowest rate needs {horizon / seconds:.2g} times as long", loops.figures
    if not fails.any():
        text = f"{home.mean():.0%} of {len(X0)} loops without delay have settled after {shown}"
        return "warn", f"{text}, the others still converge", loops.figures
    start = case.state(X0[np.argmax(fails)])
    failing = f"{fails.mean():.0%} of {len(X0)} loops without delay do not converge, as from {start}"
    cure = "shrink box" + (", or widen input_bounds" if np.isfinite(case.limits).any() else ", or change kappa there")
    return "no", f"{case.plant.location('kappa')}: {failing}; {cure}", loops.figures


def approach(case: Case, X0: np.ndarray) -> Fate:
    """How loops without delay from X0 (B, n) end."""
    closed, (h, seconds, _) = _closed(case), case.times
    nodes = max(int(seconds / h), 600) + 1  # a time constant has 20, at least
    X = RK4(closed, nodes)(X0, np.zeros((nodes, closed.m)), seconds)
    return fate(case, X, seconds)


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
    parts = {name: getattr(plant, name) for name in ("states", "inputs", "period", "guess", "traced")}
    parts["parameters"] = dict(zip(plant.p_names, plant.p.tolist(), strict=True))
    parts |= {name: staticmethod(function) for name, function in functions.items()}
    return type(plant)(f"{plant.name}, controlled", type("Closed", (), parts), {}, plant.source)


def V_applies(case: Case) -> bool:
    """True if V is missing, is not needed, or can be looked at: kappa stabilises, and the box is sound."""
    if not case.plant.rests:
        return case.takes_V and not case.plant.declares_V
    unneeded = not case.plant.declares_V and not case.takes_V
    stable = case.sound and case.leads == "yes"
    return case.verdict("equilibrium") != "no" and (unneeded or stable)


def V_falls(case: Case) -> Verdict:
    """Whether V' = V_X f(X, kappa(X)) < 0 from the box to rest."""
    if not case.takes_V:
        declared = "declared" if case.plant.declares_V else "not declared"
        return "yes", f"{declared}; no law that runs needs it"
    lacks = "warn" if case.experiment is None else "no"  # where nothing says which law will run
    missing = f"{undeclared(case.plant)}; delay-observer, l1 and frozen need none"
    if not case.plant.rests:
        return lacks, f"{missing}; declare the squared distance to the reference"
    X = _towards_rest(case)
    S = lyapunov(case.plant.linearised()[0])
    if not case.plant.declares_V:
        return lacks, f"{missing}; a candidate: {_offer(case, S, X)}"
    plant = case.plant
    if plant.traced:  # the input is not clipped
        trace, t = Trace(plant), 0.0
        x = trace.vector("x", plant.n)
        slope = programs.derivative([trace.V(x, t)], x, trace.f(x, trace.kappa(x, t), t))
        rate = python(slope, [*names("x", plant.n), *names("p", len(plant.p))])
        with np.errstate(all="ignore"):
            rates = np.array([rate(*row, *plant.p)[0] for row in X], dtype=float)
    else:  # central differences along the loop's velocity
        velocity = plant.f(X, plant.kappa(X))
        h = 1e-6 / (speed.rates(plant).usual + np.linalg.norm(velocity, axis=-1))
        rates = (plant.V(X + h[:, None] * velocity) - plant.V(X - h[:, None] * velocity)) / (2 * h)
    rising = ~(rates < 0)
    if not rising.any():
        return "yes", f"V' < 0 along the loop of kappa, at {len(X)} states of the box, towards rest and around it"
    worst = int(np.argmax(np.where(np.isnan(rates), np.inf, rates)))
    where = f"V' = {rates[worst]:.3g} at {case.state(X[worst])}, and {rising.mean():.0%} of {len(X)} states are like it"
    rises = f"{case.plant.location('V')} does not fall along the loop: {where}"
    if rising.mean() > (_offered(case, S, X) >= 0).mean():
        return "warn", f"{rises}; {_offer(case, S, X)}"
    if _proportional(case, S, X):
        share = f"{1 - rising.mean():.0%} of {len(X)} states"
        return "yes", f"V solves the Lyapunov equation, and falls at {share}: the box is larger than that region"
    return "warn", f"{rises}; no x'Sx does better: shrink box"


def _towards_rest(case: Case) -> np.ndarray:
    """The states of the box, as many between them and the equilibrium, and as many close around it, (3 samples, n)."""
    rest, X = case.plant.equilibrium, case.X
    share = np.linspace(0.02, 1.0, len(X))[:, None]
    around = NEAR * np.ptp(X, axis=0) * np.random.default_rng(0).uniform(-1, 1, X.shape)
    return np.concatenate([X, rest + share * (X - rest), rest + around])


def _offered(case: Case, S: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Half the derivative of e'Se along the loop of kappa, e = X - X*, at the states X (B, n), (B,)."""
    return np.einsum("bi,ij,bj->b", X - case.plant.equilibrium, S, case.plant.f(X, case.plant.kappa(X)))


def _proportional(case: Case, S: np.ndarray, X: np.ndarray) -> bool:
    """True if the declared V is e'Se times a number."""
    e = X - case.plant.equilibrium
    V, quadratic = case.plant.V(X), np.einsum("bi,ij,bj->b", e, S, e)
    return bool(np.abs(V * quadratic.sum() - quadratic * np.sum(V)).max() <= SAME * np.abs(quadratic).max() * np.sum(V))


def _offer(case: Case, S: np.ndarray, X: np.ndarray) -> str:
    """e'Se as text for the plant's file, with how often it falls at the states X.

    A file has the states by their names, that of a plant that is called has columns of X.
    """
    plant, scale = case.plant, np.sqrt(np.outer(np.diag(S), np.diag(S)))
    rounding, digits = (ROUNDING, 8) if plant.traced else (DIFFERENCES, 6)
    rest = np.where(np.abs(plant.equilibrium) > rounding * np.ptp(case.ends, axis=1), plant.equilibrium, 0.0)
    columns = [f"x.{name}" if plant.traced else f"X[..., {k}]" for k, name in enumerate(plant.states)]
    errors = [error(column, at_rest) for column, at_rest in zip(columns, rest, strict=True)]
    terms = []
    for i, j in zip(*np.triu_indices(len(S)), strict=True):
        if abs(S[i, j]) > rounding * scale[i, j]:
            value, factor = (S[i, j], " ** 2") if i == j else (2 * S[i, j], f" * {errors[j]}")
            terms.append(f"{'-' if value < 0 else '+'} {abs(value):.{digits}g} * {errors[i]}{factor}")
    text, falls = " ".join(terms).removeprefix("+ "), (_offered(case, S, X) < 0).mean()
    return f"V = {text} solves the Lyapunov equation, and falls at {falls:.0%} of {len(X)} states"
