"""Wherever a public function takes an array it takes a list and a tuple of the same numbers, with the same result."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st

import npred
from npred.base.errors import ConfigError

PLANT = npred.plant("activator_repressor")
SCALAR = npred.plant("scalar")
TRACKS = npred.plant("unicycle")
RK4 = npred.predictor(PLANT, "rk4", 11)
LOOP = {"D": 0.1, "D_hat": 0.1, "t_end": 0.3, "dt": 0.01}
X0, U = np.array([0.05, 10.0]), np.linspace(0.0, 0.1, 11)[:, None]


class Limited:
    """A mass that must not pass x = 1; its position is measured."""

    states, inputs, guess = ("x", "v"), ("a",), (0.0, 0.0)
    outputs = ("x",)
    box = {"x": (-1.0, 0.5), "v": (-1.0, 1.0)}
    f = lambda x, u, t, p, M: [x.v, u.a]
    kappa = lambda x, t, p, M: [-x.x - x.v]
    safe = lambda x, t, p, M: [1 - x.x]
    output = lambda x, t, p, M: [x.x]


MASS = npred.plants.Plant("mass", Limited)


def tuples(value: Any) -> Any:
    return tuple(map(tuples, value)) if isinstance(value, list) else value


def simulated(X0: Any, D: Any, D_hat: Any, bounds: Any, u0: Any, **more: Any) -> Any:
    about = {"t_end": 0.3, "dt": 0.01, "input_bounds": bounds, "u0": u0} | more
    return npred.simulate(PLANT, RK4, X0=X0, D=D, D_hat=D_hat, **about).X


def controlled(X: Any, u: Any, bounds: Any) -> Any:
    controller = npred.controller(PLANT, RK4, None, 0.01, D_hat=0.1, input_bounds=bounds, actuator="measured")
    return np.append(controller.step(X, u), controller.P)


def recalled(X: Any, u0: Any, applied: Any) -> Any:
    controller = npred.controller(PLANT, RK4, None, 0.01, D_hat=0.1, actuator="history", u0=u0)
    controller.step(X)
    return controller.step(X, applied=applied).copy()


def observed(Q: Any, R: Any, X0: Any, P0: Any) -> Any:
    ekf = npred.observers.EKF(MASS, Q=Q, R=R, X0=X0, P0=P0)
    predictor = npred.predictor(MASS, "rk4", 11)
    return npred.simulate(MASS, predictor, X0=[0.3, 0.0], observer=ekf, actuator="history", **LOOP).X


def measured(noise: Any, absolute: Any, bias: Any, resolution: Any) -> Any:
    sensors = npred.Measurement(relative_noise=noise, noise=absolute, bias=bias, resolution=resolution, seed=1)
    return npred.simulate(PLANT, RK4, X0=[0.05, 10.0], measurement=sensors, **LOOP).X


def guarded(X: Any, u: Any, D_hat: Any, t: Any) -> Any:
    guard = npred.guarded(npred.predictor(PLANT, "euler", 11), 0.01)
    judged = guard.judge(guard(X, u, D_hat, t).tolist(), X, u, D_hat, t)
    numbers = (guard.error(X, u, D_hat, t), guard.fallback(X, u, D_hat, t), *judged)
    return np.stack([np.asarray(n, dtype=float) for n in numbers])


def identified(t: Any, U: Any, X: Any, bounds: Any) -> Any:
    return npred.identify(SCALAR, t, U, X, free=["a"], bounds={"a": bounds}).D


def watched(send: Any) -> Any:
    controller = npred.controller(
        PLANT, RK4, None, 0.01, D_hat=0.1, actuator="history", watchdog=npred.Watchdog(0.02, send)
    )
    controller.step(X0)
    return np.array([controller.step().copy() for _ in range(5)])


def recording() -> tuple[np.ndarray, ...]:
    run = npred.simulate(
        SCALAR, npred.predictor(SCALAR, "rk4", 11), D=0.3, D_hat=0.3, X0=[1.0], t_end=10.0, dt=0.02,
        disturbance=lambda t: [0.3 * np.sin(2 * t)],
    )  # fmt: skip
    return run.t, run.U + 0.3 * np.sin(2 * run.t)[:, None], run.X


RECORDING = recording()
LIMITS, PAST = np.array([[-1.0, 1.0]]), np.array([0.01])
CALLS: dict[str, tuple[Callable[..., Any], tuple[np.ndarray, ...]]] = {
    "predictor": (RK4, (X0, U, np.array(0.1), np.array(0.0))),
    "predictor of a batch": (RK4, (np.stack([X0, X0]), np.stack([U, U]), np.array([0.1, 0.2]), np.zeros(2))),
    "simulate": (simulated, (X0, np.array([0.1, 0.2]), np.array([0.1, 0.1]), LIMITS, PAST)),
    "simulate, samples": (
        lambda steps: npred.simulate(PLANT, RK4, X0=X0, samples=steps, **LOOP).samples.u,
        (np.array([1, 5]),),
    ),
    "simulate, a history of inputs": (simulated, (X0, np.array(0.1), np.array(0.1), LIMITS, np.array([[0.0], [0.1]]))),
    "controller": (controlled, (X0, U, LIMITS)),
    "controller, its own commands": (recalled, (X0, PAST, np.array([0.02]))),
    "delay law": (lambda bounds: npred.DelayAdaptation(10.0, 1.0, bounds).bounds, (np.array([0.1, 0.4]),)),
    "observer of the delay": (
        lambda bounds: npred.simulate(PLANT, RK4, X0=X0, **LOOP, adaptation=npred.DelayObserver(bounds=bounds)).D_hat,
        (np.array([0.05, 0.4]),),
    ),
    "measurement": (measured, (np.array([0.01, 0.0]), *[np.array([0.0, 0.1])] * 3)),
    "EKF": (observed, (np.array([0.1, 0.1]), np.array([0.01]), np.array([0.1, 0.1]), np.array([1.0, 1.0]))),
    "EKF, matrices": (observed, (0.1 * np.eye(2), np.array([0.01]), np.array([0.1, 0.1]), np.eye(2))),
    "guard": (guarded, (X0, U, np.array(0.1), np.array(0.0))),
    "guard of a batch": (guarded, (np.stack([X0, X0]), np.stack([U, U]), np.array([0.1, 0.2]), np.zeros(2))),
    "watchdog": (watched, (np.array([0.05]),)),
    "identify": (identified, (*RECORDING, np.array([0.1, 2.0]))),
    "identify, flat columns": (identified, (*(a.reshape(-1) for a in RECORDING), np.array([0.1, 2.0]))),
    "lqr": (lambda Q, R: npred.plant("scalar", kappa=npred.laws.lqr(SCALAR, Q, R)).kappa(np.array([1.0])),
            (np.array([[2.0]]), np.array([[1.0]]))),
    "lqr, diagonals": (lambda Q, R: npred.plant("scalar", kappa=npred.laws.lqr(SCALAR, Q, R)).kappa(np.array([1.0])),
                       (np.array([2.0]), np.array([1.0]))),
    "f": (lambda X, u: PLANT.f(X, u), (X0, np.array([0.1]))),
    "kappa": (lambda X: PLANT.kappa(X), (X0,)),
    "V": (lambda X: PLANT.V(X), (X0,)),
    "kappa over time": (lambda X, t: TRACKS.kappa(X, t), (np.zeros((2, TRACKS.n)), np.array([0.0, 1.0]))),
    "safe": (lambda X: MASS.safe(X, 0.0), (np.zeros((3, 2)),)),
    "target": (lambda t: TRACKS.target(t), (np.array([0.0, 1.0]),)),
    "target of the input": (lambda t: TRACKS.u_target(t), (np.array([0.0, 1.0]),)),
    "radius": (
        lambda X_star: npred.metrics.radius(npred.simulate(PLANT, RK4, X0=X0, **LOOP), X_star), (np.array([0.1, 5.0]),)
    ),
    "settle time": (
        lambda X_star: npred.metrics.settle_time(npred.simulate(PLANT, RK4, X0=X0, **LOOP), X_star),
        (np.array([0.1, 5.0]),),
    ),
    "errors": (
        lambda P_hat, P: npred.metrics.errors(PLANT, P_hat, P)["eps_sup"], (np.ones((2, 3, 2)), np.full((2, 3, 2), 2.0))
    ),
    "converged": (lambda radii, X_star: npred.metrics.converged(radii, X_star), (np.array([0.1, 9.0]), X0)),
    "W": (lambda N, D_hat: npred.lyapunov.W(N, 1.0, D_hat, 10.0, 1.0), (np.array([1.0, 2.0]), np.array([1.0, 0.5]))),
    "Gamma": (
        lambda X, X_star, energy, D_hat: npred.lyapunov.Gamma(X, X_star, energy, 1.0, D_hat),
        (np.ones((2, 2)), X0, np.zeros(2), np.ones(2)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_lists_and_tuples_are_taken_as_arrays_are(name):
    call, arrays = CALLS[name]
    expected = np.asarray(call(*arrays), dtype=float)
    assert expected.size
    for kind in (np.ndarray.tolist, lambda a: tuples(a.tolist())):
        np.testing.assert_array_equal(np.asarray(call(*map(kind, arrays)), dtype=float), expected)


def test_the_u_of_one_input_may_be_flat():
    flat = U[:, 0].tolist()
    np.testing.assert_array_equal(RK4(X0, flat, 0.1), RK4(X0, U, 0.1))
    np.testing.assert_array_equal(guarded(X0, flat, 0.1, 0.0), guarded(X0, U, 0.1, 0.0))
    np.testing.assert_array_equal(controlled(X0, flat, LIMITS), controlled(X0, U, LIMITS))
    with pytest.raises(ConfigError, match=r"u: expected shape \(..., nx, 2\) with nx >= 2, got \(11,\)"):
        npred.predictor(TRACKS, "rk4", 11)(np.zeros(TRACKS.n), flat, 0.1)


@settings(max_examples=40, deadline=None)
@drawn(st.integers(0, 4), st.integers(2, 9), st.data())
def test_any_mixture_of_lists_and_arrays(batch, nx, data):
    """A predictor and a loop of any batch, each argument an array or nested lists of it."""
    rng = np.random.default_rng(batch + 10 * nx)
    lead = (batch,) if batch else ()
    arrays = [rng.uniform(0.1, 1.0, (*lead, 2)), rng.uniform(0.0, 0.1, (*lead, nx, 1)), rng.uniform(0.1, 0.3, lead)]
    mixed = [a.tolist() if data.draw(st.booleans()) else a for a in arrays]
    np.testing.assert_array_equal(RK4(*mixed), RK4(*arrays))
    X0, _, D = mixed
    loops = [npred.simulate(PLANT, RK4, X0=x, D=d, D_hat=d, t_end=0.05, dt=0.01).X for x, d in ((X0, D), arrays[::2])]
    np.testing.assert_array_equal(*loops)
