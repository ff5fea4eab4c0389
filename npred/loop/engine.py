"""The time loop on flat memory, lanes innermost: one compiled engine for every plant, predictor and number of loops.

Its parts reach it as function pointers, so it is compiled once per machine, not per plant, and an edit of a part
never leaves a stale copy of it in Numba's cache. With a predictor in Python the same text runs uncompiled.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.core.sigutils import normalize_signature

from npred.delays import family, family_of
from npred.delays.family import Kernel
from npred.loop import actuator
from npred.plants.base import Plant
from npred.predictors.onestep import OneStep
from npred.symbolic.compile_cache import jit


class Settings(NamedTuple):
    """The constants of a run; gamma_dt = gamma dt, or 0 with D_hat frozen."""

    dt: float
    every: int
    b: float
    gamma_dt: float
    bounds: np.ndarray  # (2,)
    input_bounds: np.ndarray  # (m, 2)
    u_star: np.ndarray  # (m,)
    p: np.ndarray
    samples: np.ndarray  # (S, B), sorted steps whose (X, u, D_hat) are kept


class State(NamedTuple):
    """The state of a run: the plant, the actuator's history, the delay estimate, and scratch for one step."""

    X: np.ndarray  # (n, B)
    D: np.ndarray  # (m, B), the delay of each input
    D_hat: np.ndarray  # (B,)
    held: np.ndarray  # (R, m, B)
    total: np.ndarray  # (R, m, B)
    u: np.ndarray  # (nx, m, B), means over the nodes' cells
    u_nodes: np.ndarray  # (nx, m, B), values at the nodes
    P: np.ndarray  # (nx, n, B)
    U: np.ndarray  # (m, B)
    phi: np.ndarray  # (B,)
    phi_before: np.ndarray  # (B,), that of the step before; NaN at first
    N: np.ndarray  # (B,)
    U0: np.ndarray  # (m, B), the delayed input for the first share of a step
    U1: np.ndarray  # (m, B), and for the rest
    share: np.ndarray  # (m, B)
    drawn: np.ndarray  # (B,), samples taken so far


class Record(NamedTuple):
    """The record of a run, time first, lanes last."""

    X: np.ndarray  # (rows, n, B)
    P: np.ndarray  # (rows, n, B), the prediction at x = 1
    U: np.ndarray  # (rows, m, B)
    D_hat: np.ndarray  # (rows, B)
    N: np.ndarray  # (rows, B)
    energy: np.ndarray  # (rows, B), the integral of |U - U*|² over the delay
    sample_X: np.ndarray  # (S, n, B)
    sample_u: np.ndarray  # (S, nx, m, B)
    sample_D_hat: np.ndarray  # (S, B)
    escaped: np.ndarray  # (B,), the first step whose state is not finite, or -1


A1, A2, A3, A4 = (types.Array(types.float64, d, "C") for d in (1, 2, 3, 4))
I1, I2 = (types.Array(types.int64, d, "C") for d in (1, 2))
SETTINGS = types.NamedTuple(
    [types.float64, types.int64, types.float64, types.float64, A1, A2, A1, A1, I2], Settings
)  # fmt: skip
STATE = types.NamedTuple([A2, A2, A1, A3, A3, A3, A3, A3, A2, A1, A1, A1, A2, A2, A2, I1], State)
RECORD = types.NamedTuple([A3, A3, A3, A2, A2, A2, A3, A4, A2, I1], Record)


def steps(
    origin: int, start: int, stop: int, transport: Any, predict: Any, control: Any, update: Any, actuate: Any,
    advance: Any, s: Settings, z: State, out: Record,
) -> None:  # fmt: skip
    """Control steps start … stop - 1 [DAPF, eqs. 6-14]; `origin` is the ring buffers' number of step 0."""
    for k in range(start, stop):
        t = k * s.dt
        transport(origin + k, s.dt, z.D, z.held, z.total, z.u, z.u_nodes)
        predict(z.X, z.u, z.D_hat, t, s.p, z.P)
        control(z.P, z.u, z.D_hat, t, s.p, z.U)
        clip(z.U, s.input_bounds)
        update(z.P, z.X, z.u_nodes, z.D_hat, t, s.p, s.b, z.phi, z.N)
        keep(k, s, z, out)
        adapt(z.D_hat, z.phi, z.phi_before, s.gamma_dt, s.bounds)
        actuate(origin + k, s.dt, z.D, z.U, z.held, z.total, z.U0, z.U1, z.share)
        advance(z.X, z.U0, z.U1, z.share, s.dt, t, s.p)


@jit(types.void(A2, A2), nogil=True)
def clip(U: np.ndarray, bounds: np.ndarray) -> None:
    """U (m, B) to its bounds; NaN stays NaN."""
    for c in range(U.shape[0]):
        for l in range(U.shape[1]):
            if U[c, l] < bounds[c, 0]:
                U[c, l] = bounds[c, 0]
            elif U[c, l] > bounds[c, 1]:
                U[c, l] = bounds[c, 1]


@jit(types.void(A1, A1, A1, types.float64, A1), nogil=True)
def adapt(D_hat: np.ndarray, phi: np.ndarray, phi_before: np.ndarray, gamma_dt: float, bounds: np.ndarray) -> None:
    """D_hat += gamma dt Proj{D_hat, phi}: clipping to the bounds is the projection [DAPF, eq. 11] in discrete time.

    phi is taken at the middle of the step, from this value and the one before: the method of Adams and Bashforth of
    order 2 (Hairer, Nørsett, Wanner, III.1.5). A first step, which has none before, is Euler's.
    """
    if gamma_dt > 0:
        for l in range(D_hat.shape[0]):
            rate = phi[l] if np.isnan(phi_before[l]) else 1.5 * phi[l] - 0.5 * phi_before[l]
            D_hat[l] = min(max(D_hat[l] + gamma_dt * rate, bounds[0]), bounds[1])
            phi_before[l] = phi[l]


@jit(types.void(A3, A1, A2, A1), nogil=True)
def energy(u: np.ndarray, u_star: np.ndarray, D: np.ndarray, out: np.ndarray) -> None:
    """Sum over inputs of ∫_{t-D_c}^t (U_c - U_c*)² ds = D_c ∫₀¹ (u_c - u_c*)² dx by the trapezoidal rule."""
    nx, m, lanes = u.shape
    for l in range(lanes):
        out[l] = 0.0
        for j in range(nx):
            for c in range(m):
                weight = D[c, l] / (nx - 1) * (0.5 if j == 0 or j == nx - 1 else 1.0)
                out[l] += weight * (u[j, c, l] - u_star[c]) ** 2


@jit(types.void(types.int64, SETTINGS, STATE, RECORD), nogil=True)
def keep(k: int, s: Settings, z: State, out: Record) -> None:
    """Write step k to the record: every `every`-th state, the samples asked for, the first step not finite."""
    for l in range(z.X.shape[1]):
        while z.drawn[l] < s.samples.shape[0] and s.samples[z.drawn[l], l] == k:
            out.sample_X[z.drawn[l], :, l] = z.X[:, l]
            out.sample_u[z.drawn[l], :, :, l] = z.u[:, :, l]
            out.sample_D_hat[z.drawn[l], l] = z.D_hat[l]
            z.drawn[l] += 1
        for c in range(z.X.shape[0]):
            if out.escaped[l] < 0 and not np.isfinite(z.X[c, l]):
                out.escaped[l] = k
    if k % s.every == 0:
        row = k // s.every
        out.X[row], out.P[row] = z.X, z.P[z.P.shape[0] - 1]
        out.U[row], out.D_hat[row], out.N[row] = z.U, z.D_hat, z.N
        energy(z.u, s.u_star, z.D, out.energy[row])


def _pointer(signature: str) -> types.FunctionType:
    arguments, _ = normalize_signature(signature)
    return types.FunctionType(types.void(*arguments))


LAWS = map(family.signature, (family.PREDICT, family.CONTROL, family.UPDATE))
PARTS = (actuator.TRANSPORT, *LAWS, actuator.ACTUATE, family.signature(family.ADVANCE))
compiled_steps = jit(
    types.void(types.int64, types.int64, types.int64, *map(_pointer, PARTS), SETTINGS, STATE, RECORD), nogil=True
)(steps)


@cache
def advance_kernel(plant: Plant, method: type[OneStep]) -> Kernel:
    """The step of the plant with held inputs, split where a switch of a delayed input falls inside it."""
    return family_of(plant).advance(method.step)
