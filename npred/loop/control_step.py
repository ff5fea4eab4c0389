"""One control step of one controller, on its memory: the text that Python runs and that `npred export controller`
translates.

It is written in the kernels' dialect (npred.symbolic.c99), whose loops and calls mean the same in both languages.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from npred.loop import engine
from npred.loop.actuator import actuate, copy, transport
from npred.symbolic.compile_cache import jit


class Parts(NamedTuple):
    """What a controller is made of: kernels, None where it does without one, and their settings."""

    observe: Any  # npred.delays.family.OBSERVE, of laws that find D_hat from the commands
    believe: Any  # HORIZON, of plants that declare their delay
    predict: Any  # PREDICT
    guard: Any  # GUARD
    control: Any  # CONTROL
    update: Any  # UPDATE
    model: Any  # ADVANCE, by which samples are predicted that a gate refuses; None without a gate
    recalls: bool  # whether u is the controller's own history, else it is measured
    dt: float
    p: np.ndarray
    ratios: np.ndarray  # (m,)
    law: np.ndarray  # what `observe` is set to
    guard_settings: np.ndarray
    input_bounds: np.ndarray  # (m, 2)
    b: float
    gamma_dt: float
    bounds: np.ndarray  # (2,), of D_hat
    reach: np.ndarray  # (n,), how far a sample may be from X_hat near 0
    gate: float  # and how far beyond, times |X_hat|


class Memory(NamedTuple):
    """The memory of its steps, with one lane."""

    X: np.ndarray  # (n, 1)
    X_hat: np.ndarray  # (n, 1), X by the model, from the step before and the commands; NaN before the first
    missed: np.ndarray  # (1,), the last samples in a row that the gate refused
    u: np.ndarray  # (nx, m, 1), means over the nodes' cells
    u_nodes: np.ndarray  # (nx, m, 1), values at the nodes
    U: np.ndarray  # (m, 1)
    D_hat: np.ndarray  # (1,)
    phi: np.ndarray  # (1,)
    phi_before: np.ndarray  # (1,)
    N: np.ndarray  # (1,)
    D_seen: np.ndarray  # (m, 1), the delays by which it reads its commands
    held: np.ndarray  # (R, m, 1)
    total: np.ndarray  # (R, m, 1)
    observer: np.ndarray  # (., 1)
    error: np.ndarray  # (1,)
    fallback: np.ndarray  # (1,)
    leaving: np.ndarray  # (3, m, 1), what `actuate` writes for a plant, which is not simulated here


LANE, ROWS = (types.Array(types.float64, d, "C") for d in (1, 2))


@jit(types.void(ROWS, ROWS, LANE, LANE, types.float64, types.float64, LANE), nogil=True)
def screen(
    X: np.ndarray, X_hat: np.ndarray, D_hat: np.ndarray, reach: np.ndarray, gate: float, dt: float, missed: np.ndarray
) -> None:  # fmt: skip
    """Make X NaN, no sample, where it is further from X_hat than the gate; after D_hat seconds of such X has jumped."""
    far = False
    for c in range(X.shape[0]):
        if abs(X[c, 0] - X_hat[c, 0]) > max(reach[c], gate * abs(X_hat[c, 0])):
            far = True
    if far and missed[0] * dt < D_hat[0]:
        missed[0] += 1.0
        for c in range(X.shape[0]):
            X[c, 0] = np.nan
    else:
        missed[0] = 0.0
        copy(X, X_hat)


def control_step(s: Parts, z: Memory, k: int, t: float, P: np.ndarray) -> None:
    """U, P and the next D_hat from X, and from u or the commands before step k [DAPF, eqs. 9-14]."""
    if s.model is not None:
        screen(z.X, z.X_hat, z.D_hat, s.reach, s.gate, s.dt, z.missed)
    if s.observe is not None:  # which learns from samples only, and else goes on by the commands
        s.observe(k, s.dt, z.X, z.held, t, s.p, s.law, z.observer, z.D_hat)
    if s.model is not None:
        copy(z.X_hat, z.X)
    if s.believe is not None:
        s.believe(z.X, t, s.p, s.ratios, z.D_hat, z.D_seen)
    if s.recalls:
        if s.believe is None:
            engine.own_history(z.X, t, s.p, s.ratios, z.D_hat, z.D_seen)
        transport(k, s.dt, z.D_seen, z.held, z.total, z.u, z.u_nodes)
    s.predict(z.X, z.u, z.D_hat, t, s.p, P)
    if s.guard is not None:
        s.guard(z.X, z.u, z.D_hat, t, s.p, s.guard_settings, P, z.error, z.fallback)
    s.control(P, z.u, z.D_hat, t, s.p, z.U)
    engine.clip(z.U, s.input_bounds)
    s.update(P, z.X, z.u_nodes, z.D_hat, t, s.p, s.b, z.phi, z.N)
    engine.adapt(z.D_hat, z.phi, z.phi_before, s.gamma_dt, s.bounds)


def remember(s: Parts, z: Memory, k: int, t: float) -> int:
    """Hold U as the command of step k; the next step's number. It and the sums stay small, for large ones round."""
    actuate(k, s.dt, z.D_seen, z.U, z.held, z.total, z.leaving[0], z.leaving[1], z.leaving[2])
    if s.model is not None:
        s.model(z.X_hat, z.leaving[0], z.leaving[1], z.leaving[2], s.dt, t, s.p)
    rows = len(z.held)
    if k + 1 < 2 * rows:
        return k + 1
    for c in range(z.U.shape[0]):
        z.total[:, c, 0] -= z.total[0, c, 0]
    return rows


def hold(s: Parts, z: Memory, k: int, t: float) -> None:
    """The U of a step that was refused, for `remember`: the last one, which the actuator holds."""
    rows = len(z.held)
    if s.believe is not None and s.model is not None:
        s.believe(z.X_hat, t, s.p, s.ratios, z.D_hat, z.D_seen)
    for c in range(z.U.shape[0]):
        z.U[c, 0] = z.held[(k - 1) % rows, c, 0]
        if s.believe is None:
            z.D_seen[c, 0] = s.ratios[c] * z.D_hat[0]
        if not 0.0 <= z.D_seen[c, 0] <= (rows - 3) * s.dt:  # that of a state that is not known
            z.D_seen[c, 0] = 0.0
