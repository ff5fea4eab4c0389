"""The time loop on flat memory, lanes innermost: one compiled engine for every plant, predictor and number of loops.

Its parts reach it as function pointers, so it is compiled once per machine, not per plant, and an edit of a part
never leaves a stale copy of it in Numba's cache. With a predictor in Python the same text runs uncompiled.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import types

from npred.delays import family, family_of
from npred.delays.family import Kernel
from npred.loop import actuator
from npred.loop.actuator import copy, retime
from npred.loop.measurement import ESTIMATE, SENSOR, Sensor, sample
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
    ratios: np.ndarray  # (m,), the delay of each input as a share of the longest
    law: np.ndarray  # what an observer of the delay is set to
    guard: np.ndarray  # what the guard of the predictor is set to
    truth_p: np.ndarray  # the parameters of the simulated plant
    delays: np.ndarray  # (steps + 1, m, B), of each input where the delay is a function of time, or empty
    disturbance: np.ndarray  # (steps, m), added to what leaves the actuator, or empty
    moves: bool  # whether the plant declares its delay
    senses: bool  # whether the controller sees anything but X
    sensor: Sensor
    late: int  # control steps that the samples in Y are old


class State(NamedTuple):
    """The state of a run: the plant, the actuator's history, the delay estimate, and scratch for one step."""

    X: np.ndarray  # (n, B)
    X_hat: np.ndarray  # (n, B), what the controller sees or estimates of X: X itself by default
    D: np.ndarray  # (m, B), the delay of each input
    D_seen: np.ndarray  # (m, B), that by which the controller reads the commands: D itself where u is measured
    longest: np.ndarray  # (B,), the plant's longest delay
    speed: np.ndarray  # (m, B), of phi(t) = t - D
    memory: np.ndarray  # (., B), what an observer of the delay remembers
    Y: np.ndarray  # (n, B), the samples that arrive now, NaN where none does: X itself by default
    past: np.ndarray  # (R, n, B), the last states
    due: np.ndarray  # (B,), when the next sample is taken, in control steps
    sampled: np.ndarray  # (B,), samples taken so far
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
    error: np.ndarray  # (B,), the guard's estimate of the error of U
    fallback: np.ndarray  # (B,), 1 where the guard answered, else 0


class Record(NamedTuple):
    """The record of a run, time first, lanes last."""

    X: np.ndarray  # (rows, n, B)
    P: np.ndarray  # (rows, n, B), the prediction at x = 1
    U: np.ndarray  # (rows, m, B)
    D_hat: np.ndarray  # (rows, B)
    N: np.ndarray  # (rows, B)
    energy: np.ndarray  # (rows, B), the integral of |U - U*|² over the true delay
    sample_X: np.ndarray  # (S + 1, n, B), the last one where a prediction ended
    sample_u: np.ndarray  # (S + 1, nx, m, B)
    sample_D_hat: np.ndarray  # (S + 1, B)
    escaped: np.ndarray  # (B,), the first step whose state is not finite, or -1
    infeasible: np.ndarray  # (B,), the first step at which commands would overtake each other, or -1
    breach: np.ndarray  # (n + m + 1, B), state and input there, and the time of that step
    fallback: np.ndarray  # (rows, B), whether the guard answered since the row before
    fallbacks: np.ndarray  # (B,), the steps in which it did


A1, A2, A3, A4 = (types.Array(types.float64, d, "C") for d in (1, 2, 3, 4))
I1, I2 = (types.Array(types.int64, d, "C") for d in (1, 2))
B2 = types.Array(types.boolean, 2, "C")
SETTINGS = types.NamedTuple(
    [types.float64, types.int64, types.float64, types.float64, A1, A2, A1, A1, I2, A1, A1, A1, A1, A3, A2,
     types.boolean, types.boolean, SENSOR, types.int64], Settings
)  # fmt: skip
STATE = types.NamedTuple(
    [A2, A2, A2, A2, A1, A2, A2, A2, A3, A1, I1, A1, A3, A3, A3, A3, A3, A2, A1, A1, A1, A2, A2, A2, I1, A1, A1],
    State,
)
RECORD = types.NamedTuple([A3, A3, A3, A2, A2, A2, A3, A4, A2, I1, I1, A2, B2, I1], Record)


def steps(
    origin: int, start: int, stop: int, horizon: Any, estimate: Any, observe: Any, believe: Any, transport: Any,
    predict: Any, guard: Any, control: Any, update: Any, actuate: Any, pace: Any, advance: Any, model: Any,
    s: Settings, z: State, out: Record,
) -> None:  # fmt: skip
    """Control steps start … stop - 1 [DAPF, eqs. 6-14]; `origin` is the ring buffers' number of step 0.

    The plant advances by `advance`, what the controller believes of it by `model`.
    """
    for k in range(start, stop):
        t = k * s.dt
        if s.delays.shape[0] > 0:
            tabulated(k, s.dt, s.delays, z.D, z.speed)
        horizon(z.X, t, s.truth_p, s.ratios, z.longest, z.D)
        if s.senses:
            sample(k, s.sensor, z.X, z.past, z.due, z.sampled, z.Y)
            estimate(k, origin, s.dt, s.sensor.age, z.D_seen, z.held, z.Y, z.X_hat, model, s.p)
        taken = max(k - s.late, 0)
        if k == 0 or taken > 0:  # the first sample is there at once
            observe(origin + taken, s.dt, z.Y, z.held, taken * s.dt, s.p, s.law, z.memory, z.D_hat)
        believe(z.X_hat, t, s.p, s.ratios, z.D_hat, z.D_seen)
        transport(origin + k, s.dt, z.D_seen, z.held, z.total, z.u, z.u_nodes)
        predict(z.X_hat, z.u, z.D_hat, t, s.p, z.P)
        guard(z.X_hat, z.u, z.D_hat, t, s.p, s.guard, z.P, z.error, z.fallback)
        control(z.P, z.u, z.D_hat, t, s.p, z.U)
        clip(z.U, s.input_bounds)
        update(z.P, z.X_hat, z.u_nodes, z.D_hat, t, s.p, s.b, z.phi, z.N)
        keep(k, origin, s, z, out)
        adapt(z.D_hat, z.phi, z.phi_before, s.gamma_dt, s.bounds)
        actuate(origin + k, s.dt, z.D, z.U, z.held, z.total, z.U0, z.U1, z.share)
        if s.moves:
            pace(z.X, z.U0, t, s.truth_p, z.speed)
            watch(k, t, (origin + k) * s.dt, z, out)
        if s.moves or s.delays.shape[0] > 0:
            retime(origin + k, s.dt, z.D, z.speed, z.held, z.U1, z.share)
        if s.disturbance.shape[0] > 0:
            disturb(s.disturbance[k], z.U0, z.U1)
        advance(z.X, z.U0, z.U1, z.share, s.dt, t, s.truth_p)


@jit(types.void(types.int64, types.float64, A3, A2, A2), nogil=True)
def tabulated(k: int, dt: float, delays: np.ndarray, D: np.ndarray, speed: np.ndarray) -> None:
    """D (m, B) at control step k, and the speed of phi(t) = t - D during it."""
    for c in range(D.shape[0]):
        for l in range(D.shape[1]):
            D[c, l] = delays[k, c, l]
            speed[c, l] = 1.0 - (delays[k + 1, c, l] - delays[k, c, l]) / dt


@jit(types.void(A1, A2, A2), nogil=True)
def disturb(d: np.ndarray, U0: np.ndarray, U1: np.ndarray) -> None:
    """Add d (m,) to what leaves the actuator."""
    for c in range(U0.shape[0]):
        for l in range(U0.shape[1]):
            U0[c, l] += d[c]
            U1[c, l] += d[c]


@jit(types.void(types.int64, types.float64, types.float64, STATE, RECORD), nogil=True)
def watch(k: int, t: float, longest: float, z: State, out: Record) -> None:
    """Mark the loops in which 1 - D_X f - D_t <= 0, in the plant or along the prediction; they are NaN from there on.

    So are those whose delay is negative, or in one step came to be longer than the history of commands, `longest`.
    A prediction that ends there has its last finite node as state, with the input there; what it was made from is the
    last of the samples, and says when that node comes.
    """
    n, m, nx = z.X.shape[0], z.U0.shape[0], z.P.shape[0]
    for l in range(z.X.shape[1]):
        lost = np.isnan(z.P[nx - 1, 0, l]) and not np.isnan(z.X_hat[0, l])
        runs = z.speed[0, l] > 0.0 and 0.0 <= z.D[0, l] <= longest
        if out.infeasible[l] < 0 and np.isfinite(z.X[0, l]) and (lost or not runs):
            out.infeasible[l] = k
            X, U = z.X, z.U0
            if lost:
                j = 0
                while j < nx - 2 and not np.isnan(z.P[j + 1, 0, l]):
                    j += 1
                X, U = z.P[j], z.u[j]
                out.sample_X[-1, :, l], out.sample_u[-1, :, :, l] = z.X_hat[:, l], z.u[:, :, l]
                out.sample_D_hat[-1, l] = z.D_hat[l]
            for c in range(n):
                out.breach[c, l] = X[c, l]
                z.X[c, l] = np.nan
            for c in range(m):
                out.breach[n + c, l] = U[c, l]
                z.speed[c, l] = 0.0
            out.breach[n + m, l] = t


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


@jit(types.void(types.int64, types.float64, A3, A1, A2, A2, A3, A1), nogil=True)
def energy(
    k: int, dt: float, u: np.ndarray, u_star: np.ndarray, D_seen: np.ndarray, D: np.ndarray, held: np.ndarray,
    out: np.ndarray,
) -> None:  # fmt: skip
    """Sum over inputs of ∫_{t-D_c}^t (U_c - U_c*)² ds = D_c ∫₀¹ (u_c - u_c*)² dx by the trapezoidal rule.

    Where the controller reads u by another delay than the true one, it is the sum over the commands that are held.
    """
    nx, m, lanes = u.shape
    rows = held.shape[0]
    for l in range(lanes):
        out[l] = 0.0
        for j in range(nx):
            for c in range(m):
                if not (D[c, l] >= 0.0 and D[c, l] != D_seen[c, l]):
                    weight = D_seen[c, l] / (nx - 1) * (0.5 if j == 0 or j == nx - 1 else 1.0)
                    out[l] += weight * (u[j, c, l] - u_star[c]) ** 2
        for c in range(m):
            if D[c, l] >= 0.0 and D[c, l] != D_seen[c, l]:
                left, i = min(D[c, l] / dt, float(rows - 1)), k - 1
                while left > 0.0:
                    out[l] += min(left, 1.0) * dt * (held[i % rows, c, l] - u_star[c]) ** 2
                    left, i = left - 1.0, i - 1


@jit(types.void(types.int64, types.int64, SETTINGS, STATE, RECORD), nogil=True)
def keep(k: int, origin: int, s: Settings, z: State, out: Record) -> None:
    """Write step k to the record: every `every`-th state, the samples asked for, the first step not finite."""
    for l in range(z.X.shape[1]):
        while z.drawn[l] < s.samples.shape[0] and s.samples[z.drawn[l], l] == k:
            for c in range(z.X.shape[0]):
                out.sample_X[z.drawn[l], c, l] = z.X[c, l]
            for j in range(z.u.shape[0]):
                for c in range(z.u.shape[1]):
                    out.sample_u[z.drawn[l], j, c, l] = z.u[j, c, l]
            out.sample_D_hat[z.drawn[l], l] = z.D_hat[l]
            z.drawn[l] += 1
        if z.fallback[l] > 0.0 and np.isfinite(z.X[0, l]):
            out.fallbacks[l] += 1
            row = (k + s.every - 1) // s.every
            if row < out.fallback.shape[0]:
                out.fallback[row, l] = True
        for c in range(z.X.shape[0]):
            if out.escaped[l] < 0 and not np.isfinite(z.X[c, l]):
                out.escaped[l] = k
    if k % s.every == 0:
        row = k // s.every
        copy(z.X, out.X[row])
        copy(z.P[z.P.shape[0] - 1], out.P[row])
        copy(z.U, out.U[row])
        for l in range(z.X.shape[1]):
            out.D_hat[row, l], out.N[row, l] = z.D_hat[l], z.N[l]
        energy(origin + k, s.dt, z.u, s.u_star, z.D_seen, z.D, z.held, out.energy[row])


@jit(family.signature(family.HORIZON), nogil=True)
def own_history(X_hat, t, p, ratios, D_hat, D_seen):  # type: ignore[no-untyped-def]
    """The controller reads its own commands, by its estimate of the delay."""
    for c in range(D_seen.shape[0]):
        for l in range(D_seen.shape[1]):
            D_seen[c, l] = ratios[c] * D_hat[l]


HORIZON, OBSERVE, PREDICT, GUARD, CONTROL, UPDATE, SPEED, ADVANCE = map(
    family.signature,
    (family.HORIZON, family.OBSERVE, family.PREDICT, family.GUARD, family.CONTROL, family.UPDATE, family.SPEED,
     family.ADVANCE),
)  # fmt: skip
POINTERS = (
    HORIZON, ESTIMATE, OBSERVE, HORIZON, actuator.TRANSPORT, PREDICT, GUARD, CONTROL, UPDATE, actuator.ACTUATE, SPEED,
    ADVANCE, ADVANCE,
)  # fmt: skip
compiled_steps = jit(
    types.void(types.int64, types.int64, types.int64, *map(family.pointer, POINTERS), SETTINGS, STATE, RECORD),
    nogil=True,
)(steps)


@cache
def advance_kernel(plant: Plant, method: type[OneStep]) -> Kernel:
    """The step of the plant with held inputs, split where a switch of a delayed input falls inside it."""
    return family_of(plant).advance(method.step)
