"""Questions about the loop of kappa without delay: what the input bounds leave of it, and whether it converges."""

from typing import Any

import numpy as np

from npred.diagnosis.case import Case, Verdict
from npred.loop.suited_gain import closed_loop
from npred.plants import inputs
from npred.plants.base import Plant
from npred.predictors import RK4
from npred.symbolic import source_lines

LOOPS = 64  # starts, of the states of the box
STEP = 0.5  # of a step of RK4, times the fastest rate on the box
MOST = 20_000  # steps
SPAN = 30.0  # time constants of the slowest rate at the equilibrium
HORIZON = 100.0  # s, of a plant that follows a reference
HOME = 0.01  # of the box: this close to its target a loop has converged
FALLING = 0.9  # a loop that still converges is this much closer in the last quarter than in the second


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
    closed, (h, seconds, horizon) = _closed(case), times(case)
    X0, nodes = case.X[:LOOPS], max(int(seconds / h), 4) + 1
    X = RK4(closed, nodes)(X0, np.zeros((nodes, closed.m)), seconds)
    _, middle, _, end = (part.max(axis=1) for part in np.array_split(distances(case, X, seconds), 4, axis=1))
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


def times(case: Case) -> tuple[float, float, float]:
    """The step, the seconds to look at, and the seconds that are needed: SPAN time constants, or HORIZON."""
    plant, X = case.plant, case.X
    f_X, f_U = plant.jacobians(X, case.u)
    rates = np.abs(np.linalg.eigvals(np.concatenate([f_X, f_X + f_U @ plant.kappa_jacobian(X)]))).max()
    horizon = HORIZON
    if plant.rests:
        eigenvalues = np.linalg.eigvals(closed_loop(plant))
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
    kind = _on_rows if not case.plant.traced else _on_components
    kept = {name: getattr(case.plant, name) for name in ("states", "inputs", "parameters", "period")}
    functions = {name: staticmethod(function) for name, function in kind(case.plant, case.limits).items()}
    declaration = type("Closed", (), kept | functions | {"guess": case.plant.guess, "traced": case.plant.traced})
    return type(case.plant)(f"{case.plant.name}, controlled", declaration, {}, case.plant.source)


def _on_components(plant: Plant, limits: np.ndarray) -> dict[str, Any]:
    def kappa(x: Any, t: Any, p: Any, M: Any) -> list[Any]:
        U = plant.call("kappa", [*x], None, t, [*p], M)
        return [_clipped(u, low, high, M) for u, (low, high) in zip(U, limits, strict=True)]

    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> list[Any]:
        return plant.call("f", [*x], kappa(x, t, p, M), t, [*p], M)

    return {"f": f, "kappa": kappa}


def _clipped(u: Any, low: float, high: float, M: Any) -> Any:
    u = M.maximum(u, low) if low > -np.inf else u
    return M.minimum(u, high) if high < np.inf else u


def _on_rows(plant: Plant, limits: np.ndarray) -> dict[str, Any]:
    def kappa(X: np.ndarray, t: Any, p: Any) -> np.ndarray:
        return np.clip(plant.kappa(X, t), *limits.T)

    return {"f": lambda X, u, t, p: plant.f(X, kappa(X, t, p), t), "kappa": kappa}
