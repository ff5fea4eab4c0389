"""An activator and its repressor, delay unknown, the actuator's line measured: the loop of the notebook of [DAPF].

The notebook has U = max(kappa, 0), the article's text U = kappa. The loop as it is meant has the first, since the
published curves and numbers are the notebook's; rows with "U < 0 too" have the second.

Bhan, Krstic, Shi, Delay-adaptive Control of Nonlinear Systems with Approximate Neural Operator Predictors,
arXiv:2508.20367.
"""

from functools import partial
from typing import Any

import numpy as np

import npred
from npred import plants
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant
from npred_experiments import latency, quirks
from npred_experiments.experiment import (
    AS_MEANT,
    AS_PUBLISHED,
    Experiment,
    Measured,
    Measurements,
    PublishedNumber,
    networks,
    published_times,
)
from npred_experiments.loop_networks import LoopNetworks
from npred_experiments.network_loop import Called, NetworkLoop, Predict

D, D_HAT, X0, DT, DX, NODES, STEPS = 1.0, 2.0, (0.03, 30.0), 0.005, 0.01, 100, 20000
OTHERS, COARSE = 300, 0.02  # runs to learn from, and their step
GAMMA, B, BOUNDS, SET = 1000.0, 1.0, (0.1, 4.0), (0.0939, 5.2525)
CLIPPED, FREE = (0.0, np.inf), (-np.inf, np.inf)  # the bounds of U
ENDS = ("x1(100)", "x2(100)", "D_hat(100)")
FREE_ENDS = tuple(f"{name}, U < 0 too" for name in ENDS)


def rates_on_both(X: quirks.State, u: Any) -> quirks.State:
    """f as coded: the input enters both states; right is x1 alone."""
    return _rates(X, u[0], u[0])


def rates_on_first(X: quirks.State, u: Any) -> quirks.State:
    """f of the article's text."""
    return _rates(X, u[0], 0.0)


def _rates(X: quirks.State, first: Any, second: Any) -> quirks.State:
    x, y = X
    square = x * x
    return (
        -x + (300 * square + 0.04) / (1 + square + y * y) + first,
        -y / 2 + (300 * square + 0.004) / (1 + square) + second,
    )


def kappa(x: Any, y: Any) -> Any:
    """f1(x*) - f1(x)."""
    return _activation(*SET) - _activation(x, y)


def _activation(x: Any, y: Any) -> Any:
    return (300 * x**2 + 0.04) / (1 + x**2 + y**2)


def right_slopes(x: Any, y: Any) -> tuple[Any, Any, Any, Any]:
    """∂f1/∂x1 and ∂f1/∂x2 of the activation in f, and the two derivatives of kappa."""
    q, top = 1 + x**2 + y**2, 300 * x**2 + 0.04
    by_x, by_y = (600 * x * q - 2 * x * top) / q**2, -2 * y * top / q**2
    return by_x, by_y, -by_x, -by_y


def published_slopes(x: Any, y: Any) -> tuple[Any, Any, Any, Any]:
    """The same as coded: x2² for x2 in the second; in kappa's first a 1 too many and a factor x1 too few."""
    q, top = 1 + x**2 + y**2, 300 * x**2 + 0.04
    by_x, by_y, _, kappa_y = right_slopes(x, y)
    return by_x, y * by_y, -(-1 + (600 * x * q - 2 * top) / q**2), kappa_y


def published_loop(
    f: Any = rates_on_both,
    slopes: Any = published_slopes,
    gamma: float = GAMMA,
    steps: int = STEPS,
    predict: Predict | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """X (steps, 2) and D_hat (steps,) of the loop as coded; other f and slopes show the effect of each error.

    Another predictor may replace the published rule.
    """
    X, D_hat = np.empty((steps, 2)), np.empty(steps)
    state, estimate, line = X0, D_HAT, np.zeros((NODES, 1))
    X[0], D_hat[0] = state, estimate
    for i in range(1, steps):
        if predict is None:
            P = quirks.half_cell_short(f, state, line.tolist(), estimate, DX)
        else:
            P = predict(np.array([state]), line[None], np.array([estimate]), 0.0)[0].tolist()
        phi = _update(f, slopes, state, line[:, 0], np.array(P), estimate)
        estimate = min(max(estimate + DT * gamma * phi, BOUNDS[0]), BOUNDS[1])
        line = quirks.upwind(line, DT / (D * DX), max(kappa(*P[-1]), 0.0))
        rates = f(state, (float(line[0, 0]),))
        state = (state[0] + DT * rates[0], state[1] + DT * rates[1])
        X[i], D_hat[i] = state, estimate
    return X, D_hat


def _update(f: Any, slopes: Any, X: quirks.State, u: np.ndarray, P: np.ndarray, D_hat: float) -> float:
    """φ: the transition matrix by Euler's method on the grid, the integrals by the trapezoidal rule."""
    x, y = P.T
    by_x, by_y, kappa_x, kappa_y = slopes(x, y)
    lower = (600 * x * (1 + x**2) - 2 * x * (300 * x**2 + 0.004)) / (1 + x**2) ** 2
    first, second = f(X, (float(u[0]),))
    carried, scale = [(first, second)], DX * D_hat
    for a, b, c in zip((-1 + by_x).tolist(), by_y.tolist(), lower.tolist(), strict=True):
        first, second = first + scale * (a * first + b * second), second + scale * (c * first - second / 2)
        carried.append((first, second))
    r = np.array(carried[:-1])
    w, weight = u - kappa(x, y), 1 + DX * np.arange(NODES)
    q1 = kappa_x * r[:, 0] + kappa_y * r[:, 1]
    distance = (X[0] - SET[0]) ** 2 + (X[1] - SET[1]) ** 2
    norm = 1 + distance + B * np.trapezoid(weight * w**2, dx=DX)
    return float(-np.trapezoid(weight * q1 * w, dx=DX) / norm)


def plant() -> Plant:
    """npred's activator and repressor."""
    return plants.resolve("activator_repressor")


def meant(predictor: npred.Predictor | None = None, limits: tuple[float, float] = CLIPPED) -> tuple[float, ...]:
    """The end of npred's loop: right plant and derivatives, exact transport, U within the limits."""
    rk4 = npred.predictor(plant(), "rk4", nx=NODES + 1)
    loop = meant_loop(predictor or rk4, D_HAT, X0, (STEPS - 1) * DT, limits=limits)
    return (*loop.X[-1].tolist(), float(loop.D_hat[-1]))


def meant_loop(
    predictor: npred.Predictor, D_hat: Any, start: Any, t_end: float, dt: float = DT,
    limits: tuple[float, float] = CLIPPED,
) -> Trajectories:  # fmt: skip
    """That loop, or loops side by side."""
    return npred.simulate(
        predictor.plant, predictor, D=D, D_hat=D_hat, X0=start, t_end=t_end, dt=dt,
        adaptation=npred.DelayAdaptation(gamma=GAMMA, b=B, bounds=BOUNDS), input_bounds=limits, u0=0.0,
    )  # fmt: skip


def measure() -> Measurements:
    """The end of the loop, t = 99.995 s."""
    X, D_hat = published_loop()
    ends = (*X[-1].tolist(), float(D_hat[-1]))
    free = zip(FREE_ENDS, meant(limits=FREE), strict=True)
    rows = {name: Measured(*pair) for name, *pair in zip(ENDS, ends, meant(), strict=True)}
    return rows | {name: Measured(None, end) for name, end in free}


def explore(nx: int, predict: Predict, rng: np.random.Generator) -> None:
    """npred's loops from the box that the source trains in, for 60 s, with other first estimates."""
    start = np.array(X0) + rng.uniform(-1, 1, (OTHERS, 2)) * (0.02, 5.0)
    meant_loop(Called(plant(), nx, predict), rng.uniform(0.3, 2.2, OTHERS), start, 3000 * COARSE, COARSE)


def by_network(predict: Predict) -> dict[str, float]:
    """The end of the published loop."""
    X, D_hat = published_loop(predict=predict)
    return dict(zip(ENDS, (*X[-1].tolist(), float(D_hat[-1])), strict=True))


def by_network_meant(predict: Predict) -> dict[str, float]:
    """The end of the loop as it is meant."""
    return dict(zip(ENDS, meant(Called(plant(), NODES + 1, predict)), strict=True))


LOOPS = {
    AS_PUBLISHED: NetworkLoop(
        plant,
        lambda: quirks.in_rows(rates_on_both, DX),
        partial(explore, NODES),
        by_network,
        calls=3000,
        nodes=34,
        anchor="equilibrium",
    ),
    AS_MEANT: NetworkLoop(
        plant,
        lambda: npred.predictor(plant(), "rk4", nx=NODES + 1).predict,
        partial(explore, NODES + 1),
        by_network_meant,
        calls=3000,
        nodes=26,
        anchor="equilibrium",
    ),
}
EXPERIMENT = Experiment(
    "activator and repressor, delay unknown",
    "Bhan, Krstic, Shi, arXiv:2508.20367",
    tuple(PublishedNumber(name, "") for name in (*ENDS, *FREE_ENDS)),
    measure,
    (
        *networks(ENDS[0], deeponet="0.09496809", fno=""),
        *networks(ENDS[1], deeponet="5.39436828", fno=""),
        *networks(ENDS[2], deeponet="", fno=""),
    ),
    LoopNetworks(LOOPS, {network: {"loss": "kappa"} for network in ("deeponet", "fno")}),
    times=published_times("Euler, 100 steps", numerical=1.601, fno=1.331, deeponet=0.496),
    clock=partial(latency.of_loop, LOOPS[AS_MEANT], latency.METHODS),
)
