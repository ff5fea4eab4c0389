"""Questions about the equilibrium: is there one, does the law without delay lead there, does V fall on the way?"""

from collections.abc import Iterator

import numpy as np

from npred.diagnosis import convergence, defects
from npred.diagnosis.answer import Answer, Case, asked
from npred.diagnosis.pipeline_fit import SLIP, slip
from npred.errors import ConfigError
from npred.plants.base import Plant
from npred.symbolic import programs, source_lines
from npred.symbolic.trace import Trace, python

NEAR = 0.01  # of the box, around rest: loops come there from all sides, whichever side the box is on
SAME = 1e-3  # of its largest value: this close to x'Sx a V is taken for it
HORIZON = 100.0  # s, over which a reference is looked at


def answers(case: Case, sound: bool) -> Iterator[Answer]:
    """Equilibrium, stability and, where the box is `sound`, V along the loop; of a plant that tracks, the reference.

    Where there is something to come to, the box is sound and the law stabilises: whether loops come there.
    """
    questions = _at_rest(case, sound) if case.plant.rests else _following(case)
    verdicts = {}
    for answer in questions:
        verdicts[answer.check] = answer.verdict
        yield answer
    if sound and np.isfinite(case.limits).any():
        yield asked("input bounds", convergence.limited, case)
    if sound and verdicts.get("stability", verdicts.get("reference")) == "yes":
        yield asked("convergence", convergence.converges, case)


def _at_rest(case: Case, sound: bool) -> Iterator[Answer]:
    yield (found := asked("equilibrium", equilibrium, case))
    if found.verdict == "no":
        return
    yield (stable := asked("stability", stability, case))
    if not case.plant.declares_V and not case.takes_V:
        yield Answer("V", "yes", "none is declared and none is needed: no update law runs")
    elif sound and stable.verdict == "yes":
        yield asked("V", decrease, case)


def _following(case: Case) -> Iterator[Answer]:
    yield asked("reference", reference, case)
    if case.takes_V and (missing := defects.undeclared(case.plant)):
        yield Answer("V", "no", f"{missing}; declare the squared distance to what it follows")


def smooth(case: Case) -> Answer:
    """Whether kappa has kinks: the update law takes its derivative."""
    trace = Trace(case.plant)
    x = trace.vector("x", case.plant.n)
    kinks = programs.kinks(trace.kappa(x, trace.input("t")), x)
    if not kinks:
        return Answer("smooth law", "yes", "kappa has derivatives everywhere it is defined")
    harm = "a law of signs chatters, and its derivative is 0" if "sign" in kinks else "its derivative may jump there"
    text = f"{case.place('kappa')} decides by {', '.join(kinks)}: {harm}; smooth it, with M.tanh say, if loops chatter"
    return Answer("smooth law", "warn", text)


def equilibrium(case: Case) -> Answer:
    """Whether f(X*, kappa(X*)) = 0 has a solution near `guess`, with an input that the plant accepts."""
    plant = case.plant
    try:
        X, u = plant.equilibrium, plant.u_equilibrium
    except ConfigError as error:
        return Answer("equilibrium", "no", str(error))
    values = source_lines.values(plant.inputs, u)
    if (u < case.limits[:, 0]).any() or (u > case.limits[:, 1]).any():
        text = (
            f"plant {plant.name}: rests with {values}, outside input_bounds {case.limits.tolist()}; move the set point"
        )
        return Answer("equilibrium", "no", text)
    beyond = [f"{name} in [{a:g}, {b:g}]" for name, x, (a, b) in _ranges(case, X) if not a <= x <= b]
    if beyond:
        text = f"{case.state(X)}, with {values}: outside the box, {', '.join(beyond)}, so loops start on one side of it"
        return Answer("equilibrium", "warn", text)
    return Answer("equilibrium", "yes", f"{case.state(X)}, with {values}")


def _ranges(case: Case, X: np.ndarray) -> Iterator[tuple[str, float, tuple[float, float]]]:
    """Name, value and range of each state that has one."""
    return ((name, x, case.box[name]) for name, x in zip(case.plant.states, X, strict=True) if name in case.box)


def reference(case: Case) -> Answer:
    """Whether the declared reference is a trajectory of f with kappa, over HORIZON seconds."""
    if not case.plant.tracks:
        text = "f or kappa depends on time and no reference(t, p, M) says what it follows: its loops have no radius"
        return Answer("reference", "warn", f"{text}; declare one to evaluate the plant")
    excess, t = slip(case.plant, HORIZON)
    if excess <= SLIP:
        return Answer("reference", "yes", f"a trajectory of f with kappa for {HORIZON:g} s, to {excess:.1g}")
    text = f"{case.place('reference')} is no trajectory of f with kappa: they differ by {excess:.2g} at t = {t:.3g} s"
    return Answer("reference", "no", f"{text}; let reference' = f(reference, kappa(reference, t), t)")


def stability(case: Case) -> Answer:
    """Whether the loop of kappa without delay is stable: the eigenvalues of f_X + f_U kappa' at the equilibrium."""
    fault = defects.unstable(case.plant)
    if fault:
        return Answer("stability", "no", fault)
    rates = defects.eigenvalues(np.linalg.eigvals(defects.closed_loop(case.plant)))
    return Answer("stability", "yes", f"eigenvalues of the loop without delay: {rates}")


def decrease(case: Case) -> Answer:
    """Whether V' = V_X f(X, kappa(X)) < 0 from the box to rest; where not, x'Sx of the Lyapunov equation is offered."""
    X = _towards_rest(case)
    S = lyapunov(defects.closed_loop(case.plant))
    if missing := defects.undeclared(case.plant):
        return Answer("V", "no", f"{missing}; declare one: {_offer(case, S, X)}")
    rates = _along(case, X)
    rising = ~(rates < 0)
    if not rising.any():
        return Answer(
            "V", "yes", f"V' < 0 along the loop of kappa, at {len(X)} states of the box, towards rest and around it"
        )
    worst = int(np.argmax(np.where(np.isnan(rates), np.inf, rates)))
    found = f"V' = {rates[worst]:.3g} at {case.state(X[worst])}, and {rising.mean():.0%} of {len(X)} states are like it"
    if rising.mean() > (_offered(case, S, X) >= 0).mean():
        return Answer("V", "warn", f"{case.place('V')} does not fall along the loop: {found}; {_offer(case, S, X)}")
    if _proportional(case, S, X):
        text = (
            f"solves the Lyapunov equation, and falls at {1 - rising.mean():.0%} of {len(X)} states: the box is wider"
        )
        return Answer("V", "yes", f"V {text} than where it does")
    return Answer(
        "V", "warn", f"{case.place('V')} does not fall along the loop: {found}; no x'Sx does better: shrink box"
    )


def _towards_rest(case: Case) -> np.ndarray:
    """The states of the box, as many between them and the equilibrium, and as many close around it, (3 samples, n)."""
    rest, X = case.plant.equilibrium, case.X
    share = np.linspace(0.02, 1.0, len(X))[:, None]
    around = NEAR * np.ptp(X, axis=0) * np.random.default_rng(0).uniform(-1, 1, X.shape)
    return np.concatenate([X, rest + share * (X - rest), rest + around])


def _along(case: Case, X: np.ndarray) -> np.ndarray:
    """V' at the states X (B, n), the input not clipped, (B,)."""
    if not case.plant.traced:
        return _rise(case.plant, X)
    trace, plant = Trace(case.plant), case.plant
    x, t = trace.vector("x", plant.n), 0.0
    V = trace.V(x, t)
    slope = programs.derivative([V], x, trace.f(x, trace.kappa(x, t), t))
    names = [*(f"x{k}" for k in range(plant.n)), *(f"p{k}" for k in range(len(plant.p)))]
    rate = python(slope, names, np)
    with np.errstate(all="ignore"):
        return np.array([rate(*row, *plant.p)[0] for row in X], dtype=float)


def _rise(plant: Plant, X: np.ndarray) -> np.ndarray:
    """V' by central differences along the loop's velocity."""
    velocity = plant.f(X, plant.kappa(X))
    h = 1e-6 / (1.0 + np.linalg.norm(velocity, axis=-1))
    return (plant.V(X + h[:, None] * velocity) - plant.V(X - h[:, None] * velocity)) / (2 * h)


def lyapunov(A: np.ndarray) -> np.ndarray:
    """The S of A'S + SA = -I, (n, n), symmetric; positive definite where A is stable."""
    eye = np.eye(len(A))
    return np.linalg.solve(np.kron(A.T, eye) + np.kron(eye, A.T), -eye.ravel()).reshape(A.shape)


def _offered(case: Case, S: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Half the derivative of e'Se along the loop of kappa, e = X - X*, at the states X (B, n), (B,)."""
    return np.einsum("bi,ij,bj->b", X - case.plant.equilibrium, S, case.plant.f(X, case.plant.kappa(X)))


def _proportional(case: Case, S: np.ndarray, X: np.ndarray) -> bool:
    """Whether the declared V is e'Se times a number."""
    e = X - case.plant.equilibrium
    V, own = case.plant.V(X), np.einsum("bi,ij,bj->b", e, S, e)
    return bool(np.abs(V * own.sum() - own * np.sum(V)).max() <= SAME * np.abs(own).max() * np.sum(V))


def _offer(case: Case, S: np.ndarray, X: np.ndarray) -> str:
    """e'Se as text for the plant's file, with how often it falls at the states X."""
    scale = np.sqrt(np.outer(np.diag(S), np.diag(S)))
    pairs = [(i, j) for i in range(len(S)) for j in range(i, len(S)) if abs(S[i, j]) > 1e-9 * scale[i, j]]
    falls = f"falls at {(_offered(case, S, X) < 0).mean():.0%} of {len(X)} states"
    return f"V = {' + '.join(_term(case, S, i, j) for i, j in pairs)} solves the Lyapunov equation, and {falls}"


def _term(case: Case, S: np.ndarray, i: int, j: int) -> str:
    a, b = (_error(case.plant.states[k], case.plant.equilibrium[k]) for k in (i, j))
    return f"{S[i, j]:.8g} * {a} ** 2" if i == j else f"{2 * S[i, j]:.8g} * {a} * {b}"


def _error(state: str, rest: float) -> str:
    return f"(x.{state} - {rest:.12g})" if rest else f"x.{state}"
