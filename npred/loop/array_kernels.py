"""The control and update laws, and a step of the plant, for plants that are not traced: the same formulas on arrays.

A lane that leaves the finite numbers is NaN from there on, which its reader says in words: NumPy warns of nothing.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred.plants.black_box import BlackBox
from npred.predictors.array_predictors import on_lanes
from npred.predictors.onestep import OneStep


def control(plant: BlackBox) -> Callable[..., None]:
    """U = kappa(P(1))."""

    @np.errstate(all="ignore")
    def law(P: Any, u: Any, D_hat: Any, t: float, p: Any, U: Any) -> None:
        U[:] = plant.kappa(P[-1].T, t + D_hat).T

    return law


def update(plant: BlackBox, transition: Callable[..., Any]) -> Callable[..., None]:
    """phi and N as in npred.loop.adaptation, derivatives as the plant has them."""
    f = on_lanes(plant)

    def df(x: np.ndarray, v: np.ndarray, t: Any, along: np.ndarray) -> np.ndarray:
        return plant.df(x.T, v.T, t, along.T, 1.0).T

    @np.errstate(all="ignore")
    def law(P: Any, X: Any, u: Any, D_hat: Any, t: float, p: Any, b: float, phi: Any, N: Any) -> None:
        last, h = len(P) - 1, D_hat / (len(P) - 1)
        r = f(P[0], u[0], t + 0.0 * h)
        s, I1, I2 = h * df(P[0], u[0], t + 0.0 * h, r), 0.0, 0.0
        for j in range(last + 1):
            now = t + j * h
            if j:
                r, s = transition(df, P[j], u[j], now, h, r, s)
            w, q1 = u[j] - plant.kappa(P[j].T, now).T, plant.dkappa(P[j].T, now, r.T, 1.0).T
            weight = (1.0 + j / last) * (0.5 if j in (0, last) else 1.0)
            I1, I2 = I1 + weight * (q1 * w).sum(axis=0), I2 + weight * (w * w).sum(axis=0)
        N[:] = 1.0 + plant.V(X.T, t) + b * I2 / last
        phi[:] = -I1 / last / N

    return law


def advance(plant: BlackBox, method: type[OneStep]) -> Callable[..., None]:
    """A step of the plant with held input, split where a switch of the delayed input falls inside it."""
    f = on_lanes(plant)

    @np.errstate(all="ignore")
    def step(X: np.ndarray, U0: Any, U1: Any, share: np.ndarray, dt: float, t: float, p: Any) -> None:
        part = share[0]
        X[:] = method.step(f, X, U0, U0, U0, t, part * dt)
        if (part < 1.0).any():
            rest = method.step(f, X, U1, U1, U1, t + part * dt, (1.0 - part) * dt)
            X[:] = np.where(part < 1.0, rest, X)

    return step
