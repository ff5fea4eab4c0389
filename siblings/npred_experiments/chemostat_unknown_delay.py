"""A bioreactor, delay unknown, the actuator's state not measured: the controller knows its own commands alone.

Bhan, Krstic, Shi, Stabilization of nonlinear systems with unknown delays via delay-adaptive neural operator approximate
predictors, arXiv:2509.26443, law (82).
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

D_HAT, X0, DT, DX, NODES, STEPS = 1.8, (2.0, 2.0), 0.005, 0.01, 100, 5000
OTHERS = 200  # runs to learn from
GAMMA, BOUNDS, DELAYS = 1.0, (0.8, 2.0), (1.6, 1.4)
FEED, DEATH, SURPLUS, SET, U_SET = 2 + 10 / 3, 0.1, 10.0, (3.0, 2.0), 0.9


def f(X: quirks.State, u: Any) -> quirks.State:
    """Biomass and substrate."""
    Z, S = X
    growth = 3.5 * S / (1 + S + S * S)
    return (growth - DEATH - u[0]) * Z, u[0] * (FEED - S) - growth * Z


def kappa(Z: Any, S: Any) -> Any:
    """The law without delay; μ(S*) = 1."""
    growth = 3.5 * S / (1 + S + S**2)
    return U_SET * growth * Z / SET[0] + np.where(SET[1] >= S, SURPLUS * DEATH * np.abs(growth - 1) ** 1.5, 0.0)


def right_slopes(Z: Any, S: Any) -> tuple[Any, Any]:
    """∂kappa/∂Z and ∂kappa/∂S."""
    growth, slope = 3.5 * S / (1 + S + S**2), -3.5 * (S**2 - 1) / (1 + S + S**2) ** 2
    surplus = SURPLUS * DEATH * 1.5 * np.sqrt(np.abs(growth - 1)) * np.sign(growth - 1) * slope
    return U_SET * growth / SET[0], U_SET * slope * Z / SET[0] + np.where(SET[1] >= S, surplus, 0.0)


def published_slopes(Z: Any, S: Any) -> tuple[Any, Any]:
    """The same as coded: 0.5 for 3.5 in μ', the surplus on the wrong side of S*, and its sign -1 throughout."""
    growth, slope = 3.5 * S / (1 + S + S**2), -0.5 * (S**2 - 1) / (1 + S + S**2) ** 2
    surplus = -SURPLUS * DEATH * 1.5 * np.sqrt(np.abs(growth - 1)) * slope
    return U_SET * growth / SET[0], U_SET * slope * Z / SET[0] + np.where(SET[1] <= S, surplus, 0.0)


def published_loop(
    D: float, slopes: Any = published_slopes, steps: int = STEPS, D_hat: float = D_HAT, predict: Predict | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """X (steps, 2) and D_hat (steps,) of the loop as coded.

    The controller's commands move on a second line at 1 / D_hat: while D_hat changes they are not U(t + D_hat
    (x - 1)), for the factor 1 + (x - 1) dD_hat/dt of the line's equation is missing. Another predictor may replace the
    published rule.
    """
    X, estimates = np.empty((steps, 2)), np.empty(steps)
    state, estimate = X0, D_hat
    line = recalled = np.full((NODES, 1), float(kappa(*X0)))
    X[0], estimates[0] = state, estimate
    for i in range(1, steps):
        if predict is None:
            P = np.array(quirks.half_cell_short(f, state, recalled.tolist(), estimate, DX))
        else:
            P = predict(np.array([state]), recalled[None], np.array([estimate]), 0.0)[0]
        phi = _update(slopes, recalled[:, 0], P)
        estimate = min(max(estimate + DT * GAMMA * phi, BOUNDS[0]), BOUNDS[1])
        U = max(float(kappa(*P[-1])), 0.0)
        line = quirks.upwind(line, DT / (D * DX), U)
        recalled = quirks.upwind(recalled, DT / (estimate * DX), U)
        rates = f(state, (float(line[0, 0]),))
        state = (state[0] + DT * rates[0], state[1] + DT * rates[1])
        X[i], estimates[i] = state, estimate
    return X, estimates


def _update(slopes: Any, u: np.ndarray, P: np.ndarray) -> float:
    """φ of law (82), sgn(0) = 0."""
    Z, S = P.T
    by_Z, by_S = slopes(Z, S)
    first, second = f(tuple(P[0].tolist()), (float(u[0]),))
    q, w = by_Z * first + by_S * second, u - kappa(Z, S)
    q_x, w_x = (np.gradient(values, DX, edge_order=1) for values in (q, w))
    weight = 1 + DX * np.arange(NODES)
    integral = np.trapezoid(weight * (q * np.sign(w) + q_x * np.sign(w_x)), dx=DX)
    return float(2 * np.sign(w_x[-1]) * q[-1] + integral)


def plant() -> Plant:
    """npred's bioreactor."""
    return plants.resolve("chemostat")


def meant_loop(predictor: npred.Predictor, D: Any, D_hat: Any = D_HAT, start: Any = X0, dt: float = DT) -> Trajectories:
    """npred's loop by the same law, with right derivatives and the commands as they were sent."""
    return npred.simulate(
        predictor.plant, predictor, D=D, D_hat=D_hat, X0=start, t_end=STEPS * DT, dt=dt,
        adaptation=npred.L1Adaptation(gamma=GAMMA, b=1.0, bounds=BOUNDS, epsilon=0.0), actuator="history", u0="law",
    )  # fmt: skip


def meant(D: float, dt: float = DT, predictor: npred.Predictor | None = None) -> tuple[float, ...]:
    """The end of that loop. It depends on dt: signs at nodes and steps have no limit, and another dt ends elsewhere."""
    loop = meant_loop(predictor or npred.predictor(plant(), "rk4", nx=NODES + 1), D, dt=dt)
    return (*loop.X[-1].tolist(), float(loop.D_hat[-1]))


def measure() -> Measurements:
    """The end of the loop, t = 25 s, for both delays."""
    rows: dict[str, Measured] = {}
    for D in DELAYS:
        X, D_hat = published_loop(D)
        ends = (*X[-1].tolist(), float(D_hat[-1]))
        rows |= {name: Measured(*pair) for name, *pair in zip(_names(D), ends, meant(D), strict=True)}
    return rows


def _names(D: float) -> list[str]:
    return [f"{quantity}(25), D = {D:g}" for quantity in ("Z", "S", "D_hat")]


def explore(nx: int, predict: Predict, rng: np.random.Generator) -> None:
    """npred's loops from other starts, with other delays and first estimates."""
    start = np.array(X0) + rng.uniform(-0.3, 0.3, (OTHERS, 2))
    delays, estimates = rng.uniform(1.2, 1.8, OTHERS), rng.uniform(*BOUNDS, OTHERS)
    meant_loop(Called(plant(), nx, predict), delays, estimates, start)


def by_network(predict: Predict) -> dict[str, float]:
    """The ends of the published loops."""
    ends = {D: published_loop(D, predict=predict) for D in DELAYS}
    return _ends({D: (*X[-1].tolist(), float(D_hat[-1])) for D, (X, D_hat) in ends.items()})


def by_network_meant(predict: Predict) -> dict[str, float]:
    """The ends of the loops as they are meant."""
    return _ends({D: meant(D, predictor=Called(plant(), NODES + 1, predict)) for D in DELAYS})


def _ends(ends: dict[float, tuple[float, ...]]) -> dict[str, float]:
    return {name: value for D, values in ends.items() for name, value in zip(_names(D), values, strict=True)}


LOOPS = {
    AS_PUBLISHED: NetworkLoop(
        plant,
        lambda: quirks.in_rows(f, DX),
        partial(explore, NODES),
        by_network,
        calls=STEPS,
        nodes=34,
        anchor="equilibrium",
    ),
    AS_MEANT: NetworkLoop(
        plant,
        lambda: npred.predictor(plant(), "rk4", nx=NODES + 1).predict,
        partial(explore, NODES + 1),
        by_network_meant,
        calls=STEPS,
        nodes=26,
        anchor="equilibrium",
    ),
}
EXPERIMENT = Experiment(
    "chemostat, delay unknown, actuator not measured",
    "Bhan, Krstic, Shi, arXiv:2509.26443",
    tuple(PublishedNumber(name, "") for D in DELAYS for name in _names(D)),
    measure,
    tuple(row for D in DELAYS for name in _names(D) for row in networks(name, fno="", deeponet="")),
    LoopNetworks(LOOPS),
    times=published_times("Euler, 100 steps", numerical=1.40, fno=1.28, deeponet=0.34),
    clock=partial(latency.of_loop, LOOPS[AS_MEANT], latency.METHODS),
)
