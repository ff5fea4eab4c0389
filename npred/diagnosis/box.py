"""Questions about the sampling box: are the functions defined there, and can the plant be predicted from there?"""

from collections.abc import Callable, Iterator

import numpy as np

from npred.diagnosis import defects
from npred.diagnosis.answer import Answer, Case, asked
from npred.plants import inputs
from npred.predictors import RK4

STABLE = 2.0  # h rho(f_X) from which on Euler, Heun and Picard diverge
FINE = 1001  # nodes on which a stiff plant is still integrated
STEP = 1e-5  # of a finite difference, in widths of the box
AGREE = 1e-4  # of the largest entry: how far differences may be from derivatives


def answers(case: Case) -> Iterator[Answer]:
    """What can be asked once f, kappa and V are finite on the box."""
    first = [asked("jacobians", jacobians, case)] if case.plant.traced else []
    if all(answer.verdict != "no" for answer in first):
        first.append(asked("stiffness", stiff, case))
    yield from first
    stiff_plant = first[-1].check == "stiffness" and first[-1].verdict != "yes"
    if not stiff_plant:  # of which RK4 says nothing
        yield asked("completeness", complete, case)


def declared(case: Case) -> Answer:
    """Whether every state has a range to start experiments from."""
    missing = [name for name in case.plant.states if name not in case.box]
    if missing:
        what = f"plant {case.plant.name}: box has no range for {', '.join(missing)}"
        return Answer("box", "no", f'{what}; add box = {{"{missing[0]}": (low, high)}} for experiments to start in')
    return Answer("box", "yes", ", ".join(f"{name} in [{a:g}, {b:g}]" for name, (a, b) in case.box.items()))


def finite(case: Case) -> Answer:
    """Whether f, kappa and V are finite on the box, and V is not negative."""
    fault = defects.infinite(case.plant, case.X, case.u)
    if fault:
        return Answer("finite", "no", fault)
    return Answer("finite", "yes", f"f, kappa and V are, at {len(case.X)} states of the box")


def jacobians(case: Case) -> Answer:
    """Whether the derived f_X and kappa' equal central differences on the box."""
    plant = case.plant
    derived = {"f": plant.jacobians(case.X, case.u)[0], "kappa": plant.kappa_jacobian(case.X)}
    functions = {"f": lambda X: plant.f(X, case.u), "kappa": plant.kappa}
    for name, J in derived.items():
        excess = _excess(functions[name], J, case)
        worst = int(np.argmax(np.where(np.isnan(excess), np.inf, excess)))
        if not excess[worst] <= 0:
            found = f"differ from finite differences at {case.state(case.X[worst])}"
            return Answer("jacobians", "no", f"{case.place(name)}: derivatives {found}; look for a jump there")
    return Answer("jacobians", "yes", f"f_X and kappa' equal finite differences at {len(case.X)} states")


def _excess(function: Callable[[np.ndarray], np.ndarray], J: np.ndarray, case: Case) -> np.ndarray:
    """How far the Jacobians J (N, k, n) are outside the tolerance, (N,); across a kink both slopes count."""
    worst = np.full(len(J), -np.inf)
    for k, name in enumerate(case.plant.states):
        low, high = case.box[name]
        h = STEP * ((high - low) or 1.0)
        step = h * np.eye(case.plant.n)[k]
        with np.errstate(all="ignore"):
            ahead, here, behind = (function(case.X + s * step) for s in (1, 0, -1))
        gap, kink = np.abs(J[:, :, k] - (ahead - behind) / (2 * h)), np.abs(ahead - 2 * here + behind) / h
        allowed = AGREE * np.maximum(np.abs(J).max(axis=(1, 2)), 1.0)[:, None] + kink
        worst = np.maximum(worst, (gap - allowed).max(axis=1))
    return worst


def stiff(case: Case) -> Answer:
    """Whether h rho(f_X) < 2 on the box, h = delay / (nodes - 1) [explicit methods' limit on the real axis]."""
    rates = np.abs(np.linalg.eigvals(case.plant.jacobians(case.X, case.u)[0])).max(axis=-1)
    worst = int(np.argmax(rates))
    product, where = case.h * rates[worst], case.state(case.X[worst])
    found = f"h rho(f_X) = {product:.3g} with {case.nodes} nodes and a delay of {case.delay:g} s, at {where}"
    if product < STABLE:
        return Answer("stiffness", "yes", found)
    cure = f"take {int(case.delay * rates[worst] / STABLE) + 2} nodes or a shorter delay"
    return Answer("stiffness", "no", f"plant {case.plant.name}: {found}, expected below {STABLE:g}; {cure}")


def complete(case: Case) -> Answer:
    """Whether the open loop stays finite over the delay from the whole box, the input held at u0 or a value of kappa.

    The predictor equation is that rollout [DAPF, eq. 10]: where it escapes, no delay of that length can be predicted.
    """
    held = np.roll(case.u, 1, axis=0)
    half = len(held) // 2
    held[:half] = inputs.before(case.plant, case.u0, case.limits, case.X[:half])
    nodes = max(case.nodes, FINE)
    P = RK4(case.plant, nodes)(case.X, np.repeat(held[:, None], nodes, axis=1), case.delay)
    ended = ~np.all(np.isfinite(P), axis=2)  # (samples, nodes)
    lost, loop = ended[:, -1], f"the open loop (u0: {inputs.told(case.plant, case.u0, case.limits)}, or kappa)"
    if not lost.any():
        largest = ", ".join(f"|{s}| <= {a:.3g}" for s, a in zip(case.plant.states, np.abs(P).max((0, 1)), strict=True))
        return Answer("completeness", "yes", f"{loop} stays finite for {case.delay:g} s: {largest}")
    first = int(np.argmax(lost))
    t = case.delay * int(np.argmax(ended[first])) / (nodes - 1)
    found = f"leaves the finite numbers after {t:.3g} s from {case.state(case.X[first])}"
    return Answer(
        "completeness", "no", f"{case.place('f')}: {loop} {found} ({lost.mean():.0%} of the box); "
        "shrink box or the delay, or guard what is undefined there with M.where",
    )  # fmt: skip
