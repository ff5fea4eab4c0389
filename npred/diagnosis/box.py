"""Questions about f, kappa and V: traced, smooth, finite on the sampling box, and can it be predicted from there?"""

import numpy as np

from npred.base.errors import unlisted
from npred.diagnosis.case import Case, Verdict
from npred.formulas import programs
from npred.formulas.trace import Trace
from npred.plants import inputs
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods import RK4

STABLE = 2.0  # h rho(f_X) from which on Euler, Heun and Picard diverge
FINE = 1001  # nodes on which a stiff plant is still integrated


def traced(case: Case) -> Verdict:
    """Whether the functions run on symbols, and return values of their shapes."""
    plant = case.plant
    _ = plant.program, plant.rests  # these raise if a function fails
    names = f"{', '.join(plant.states)} driven by {', '.join(plant.inputs)}"
    if not plant.traced:
        return "warn", f"{names}; its functions are called, not traced: slower, with differences as derivatives"
    return "yes", f"f, kappa and V: {names}"


def smooth(case: Case) -> Verdict:
    """Whether kappa has kinks: the update law takes its derivative."""
    trace = Trace(case.plant)
    x = trace.vector("x", case.plant.n)
    kinks = programs.kinks(trace.kappa(x, trace.input("t")), x)
    if not kinks:
        return "yes", "kappa has derivatives everywhere it is defined"
    harm = "a law of signs chatters, and its derivative is 0" if "sign" in kinks else "its derivative may jump there"
    decides = f"{case.plant.location('kappa')} uses {', '.join(kinks)}"
    return "warn", f"{decides}: {harm}; if loops chatter, smooth it, for example with M.tanh"


def declared(case: Case) -> Verdict:
    """Whether every state has a range to start experiments from, and nothing else."""
    states = case.plant.states
    if unknown := [name for name in case.box if name not in states]:
        return "no", unlisted("generate.box", unknown[0], states)
    missing = [name for name in states if name not in case.box]
    if missing and case.experiment:
        first = missing[0]
        return "no", f"generate.box: expected a range for {first!r}, found none; add {first} = [low, high]"
    if missing:
        what = f"plant {case.plant.name}: box has no range for {', '.join(missing)}"
        return "no", f'{what}; add box = {{"{missing[0]}": (low, high)}} for experiments to start in'
    return "yes", ", ".join(f"{name} in [{a:g}, {b:g}]" for name, (a, b) in case.box.items())


def finite(case: Case) -> Verdict:
    """Whether f and kappa are finite on the box, and V too, and not negative, where a delay law takes it."""
    plant, X = case.plant, case.X
    with np.errstate(all="ignore"):
        values = {"f": plant.f(X, case.u), "kappa": plant.kappa(X)}
        values |= {"V": np.reshape(plant.V(X), (-1, 1))} if case.takes_V else {}
    for name, value in values.items():
        fails = ~np.isfinite(np.broadcast_to(value, (len(X), value.shape[-1]))).all(axis=-1)
        if fails.any():
            where = f"at {case.state(X[np.argmax(fails)])}, and on {fails.mean():.0%} of the box"
            return "no", f"{plant.location(name)} is not finite {where}; shrink box, or guard it with M.where"
    if case.takes_V and (V := values["V"][:, 0]).min() < 0:
        came = f"{V.min():.3g} at {case.state(X[np.argmin(V)])}"
        cure = "add squares, because the law divides by 1 + V"
        return "no", f"{plant.location('V')} expected at least 0 on the box, got {came}; {cure}"
    return "yes", f"{'f, kappa and V' if case.takes_V else 'f and kappa'} are finite at {len(X)} states of the box"


def stiff(case: Case) -> Verdict:
    """Whether h rho(f_X) < 2 on the box, h = delay / (nodes - 1) [explicit methods' limit on the real axis]."""
    matrices = case.plant.jacobians(case.X, case.u)[0]
    fails = ~np.isfinite(matrices).all(axis=(1, 2))
    if fails.any():
        where = f"no derivative at {case.state(case.X[np.argmax(fails)])}"
        return "no", f"{case.plant.location('f')}: {where}; guard the term that has none"
    rates = np.abs(np.linalg.eigvals(matrices)).max(axis=-1)
    worst = int(np.argmax(rates))
    product, where = case.delay / (case.nodes - 1) * rates[worst], case.state(case.X[worst])
    delay = case.plant.time_text(case.delay)
    came = f"h rho(f_X) = {product:.3g} with {case.nodes} nodes and a delay of {delay}, at {where}"
    if product < STABLE:
        return "yes", came
    cure = f"take {int(case.delay * rates[worst] / STABLE) + 2} nodes or a shorter delay"
    return "no", f"plant {case.plant.name}: {came}, expected below {STABLE:g}; {cure}"


def complete(case: Case) -> Verdict:
    """Whether the open loop stays finite over the delay from the whole box, the input held at u0 or a value of kappa.

    The predictor equation is that rollout [DAPF, eq. 10]: where it escapes, no delay of that length can be predicted.
    """
    held = np.roll(case.u, 1, axis=0)
    half = len(held) // 2
    held[:half] = inputs.rows_of(case.plant, case.u0, case.limits, case.X[:half])
    nodes = max(case.nodes, FINE)
    plant = case.plant
    if plant.declares_delay:  # its open loop is asked for, whatever reaches it when
        declaration = type(plant.declaration.__name__, (plant.declaration,), {"delay": None})
        plant = Plant(plant.name, declaration, plant.parameters, plant.source)
    P = RK4(plant, nodes)(case.X, np.repeat(held[:, None], nodes, axis=1), case.delay)
    ended = ~np.all(np.isfinite(P), axis=2)  # (samples, nodes)
    fails, loop = ended[:, -1], f"the open loop (u0: {inputs.sentence(case.plant, case.u0, case.limits)}, or kappa)"
    if not fails.any():
        largest = ", ".join(f"|{s}| <= {a:.3g}" for s, a in zip(case.plant.states, np.abs(P).max((0, 1)), strict=True))
        return "yes", f"{loop} stays finite for {case.plant.time_text(case.delay)}: {largest}"
    first = int(np.argmax(fails))
    t = case.delay * int(np.argmax(ended[first])) / (nodes - 1)
    after = case.plant.time_text(t, ".3g")
    start = f"{case.state(case.X[first])} ({fails.sum()} of {fails.size} states of the box)"
    cure = "shrink box or the delay, set u0, in a pipeline or by --u0, or guard what is undefined there with M.where"
    return "no", f"{case.plant.location('f')}: {loop} overflows after {after} from {start}; {cure}"


def feasible(case: Case) -> Verdict:
    """Whether 1 - D_X f - D_t > 0 on the box under kappa and u0, D being the plant's: else commands overtake others."""
    plant, speed = case.plant, problem_of(case.plant).speed()
    assert speed is not None
    times, delays = case.delays
    worst = int(np.argmin(np.where(np.isfinite(delays), delays, -np.inf).min(axis=0)))
    if not (np.isfinite(delays[:, worst]) & (delays[:, worst] >= 0)).all():
        came = f"got {delays[:, worst].min():.3g} at {case.state(case.X[worst])}"
        return "no", f"{plant.location('delay')} expected a finite delay of at least 0 on the box, {came}; shrink box"
    X, margins = np.array(case.X.T, order="C"), np.full(len(case.X), np.inf)
    for U in (case.u, inputs.rows_of(plant, case.u0, case.limits, case.X)):
        for t in times:
            rows = np.empty((plant.m, len(case.X)))
            speed(X, np.array(U.T, order="C"), float(t), plant.p, rows)
            margins = np.minimum(margins, rows[0])
    worst = int(np.argmin(margins))
    came = f"1 - D_X f - D_t is at least {margins[worst]:.3g}, at {case.state(case.X[worst])}"
    if margins[worst] > 0:
        return "yes", f"{came}, at {len(margins)} states of the box"
    share = f"{(margins <= 0).mean():.0%} of {len(margins)} states of the box"
    return "warn", f"{came}, and not positive at {share}: loops that come there cannot go on; shrink box"
