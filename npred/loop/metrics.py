"""Errors of a predictor in the norms of the theory, and radius, settling and decay of the closed loop."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from npred.base import grid
from npred.loop.closed_loop import Trajectories
from npred.plants.base import Plant
from npred.plants.speed import settled

SETTLED = 0.01  # times size(X*): inside this distance a loop counts as settled, and as converged when it ends there
ORIGIN = 1e-9  # an equilibrium closer to the origin than this is the origin, found by a solver
FAR = 0.2  # times size(X*): a loop that ends further away counts as far
TAIL = 0.1  # share of the horizon: the radius is the supremum over this last share
NEWTON, STEP = 8, 1e-6  # steps of Newton's method, and the half width of its differences, as a share of the delay
CELLS = 4000  # parts of the horizon, along which the gain of a plant that tracks is integrated


def size(X_star: ArrayLike) -> float:
    """The unit of a distance from X*: the largest |X*|, or one unit of state where X* is the origin."""
    X_star = np.asarray(X_star)
    norm = float(np.linalg.norm(X_star) if X_star.ndim == 1 else np.linalg.norm(X_star, axis=-1).max())
    return norm if norm > ORIGIN else 1.0


def errors(plant: Plant, P_hat: ArrayLike, P: ArrayLike, t: Any = 0.0, D_hat: Any = 0.0) -> dict[str, Any]:
    """Errors of P_hat against P, both (N, nx, n), over samples and nodes, in the plant's units; t, D_hat (N,).

    mse: mean square, as [DAPF]'s notebook reports it. eps_sup: the largest |P_hat - P| of these rows, a lower bound of
    the epsilon of [DAPF, Theorem 2]. eps_kappa: the largest |kappa(P_hat(1)) - kappa(P(1))|, what the control sees,
    kappa_j at r_j. rel_l2: mean of ||P_hat - P|| / ||P||.
    """
    P_hat, P = np.asarray(P_hat), np.asarray(P)
    gap = P_hat - P
    control = law(plant, P_hat, t, D_hat) - law(plant, P, t, D_hat)
    relative = np.linalg.norm(gap, axis=(1, 2)) / np.linalg.norm(P, axis=(1, 2))
    return {
        "mse": float(np.mean(gap**2)),
        "eps_sup": float(np.linalg.norm(gap, axis=-1).max()),
        "eps_kappa": float(np.linalg.norm(control, axis=-1).max()),
        "rel_l2": float(relative.mean()),
        "mse_by_state": dict(zip(plant.states, np.mean(gap**2, axis=(0, 1)).tolist(), strict=True)),
        "sup_by_state": dict(zip(plant.states, np.abs(gap).max(axis=(0, 1)).tolist(), strict=True)),
    }


def law(plant: Plant, P: np.ndarray, t: Any, D_hat: Any) -> np.ndarray:
    """U_j = kappa_j(P(r_j), t + r_j D_hat), (N, m), of P (N, nx, n); r_j = 1 for one delay. Cubic between nodes.

    Where the plant declares its delay, U = kappa(P(1), s) with s of `arrival`.
    """
    if plant.declares_delay:
        return plant.kappa(P[:, -1], arrival(plant, P[:, -1], t, D_hat))
    U = [plant.kappa(grid.read(P, np.array([r]))[:, 0], t + r * D_hat)[:, j] for j, r in enumerate(plant.ratios)]
    return np.stack(U, axis=-1)


def arrival(plant: Plant, X: np.ndarray, t: Any, D: Any) -> np.ndarray:
    """The time s = t + D(X, s) at which the commands of t (N,) act, (N,), at states X (N, n), by Newton's method.

    It starts at t + D (N,), and the derivative of D by time is a difference: its error costs steps, not digits.
    """
    s = np.broadcast_to(t + D, len(X))
    h = STEP * np.maximum(np.max(D, initial=0.0), np.finfo(float).tiny)
    for _ in range(NEWTON):
        slope = (plant.delay(X, s + h) - plant.delay(X, s - h)) / (2 * h)
        s = s - (s - t - plant.delay(X, s)) / (1 - slope)
    return s


def target(plant: Plant, loops: Trajectories) -> np.ndarray:
    """X* of the loops of a plant, (n,), or (nt, n) where it moves: by a reference, or by set-points."""
    return plant.target(loops.t) if loops.target is None else loops.target


def radius(loops: Trajectories, X_star: ArrayLike) -> np.ndarray:
    """sup |X - X*| over the last tenth of the horizon, (...); infinite for a loop that overflows.

    Here and below X* is (n,), or (nt, n) for a plant that tracks, or whose set-point moves: `target(plant, loops)`.
    """
    rows = loops.t >= (1 - TAIL) * loops.t[-1]
    X_star = np.asarray(X_star)
    goal = X_star if X_star.ndim == 1 else X_star[rows]
    distance = _length(loops.X[..., rows, :] - goal).max(axis=-1)
    return np.where(np.isfinite(distance), distance, np.inf)


def in_loop(loops: Trajectories, D: float) -> np.ndarray:
    """sup |P(1, t) - X(t + D)| over 2 D <= t <= t_end - D, (...), of loops with D_hat = D, every step of them kept.

    D is a whole number of steps. Before 2 D the history of U has the jump from its past to the first control in it, and
    every scheme is of first order. Where inputs have several delays, D is the longest of them: P goes on past the
    others with the values of kappa. Infinite for a loop that overflows.
    """
    k = round(D / (loops.t[1] - loops.t[0]))
    gap = _length(loops.P[..., 2 * k : -k, :] - loops.X[..., 3 * k :, :]).max(axis=-1)
    return np.where(np.isfinite(gap), gap, np.inf)


def in_loop_declared(loops: Trajectories) -> np.ndarray:
    """sup |P(1, t) - X(s)|, (...), of a plant that declares its delay: s is when U(t) acts, s - D(X(s), s) = t.

    D_hat is D(X(t), t); every step is kept, and X is linear between steps. It is taken from the time on at which the
    first command acts for the second time, as `in_loop` from 2 D on, while s is in the record. Infinite for a loop that
    left the finite numbers, or whose record is too short.
    """
    shape, t = loops.D_hat.shape[:-1], loops.t
    series = (a.reshape(-1, len(t), *a.shape[len(shape) + 1 :]) for a in (loops.X, loops.P, loops.D_hat))
    errors = [_gap_where_it_acts(t, X, P, D) for X, P, D in zip(*series, strict=True)]
    return np.array(errors).reshape(shape)


def _gap_where_it_acts(t: np.ndarray, X: np.ndarray, P: np.ndarray, D: np.ndarray) -> float:
    """`in_loop_declared` of one loop: X, P (nt, n), D (nt,)."""
    if not (np.isfinite(X).all() and np.isfinite(P).all()):
        return np.inf
    acts = np.interp(t, t - D, t, right=np.nan)  # phi(t) = t - D rises
    start = np.interp(acts[0], t, acts)
    rows = (t >= start) & np.isfinite(acts)
    reached = np.stack([np.interp(acts[rows], t, x) for x in X.T], axis=-1)
    return float(_length(P[rows] - reached).max(initial=0.0)) if rows.any() else np.inf


def settle_time(loops: Trajectories, X_star: ArrayLike) -> np.ndarray:
    """The time after which |X - X*| stays within 1 % of size(X*), (...); infinite where it does not."""
    return _last_outside(loops.t, _length(loops.X - X_star), SETTLED * size(X_star))


def decay_rate(loops: Trajectories, X_star: ArrayLike) -> np.ndarray:
    """The mean rate at which |X - X*| falls from 1e-2 to 1e-4 of size(X*), (...); NaN where it does not."""
    distance = _length(loops.X - X_star) / size(X_star)
    ends = [_last_outside(loops.t, distance, level) for level in (1e-2, 1e-4)]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(np.isfinite(ends[1]), np.log(100) / (ends[1] - ends[0]), np.nan)


@np.errstate(over="ignore")
def _length(gap: np.ndarray) -> np.ndarray:
    """|gap| over the last axis; infinite, without a warning, in a loop that is about to overflow."""
    return np.linalg.norm(gap, axis=-1)


def _last_outside(t: np.ndarray, distance: np.ndarray, level: float) -> np.ndarray:
    """The time after which the distance stays within the level; infinite where it does not, 0 where it always is."""
    outside = ~(distance <= level)
    last = len(t) - 1 - np.argmax(outside[..., ::-1], axis=-1)
    return np.where(outside.any(axis=-1), np.append(t[1:], np.inf)[last], 0.0)


def relative(plant: Plant, X: ArrayLike, u: ArrayLike, P_hat: ArrayLike, P: ArrayLike) -> dict[str, Any]:
    """sup_x |P_hat - P| / (|X - X*| + sup_x |u - u*|), its supremum and median over the samples.

    Finite and small, it makes the loop converge to the point: near rest the error vanishes with the distance. A plant
    that tracks has no such point, and no such number.
    """
    if not plant.rests:
        return {}
    distance = np.linalg.norm(np.subtract(X, plant.equilibrium), axis=-1)
    distance = distance + np.linalg.norm(np.subtract(u, plant.u_equilibrium), axis=-1).max(axis=-1)
    ratio = np.linalg.norm(np.subtract(P_hat, P), axis=-1).max(axis=-1) / distance
    return {"eps_relative": {"sup": float(ratio.max()), "median": float(np.median(ratio))}}


def converged(radii: ArrayLike, X_star: ArrayLike) -> np.ndarray:
    """True if a loop of that radius ends settled."""
    return np.asarray(radii) <= SETTLED * size(X_star)


def far(loops: Trajectories, X_star: ArrayLike, share: float = FAR) -> np.ndarray:
    """True, (...), for a loop that overflows, or ends further from X* than that share of size(X*)."""
    return ~(radius(loops, X_star) <= share * size(X_star))


@cache
def gain(plant: Plant, t_end: float | None = None) -> float:
    """|dX*| per unit of a constant control error: |(f_X + f_U kappa')^{-1} f_U|, largest singular value.

    A constant error e of kappa(P_hat(1)) moves the equilibrium to f(X, kappa(X) + e) = 0, whatever D, D_hat, gamma, b:
    the radius that such an error leaves, to first order in e, if the loop settles. One that oscillates may leave a
    larger one, and with a law for D_hat a constant one moves D_hat too (docs/guard.md).
    Where the plant tracks, a constant e moves the trajectory by G(t) e, with G' = (f_X + f_U kappa') G + f_U along the
    reference and G(0) = 0: the largest |G| over the last tenth of t_end, by default `settled`. Where nothing changes in
    time, both are the same.
    """
    if plant.rests:
        closed, f_U = plant.linearised()
        return float(np.linalg.norm(np.linalg.solve(closed, f_U), 2))
    responses = _responses(plant, t_end or settled(plant))
    return max(float(np.linalg.norm(G, 2)) for G in responses[round((1 - TAIL) * CELLS) :])


def _responses(plant: Plant, t_end: float) -> list[np.ndarray]:
    """G (n, m) of `gain` on CELLS + 1 times, by the trapezoidal rule, which no rate makes unstable."""
    A, B = plant.linearised(np.linspace(0.0, t_end, CELLS + 1))
    h, eye, responses = t_end / CELLS, np.eye(plant.n), [np.zeros((plant.n, plant.m))]
    for k in range(CELLS):
        right = responses[-1] + h / 2 * (A[k] @ responses[-1] + B[k] + B[k + 1])
        responses.append(np.linalg.solve(eye - h / 2 * A[k + 1], right))
    return responses
