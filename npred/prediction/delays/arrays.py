"""A plant that is not traced, with one constant delay: the same formulas on arrays (n, B), f called as it is.

A lane that overflows is NaN from there on, and its reader reports it: NumPy does not warn.
"""

from typing import ClassVar

import numpy as np

from npred.base import grid
from npred.formulas import array_math
from npred.plants.base import Plant
from npred.plants.black_box import BlackBox, units
from npred.prediction.delays.problem import CURES, Kernel, PredictionProblem, Step, transition

Lanes = np.ndarray  # lanes innermost
FEW = 4  # states up to which derivatives by all of them cost less than a call for each direction


class ArrayProblem(PredictionProblem):
    """All inputs of a black box arrive D late."""

    plant: BlackBox
    lacks: ClassVar = ("rosenbrock", "semi_implicit", "bound", "onnx", "export c", "export controller")
    cures: ClassVar = CURES | dict.fromkeys(("rosenbrock", "semi_implicit"), "use heun or rk4, on more nodes")

    @staticmethod
    def serves(plant: Plant) -> bool:
        return isinstance(plant, BlackBox)

    def expected(self) -> str:
        return f"expected a plant that is traced, {self.plant.name} says traced = False"

    def sweep(self, step: Step, cells: bool = False, more: int = 0) -> Kernel:
        plant = self.plant
        f, zero, unknown = on_lanes(plant), np.zeros((1, 1)), np.full((1, 1), np.nan)
        # a method that takes u in the middle of a step gets the mean over it
        middle = np.isnan(step(lambda x, u, t: x + u, zero, zero, unknown, zero, 0.0, 0.1)).any()

        @np.errstate(all="ignore")
        def predict(X: Lanes, u: Lanes, D_hat: Lanes, t: float, p: Lanes, P: Lanes) -> None:
            nx, h = len(P), D_hat / (len(P) - 1)
            begin, end = (
                (a.transpose(1, 2, 0) for a in grid.lines(np.moveaxis(u, -1, 0))) if middle else (u[:-1], u[1:])
            )
            P[0] = X
            for j in range(nx - 1):
                inputs = begin[j], 0.5 * (begin[j] + end[j]), end[j]
                P[j + 1] = plant.stopped(step(f, P[j], *inputs, t + j * h, h), array_math.NUMPY)

        return predict

    def picard(self, tolerance: float, sweeps: int) -> Kernel:
        plant = self.plant

        @np.errstate(all="ignore")
        def predict(X: Lanes, u: Lanes, D_hat: Lanes, t: float, p: Lanes, P: Lanes) -> None:
            h, times = D_hat / (len(P) - 1), t + np.arange(len(P))[:, None] * D_hat / (len(P) - 1)
            P[:] = X
            for _ in range(sweeps):
                f = np.moveaxis(plant.f(np.moveaxis(P, 1, -1), np.moveaxis(u, 1, -1), times), -1, 1)
                new = np.concatenate([P[:1], X + np.cumsum(h / 2 * (f[:-1] + f[1:]), axis=0)])
                change, size = np.abs(new - P).max(axis=(0, 1)), np.abs(new).max(axis=(0, 1))
                P[:] = new
                if (change <= tolerance * (1.0 + size)).all():
                    return
            P[..., ~(change <= tolerance * (1.0 + size))] = np.nan

        return predict

    def control(self, step: Step) -> Kernel:
        plant = self.plant

        @np.errstate(all="ignore")
        def law(P: Lanes, u: Lanes, D_hat: Lanes, t: float, p: Lanes, U: Lanes) -> None:
            U[:] = plant.kappa(P[-1].T, t + D_hat).T

        return law

    def update(self) -> Kernel:
        plant = self.plant
        f = on_lanes(plant)

        @np.errstate(all="ignore")
        def law(P: Lanes, X: Lanes, u: Lanes, D_hat: Lanes, t: float, p: Lanes, b: float, phi: Lanes, N: Lanes) -> None:
            last, h = len(P) - 1, D_hat / (len(P) - 1)
            r = f(P[0], u[0], t + 0.0 * h)
            nodes = np.arange(last + 1)[:, None]
            states, inputs, now = P.transpose(0, 2, 1), u.transpose(0, 2, 1), t + nodes * h
            df = _slopes(plant, states, inputs, now)
            s, moved = h * df[0](P[0], u[0], t + 0.0 * h, r), [r]
            for j in range(1, last + 1):
                r, s = transition(df[j], P[j], u[j], t + j * h, h, r, s)
                moved.append(r)
            along = np.stack(moved).transpose(0, 2, 1)
            w, q1 = inputs - plant.kappa(states, now), plant.dkappa(states, now, along, 1.0)
            weight = (1.0 + nodes / last) * np.where((nodes == 0) | (nodes == last), 0.5, 1.0)
            I1, I2 = (weight * (q1 * w).sum(axis=-1)).sum(axis=0), (weight * (w * w).sum(axis=-1)).sum(axis=0)
            N[:] = 1.0 + plant.V(X.T, t) + b * I2 / last
            phi[:] = -I1 / last / N

        return law

    def advance(self, step: Step) -> Kernel:
        plant = self.plant
        f = on_lanes(plant)

        @np.errstate(all="ignore")
        def held(X: Lanes, U0: Lanes, U1: Lanes, share: Lanes, dt: float, t: float, p: Lanes) -> None:
            part = share[0]
            X[:] = plant.stopped(step(f, X, U0, U0, U0, t, part * dt), array_math.NUMPY)
            if (part < 1.0).any():
                rest = step(f, X, U1, U1, U1, t + part * dt, (1.0 - part) * dt)
                X[:] = np.where(part < 1.0, plant.stopped(rest, array_math.NUMPY), X)

        return held


def _slopes(plant: BlackBox, states: np.ndarray, inputs: np.ndarray, now: np.ndarray) -> list[Step]:
    """df(x, u, t, along) = f_X along + f_t on lanes for each node, states (nx, B, n), inputs (nx, B, m), now (nx, B).

    Of FEW states the derivatives of all nodes by all states are one call; else one call for each `along`.
    """
    if plant.n > FEW:
        return [lambda x, u, t, along: plant.df(x.T, u.T, t, along.T, 1.0).T] * len(states)
    f_X = plant.df(states, inputs, now, units(states))
    f_t = np.zeros_like(states) if plant.autonomous else plant.df(states, inputs, now, 0.0 * states, 1.0)
    return [
        lambda x, u, t, along, f_X=f_X[:, j], f_t=f_t[j]: np.einsum("kbi,kb->ib", f_X, along) + f_t.T
        for j in range(len(states))
    ]


def on_lanes(plant: Plant) -> Step:
    """f(x, u, t) with lanes last: x (n, B), u (m, B), t a number or (B,), to (n, B)."""
    return lambda x, u, t: plant.f(x.T, u.T, t).T
