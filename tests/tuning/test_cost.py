"""The cost of `npred tune` against docs/tune.md read literally: its loops, and only the starts of npred's tuning."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import npred
from npred import plants
from npred.lab import config
from npred.lab.stages.tuning import Loops, Settling, Yardstick
from npred.plants import Plant

DT, EFFORT = 0.005, 0.1
CASES = {  # plant, D, T, before, after
    "at rest at 0, stiffer": ("van_der_pol", 1.0, 12.0, {"k1": 6.0, "k2": 4.0}, {"k1": 12.0, "k2": 3.0}),
    "at rest at 0, quick": ("van_der_pol", 1.0, 12.0, {"k1": 6.0, "k2": 4.0}, {"k1": 19.98, "k2": 9.008}),
    "unstable, slower": ("cart_pole", 0.2, 15.0, {"k_p": 1.0, "k_v": 2.4106}, {"k_p": 0.7, "k_v": 2.2}),
    "at rest elsewhere": ("chemostat", 1.5, 15.0, {"delta": 10.0}, {"delta": 3.0}),
    "tracks": ("planar_arm2", 0.1, 8.0, {"stiffness": 4.0, "damping": 4.0}, {"stiffness": 9.0, "damping": 5.0}),
    "does not settle": ("van_der_pol", 1.0, 5.0, {"k1": 6.0, "k2": 4.0}, {"k1": 12.0, "k2": 3.0}),
}


def loops(plant: Plant, aims: Plant, X: np.ndarray, D: float, T: float) -> tuple[np.ndarray, np.ndarray]:
    """tau, E (S,) from X (S, n) with exact prediction: U(t) = kappa(X(t + D)), held for DT; `aims` has X* and U*."""
    late, steps = round(D / DT), round(T / DT)
    U, states, held = [], [X], np.tile(plant.u_target(0.0) if plant.rests else np.zeros(plant.m), (len(X), 1))
    for k in range(steps + late):
        if k >= late:
            U.append(held := plant.kappa(X, k * DT))
        k1 = plant.f(X, held, k * DT)
        k2 = plant.f(X + DT / 2 * k1, held, (k + 0.5) * DT)
        k3 = plant.f(X + DT / 2 * k2, held, (k + 0.5) * DT)
        X = X + DT / 6 * (k1 + 2 * k2 + 2 * k3 + plant.f(X + DT * k3, held, (k + 1) * DT))
        states.append(X)
    U.append(plant.kappa(X, (steps + late) * DT))
    t = DT * np.arange(steps + 1)
    goal, rest = (np.broadcast_to(a, (steps + 1, a.shape[-1])) for a in (aims.target(t), aims.u_target(t)))
    unit = np.linalg.norm(goal, axis=1).max()
    far = np.linalg.norm(np.array(states)[: steps + 1] - goal[:, None], axis=2) / (unit if unit > 1e-9 else 1.0)
    tau, E = np.zeros(far.shape[1]), np.full(far.shape[1], np.inf)
    square = ((np.array(U) - rest[:, None]) ** 2).sum(axis=2)
    for k, distance in enumerate(far.T):
        outside = np.flatnonzero(distance > 0.01)
        if outside.size and outside[-1] == steps:
            r = distance[t >= 0.9 * T].max()
            tau[k] = (2 + r / (1 + r)) * T
        else:
            tau[k] = t[outside[-1] + 1] if outside.size else 0.0
            E[k] = (square[1:, k] + square[:-1, k]).sum() / 2 * DT
    return tau, E


def cost(tau: np.ndarray, E: np.ndarray, present: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """tau / tau_0 + w E / (E + E_0), and tau / tau_0 + w where a loop does not settle."""
    E_0 = present[1][np.isfinite(present[1])].mean()
    return tau / present[0].mean() + EFFORT * np.where(np.isfinite(E), E / (np.where(np.isfinite(E), E, 0) + E_0), 1.0)


@pytest.mark.parametrize("overflows_at", [0, 3, 50, 99])
def test_a_loop_that_overflows_at_t_has_4_T_less_t_and_all_of_the_effort(overflows_at: int):
    """Beside it one that settles, one that stays away and one that swings: any that overflows is later than they are,
    the sooner it does so the more.
    """
    plant, t = npred.plant("van_der_pol"), np.linspace(0.0, 5.0, 101)
    X = np.zeros((4, 101, 2))
    X[0, :20], X[1], X[2, :, 0] = 1.0, 7.0, 100 * np.sin(t)
    X[3, overflows_at:] = np.nan
    loops = SimpleNamespace(t=t, X=X, U=np.zeros((4, 101, 1)), target=None, u_target=None, safety=None)
    found = Settling.of(cast(Any, loops), plant, 4)
    share = overflows_at / 101
    assert found.time[3, 0] == pytest.approx((4 - share) * 5.0, rel=1e-12)
    assert found.time[0, 0] == pytest.approx(t[20]) and (found.time[:3, 0] < found.time[3, 0]).all()
    assert found.settled[:, 0].tolist() == [True, False, False, False] and np.isinf(found.effort[1:]).all()
    failed = Settling.failed(found, 5.0)
    assert (failed.time == 4 * 5.0).all() and (failed.time >= found.time).all() and not failed.settled.any()
    costs = Yardstick(1.0, 1.0, EFFORT).costs(found)[:, 0]
    assert costs[3] == pytest.approx((4 - share) * 5.0 + EFFORT) and costs.argmax() == 3


@pytest.mark.parametrize("name", CASES)
def test_the_cost_is_the_one_that_the_page_defines(name: str):
    kind, D, T, before, after = CASES[name]
    plant = plants.resolve(kind)
    table = {
        "adaptation": "frozen", "D": D, "D_hat": D, "case_D_hat": [D], "X0": [1.0] * plant.n, "dt": DT, "t_end": T,
        "case_t_end": T, "nx": 51, "predictor": "heun", "u0": "equilibrium" if plant.rests else None,
    }  # fmt: skip
    pipeline = config.parse({"plant": kind, "evaluate": table, "tune": {"effort": EFFORT}}, "cost.toml")
    drawn = Loops(pipeline, plant, 6, "training")
    present, outcome = (drawn.run(numbers, lambda steps: None) for numbers in (before, after))
    found = Yardstick.of(present, EFFORT, DT).costs(outcome)[:, 0]
    X0 = drawn.conditions[0].X0
    old, new = (loops(plants.varied(plant, tuple(numbers.items())), plant, X0, D, T) for numbers in (before, after))
    assert found == pytest.approx(cost(*new, old), rel=0.01)  # each loop; npred's prediction reads u at 51 nodes
    assert found.mean() == pytest.approx(cost(*new, old).mean(), rel=0.003)
