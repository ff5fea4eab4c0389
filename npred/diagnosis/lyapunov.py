"""The check that V falls along the loop of kappa without delay; if not, x'Sx of the Lyapunov equation is offered."""

import numpy as np

from npred.diagnosis.case import Case, Verdict
from npred.estimation.adaptation import undeclared
from npred.formulas import programs
from npred.formulas.tape import names
from npred.formulas.trace import Trace, python
from npred.laws.law import error
from npred.laws.regulator import lyapunov

NEAR = 0.01  # of the box, around rest: loops come there from all sides, whichever side the box is on
DECLARE = 'npred plants check offers one; or set adaptation = "delay-observer", "l1" or "frozen", which take none'
ROUNDING, DIFFERENCES = 1e-9, 1e-6  # relative: what of S and of a rest is rounding, and where f_X is a difference
SAME = 1e-3  # of its largest value: this close to x'Sx a V is taken for it


def applies(case: Case) -> bool:
    """True if V is missing, is not needed, or can be looked at: kappa stabilises, and the box is sound."""
    if not case.plant.rests:
        return case.takes_V and not case.plant.declares_V
    unneeded = not case.plant.declares_V and not case.takes_V
    stable = case.sound and case.leads == "yes"
    return case.verdict("equilibrium") != "no" and (unneeded or stable)


def falls(case: Case) -> Verdict:
    """Whether V' = V_X f(X, kappa(X)) < 0 from the box to rest."""
    if not case.takes_V:
        declared = "it" if case.plant.declares_V else "one, and none is declared"
        return "yes", f"no law runs that takes {declared}"
    lacks = "warn" if case.experiment is None else "no"  # where nothing says which law will run
    missing = f"{undeclared(case.plant)}; delay-observer, l1 and frozen take none; declare"
    if not case.plant.rests:
        return lacks, f"{missing} the squared distance to what it follows"
    X = _towards_rest(case)
    S = lyapunov(case.plant.linearised()[0])
    if not case.plant.declares_V:
        return lacks, f"{missing} one: {_offer(case, S, X)}"
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
        h = 1e-6 / (1.0 + np.linalg.norm(velocity, axis=-1))
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
        return "yes", f"V solves the Lyapunov equation, and falls at {share}: the box is wider than where it does"
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
