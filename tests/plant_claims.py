"""What every plant must show, each claim against something independent of the code that it is about.

A plant's test module subclasses Claims and says which plant, from where, over which delay:

    class TestClaims(plant_claims.Claims):
        plant, D, X0, t_end = plants.resolve("tank"), 0.5, (0.6,), 20.0
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from input_histories import means
from scipy.integrate import solve_ivp

from npred.base.registry import METHODS
from npred.lab import config
from npred.lab.scheduler import pipeline_fit
from npred.loop.closed_loop import Trajectories, simulate
from npred.plants import Plant
from npred.prediction import methods as predictors
from npred.prediction.delays import problem_of
from npred.prediction.delays.constant import ConstantDelay
from npred.prediction.methods import RK4
from npred.prediction.methods.base import OneStep

DT = 0.005
GOLDEN = 5.0  # s of the golden loop: each of its control steps is solved anew
SPREAD = 32  # starts drawn from the box


class Held(OneStep):
    """RK4 for a held input: exact where nodes are the ends and the middles of control steps, and D_hat = D.

    The mean over the cell of a middle is the input of its step: both halves of the step read it, at the odd node.
    """

    name, order = "held", 4

    @staticmethod
    def step(f: Any, x: Any, u0: Any, um: Any, u1: Any, t: Any, h: Any) -> Any:
        return RK4.step(f, x, u0, u0, u0, t, h)

    def compile(self) -> Any:
        kernel, node = ConstantDelay(self.plant).sweep(self.step), "(CELLS ? 2 * j : j)"
        assert node in kernel.text
        return replace(kernel, text=kernel.text.replace(node, "(j | 1)"))


class Claims:
    """The claims, as tests. D is the largest delay of the plant's pipeline in seconds, or one per input; X0 a start.

    By `t_end` the exact predictor's loops from the box are within `near` of the target, the equilibrium or the
    reference, and the loops of U = kappa(X(t)) are not within `far`.
    """

    plant: ClassVar[Plant]
    D: ClassVar[float | tuple[float, ...]]
    X0: ClassVar[tuple[float, ...]]
    t_end: ClassVar[float]
    near: ClassVar[float] = 1e-4
    far: ClassVar[float] = 0.1
    pipeline: ClassVar[str | None] = None  # where it has another name than the plant

    def predicted(self, nodes: int, method: type[OneStep] = Held, **settings: Any) -> Trajectories:
        """Loops with that predictor and D_hat = D."""
        return simulate(
            self.plant,
            method(self.plant, nodes),
            **{"D": self.D, "D_hat": self.D, "dt": DT, "u0": self.plant.m * [0.0]} | settings,
        )

    def test_its_pipeline_fits(self):
        name = self.pipeline or self.plant.name
        found = config.load(Path(__file__).parent.parent / f"pipeline/{name}.toml")
        assert (found.plant, found.name) == (self.plant.name, name)
        pipeline_fit.require(self.plant, found, ("generate", "train", "evaluate", "bench"))

    def test_derivatives_equal_differences(self):
        derivatives_equal_differences(self.plant)

    @pytest.mark.parametrize("method", METHODS.builtin)
    def test_predictor_order(self, method: str):
        if refusal := problem_of(self.plant).refusal(method):
            assert {"semi_implicit": "mechanics", "rollout": "rollout"}[method] in refusal[0]
            return
        has_its_order(self.plant, method, np.max(self.D))

    def test_the_loop_is_the_golden_one(self):
        """With nodes on the ends and middles of control steps, and by RK4 with three nodes a step."""
        cells = round(np.max(self.D) / DT)
        golden = golden_loop(self.plant, self.D, self.X0, GOLDEN)
        loop = self.predicted(2 * cells + 1, X0=self.X0, t_end=GOLDEN)
        np.testing.assert_allclose(loop.X, golden, rtol=0, atol=1e-6)
        loop = self.predicted(3 * cells + 1, RK4, X0=self.X0, t_end=GOLDEN)
        np.testing.assert_allclose(loop.X, golden, rtol=0, atol=1e-6)

    def test_the_exact_predictors_loop_converges_from_the_box(self):
        assert self.distances(self.D).max() < self.near

    def test_without_the_predictor_it_does_not(self):
        assert self.distances(np.multiply(self.D, 0.0)).min() > self.far

    def distances(self, D_hat: Any) -> np.ndarray:
        """How far from the target the loops from the box are in their last quarter; inf where one is lost."""
        loops = self.predicted(51, RK4, D_hat=D_hat, X0=box(self.plant, SPREAD), t_end=self.t_end, every=20)
        late = loops.t >= 0.75 * self.t_end
        far = np.linalg.norm((loops.X - self.plant.target(loops.t))[:, late], axis=-1).max(axis=-1)
        return np.where(np.isfinite(far), far, np.inf)


def golden_loop(plant: Plant, D: Any, X0: Any, t_end: float, dt: float = DT) -> np.ndarray:
    """The loop of the exact predictor by the method of steps, without any predictor: X (nt, n).

    Input j arrives D_j late and was kappa_j of the state that it meets: from D_j on it is kappa_j(X(t)) held over each
    step, before that it is 0. So every step is an ordinary differential equation, here by DOP853.
    """
    late = np.round(np.broadcast_to(D, plant.m) / dt)
    X = [np.array(X0, dtype=float)]
    for k in range(round(t_end / dt)):
        X.append(_advance(plant, X[-1], np.where(k >= late, plant.kappa(X[-1], k * dt), 0.0), k * dt, dt))
    return np.array(X)


def replayed(plant: Plant, loop: Trajectories, D: Any) -> np.ndarray:
    """The states that a recorded loop's own inputs lead to, input j arriving D_j late: X (nt, n)."""
    dt = loop.t[1] - loop.t[0]
    late = np.round(np.broadcast_to(D, plant.m) / dt).astype(int)
    X = [loop.X[0]]
    for k in range(len(loop.t) - 1):
        u = [loop.U[k - d, j] if k >= d else 0.0 for j, d in enumerate(late)]
        X.append(_advance(plant, X[-1], np.array(u), k * dt, dt))
    return np.array(X)


def _advance(plant: Plant, X: np.ndarray, u: np.ndarray, t: float, dt: float) -> np.ndarray:
    span = (t, t + dt)
    one_step = {"first_step": span[1] - t, "rtol": 1e-10, "atol": 1e-12}  # not smaller ones unless the error asks
    solved = solve_ivp(lambda s, x: plant.f(x, u, s), span, X, "DOP853", **one_step)
    return solved.y[:, -1]


def box(plant: Plant, count: int) -> np.ndarray:
    """States of the plant's box, (count, n)."""
    ends = np.array([plant.box[name] for name in plant.states])
    return np.random.default_rng(3).uniform(ends[:, 0], ends[:, 1], (count, plant.n))


def derivatives_equal_differences(plant: Plant) -> None:
    """f_X, f_U and kappa' against differences of fourth order, on the box."""
    for X in box(plant, 20):
        u = plant.kappa(X)
        f_X, f_U = plant.jacobians(X, u)
        pairs = [
            (f_X, _differences(lambda x, u=u: plant.f(x, u), X)),
            (f_U, _differences(lambda v, X=X: plant.f(X, v), u)),
            (plant.kappa_jacobian(X), _differences(plant.kappa, X)),
        ]
        for derived, expected in pairs:
            np.testing.assert_allclose(derived, expected, rtol=1e-6, atol=1e-7)


def _differences(function, x: np.ndarray) -> np.ndarray:
    columns = []
    for k, unit in enumerate(np.eye(len(x))):
        h = 1e-3 * max(abs(x[k]), 1e-2)
        far, near = (function(x + s * h * unit) - function(x - s * h * unit) for s in (2, 1))
        columns.append((8 * near - far) / (12 * h))
    return np.stack(columns, axis=-1)


def has_its_order(plant: Plant, method: str, D_hat: float, of_reading: int = 3) -> None:
    """Assert that a predictor has the order that it states, or at least that by which u is read."""
    fitted, stated = order(plant, method, D_hat), predictors.method(method).order
    assert fitted == pytest.approx(stated, abs=0.25) or (stated > of_reading and fitted > of_reading - 0.25)


def order(plant: Plant, method: str, D_hat: float) -> float:
    """The fitted order of a predictor's error at x = 1 against a fine grid, for a smooth input around kappa's."""
    X = box(plant, 5)
    intervals = [50, 100, 200]
    fine = _predict(plant, "rk4", 4000, X, D_hat)
    errors = [np.abs(_predict(plant, method, n, X, D_hat) - fine).max() for n in intervals]
    return -np.polyfit(np.log(intervals), np.log(errors), 1)[0]


def _predict(plant: Plant, method: str, intervals: int, X: np.ndarray, D_hat: float) -> np.ndarray:
    middle = plant.u_equilibrium if plant.rests else np.zeros(plant.m)
    u = means(lambda x: middle + 0.3 * np.sin(3 * x + 1)[..., None], intervals + 1)
    return predictors.numerical(method, plant, intervals + 1)(X, u, D_hat)[:, -1]
