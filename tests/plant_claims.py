"""What every built-in plant must show, each claim against something independent of the code that it is about."""

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from npred import config, grid
from npred.closed_loop import Trajectories, simulate
from npred.plants import Plant, fit
from npred.predictors import METHODS, RK4


def pipeline_fits(plant: Plant) -> None:
    """The plant's pipeline asks every stage for what the plant has."""
    found = config.load(Path(__file__).parent.parent / f"pipeline/{plant.name}.toml")
    assert found.plant == found.name == plant.name
    fit.check(plant, found, ("generate", "train", "evaluate", "bench"))


def steps_of_dop853(plant: Plant, loop: Trajectories, D: float) -> np.ndarray:
    """The loop's states by the method of steps: DOP853 over each step of the held input that arrives D later."""
    dt, late = loop.t[1] - loop.t[0], round(D / (loop.t[1] - loop.t[0]))
    X = [loop.X[0]]
    for k in range(len(loop.t) - 1):
        u = loop.U[k - late] if k >= late else np.zeros(plant.m)
        step = solve_ivp(lambda t, x, u=u: plant.f(x, u), (0, dt), X[-1], "DOP853", rtol=1e-10, atol=1e-12)
        X.append(step.y[:, -1])
    return np.array(X)


def box(plant: Plant, count: int) -> np.ndarray:
    """States of the plant's box, (count, n)."""
    ends = np.array([plant.box[name] for name in plant.states])
    return np.random.default_rng(3).uniform(ends[:, 0], ends[:, 1], (count, plant.n))


def derivatives_equal_differences(plant: Plant) -> None:
    """f_X, f_U and kappa' against differences of fourth order, on the box."""
    for X in box(plant, 20):
        u = plant.kappa(X)
        f_X, f_U = plant.jacobians(X, u)
        np.testing.assert_allclose(f_X, _differences(lambda x, u=u: plant.f(x, u), X), rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(f_U, _differences(lambda v, X=X: plant.f(X, v), u), rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(plant.kappa_jacobian(X), _differences(plant.kappa, X), rtol=1e-7, atol=1e-7)


def _differences(function, x: np.ndarray) -> np.ndarray:
    h = 1e-3
    columns = []
    for unit in h * np.eye(len(x)):
        far, near = (function(x + s * unit) - function(x - s * unit) for s in (2, 1))
        columns.append((8 * near - far) / (12 * h))
    return np.stack(columns, axis=-1)


def orders(plant: Plant, method: str, D_hat: float) -> float:
    """The fitted order of a predictor's error at x = 1 against a fine grid, for a smooth input around rest."""
    X = box(plant, 5)
    intervals = [50, 100, 200]
    fine = _predict(plant, "rk4", 4000, X, D_hat)
    errors = [np.abs(_predict(plant, method, n, X, D_hat) - fine).max() for n in intervals]
    return -np.polyfit(np.log(intervals), np.log(errors), 1)[0]


def _predict(plant: Plant, method: str, intervals: int, X: np.ndarray, D_hat: float) -> np.ndarray:
    x = grid.nodes(intervals + 1)
    u = plant.u_equilibrium + 0.3 * np.sin(3 * x + 1)[:, None]
    return METHODS[method](plant, intervals + 1)(X, u, D_hat)[:, -1]


def distances(plant: Plant, D: float, D_hat: float, t_end: float) -> np.ndarray:
    """How far from rest the exact predictor's loops are in their last quarter, D_hat frozen; inf where one is lost."""
    loops = simulate(plant, RK4(plant, 51), D=D, D_hat=D_hat, X0=box(plant, 32), t_end=t_end, every=20)
    far = np.linalg.norm(loops.X[:, loops.t >= 0.75 * t_end] - plant.equilibrium, axis=-1).max(axis=-1)
    return np.where(np.isfinite(far), far, np.inf)
