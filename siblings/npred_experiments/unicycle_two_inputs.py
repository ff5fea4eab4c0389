"""A wheeled robot whose steering arrives 0.25 s late and whose speed 0.6 s.

Bajraktari, Bhan, Krstic, Shi, Delay compensation of multi-input distinct delay nonlinear systems via neural operators,
arXiv:2509.17131; law and predictors of Bekiaris-Liberis and Krstic, IEEE TAC 62 (2017) 516-531, whose example with the
delays 0.5 and 1 s gives the first commands.
"""

from functools import partial
from typing import Any

import numpy as np

import npred
from npred import plants
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant
from npred_experiments import latency, pomet, quirks
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

D1, D2, DT, STEPS, NODES, DX = 0.25, 0.6, 0.001, 10000, 101, 0.01
OTHERS, EXPLORED = 60, 6000  # runs to learn from, and their steps
HELD = {0.04: "0.00541761", 0.02: "0.00271765", 0.01: "0.00134828"}  # |P2 - X| of a public re-implementation, by dt
DRAWS = 25  # as many as the article says; the notebook draws five, without a seed


def starts() -> np.ndarray:
    """(1, 1, 1), then draws from the source's box, (3, 26)."""
    draws = np.random.RandomState(0).uniform(-0.2, 0.2, (DRAWS, 3))
    return np.concatenate([np.ones((1, 3)), 1.0 + draws]).T


def published_loop(
    X0: np.ndarray, steers: bool = False, steps: int = STEPS, predict: Predict | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """X and P2, (steps + 1, 3, B): beyond 0.25 s the predictor takes ω = 0, for its line ends there.

    Right is ω = κ_1(P2), the steering that will be sent by then; `steers=True` takes that. Another predictor may make
    both predictions, one after the other.
    """
    X, batch = X0.copy(), X0.shape[1]
    turns, speeds, far = (np.zeros((NODES, batch)) for _ in range(3))
    record, predictions = np.empty((2, steps + 1, *X0.shape))

    def prediction(t: float) -> tuple[quirks.State, quirks.State]:
        if predict is None:
            return _predicted(X, turns, speeds, far, t, steers)
        near = _asked(predict, X, speeds, turns, D1, t)
        return tuple(near), tuple(_asked(predict, near, far, np.zeros_like(far), D2 - D1, t))

    ahead = prediction(0.0)
    for k in range(steps + 1):
        t, record[k], predictions[k] = k * DT, X, ahead[1]
        turn, speed = pomet.right_law(ahead[0], t + D1)[1], pomet.right_law(ahead[1], t + D2)[0]
        X = X + DT * np.stack(pomet.f(tuple(X), (speeds[0], turns[0])))
        far = quirks.upwind(far, DT / ((D2 - D1) * DX), speed)
        speeds = quirks.upwind(speeds, DT / (D1 * DX), far[0])
        turns = quirks.upwind(turns, DT / (D1 * DX), turn)
        ahead = prediction(t + DT)
    return record, predictions


def _asked(predict: Predict, X: np.ndarray, speeds: np.ndarray, turns: np.ndarray, D: float, t: float) -> np.ndarray:
    """P(1), (3, B), of a predictor that is asked in rows."""
    return predict(X.T, np.stack([speeds, turns]).transpose(2, 1, 0), np.full(X.shape[1], D), t)[:, -1].T


def _predicted(
    X: np.ndarray, turns: np.ndarray, speeds: np.ndarray, far: np.ndarray, t: float, steers: bool
) -> tuple[quirks.State, quirks.State]:
    """P1 and P2 by the rule that ends half a cell short."""
    near = _swept(tuple(X), speeds, turns, D1)
    if not steers:
        return near, _swept(near, far, np.zeros_like(far), D2 - D1)

    def f(P: quirks.State, inputs: Any) -> quirks.State:
        speed, clock = inputs
        return pomet.f(P, (speed, pomet.right_law(P, clock)[1]))

    clocks = t + D1 + (D2 - D1) * DX * np.arange(NODES)
    return near, quirks.half_cell_short(f, near, list(zip(far, clocks, strict=True)), D2 - D1, DX)[-1]


def _swept(X: quirks.State, speeds: np.ndarray, turns: np.ndarray, D: float) -> quirks.State:
    """The last node of quirks.half_cell_short for inputs that do not depend on P, by sums: the angle first."""
    weights = np.full(NODES - 1, D * DX)
    weights[-1] /= 2
    angles = X[2] + (D * DX) * (np.cumsum(turns[:-1], axis=0) - 0.5 * turns[:-1])  # at nodes 1, 2, …
    before = np.concatenate([X[2][None], angles[:-1]])
    return (
        X[0] + weights @ (speeds[:-1] * np.cos(before)),
        X[1] + weights @ (speeds[:-1] * np.sin(before)),
        angles[-1],
    )


def norm(X: np.ndarray, step: float) -> np.ndarray:
    """√∫|X|² dt of each run, for samples (N, 3, ...) a `step` apart; the source takes dx = 0.01 for dt = 0.001."""
    return np.sqrt(np.trapezoid((X**2).sum(axis=1), dx=step, axis=0))


def plant() -> Plant:
    """The robot with both delays, as it is meant."""
    return plants.resolve("unicycle")


def rk4() -> npred.Predictor:
    """npred's numerical predictor, which networks of the loop as it is meant learn."""
    return npred.predictor(plant(), "rk4", nx=NODES)


def meant(X0: np.ndarray, predictor: npred.Predictor | None = None, dt: float = DT) -> np.ndarray:
    """The L2 norms of the runs as npred simulates them, exact transport and both predictors right."""
    predictor = predictor or rk4()
    loop = npred.simulate(predictor.plant, predictor, D=D2, D_hat=D2, X0=X0.T, t_end=STEPS * DT, dt=dt)
    return norm(np.moveaxis(loop.X, 0, -1), dt)


def slow_law(X: quirks.State, t: Any, M: Any) -> tuple[Any, Any]:
    """(ω, v) of the example of IEEE TAC 62 (2017)."""
    ahead, aside = X[0] * M.cos(X[2]) + X[1] * M.sin(X[2]), X[0] * M.sin(X[2]) - X[1] * M.cos(X[2])
    omega = -(ahead**2) * M.cos(t) - ahead * aside * (1 + M.cos(t) ** 2) - X[2]
    return omega, -ahead + aside * (M.sin(t) - M.cos(t)) + aside * omega


def first_commands(nodes: int = 2000) -> tuple[float, float]:
    """U1(0+) and U2(0+) of that example from (0.5, 0.5, 0.5) with zero inputs before, by the classical Runge-Kutta
    method: the robot stands still for 0.5 s and then turns on the spot by κ_1(P2).
    """
    step, theta = 0.5 / nodes, 0.5

    def rate(t: float, angle: float) -> float:
        return slow_law((0.5, 0.5, angle), t, np)[0]

    for k in range(nodes):
        t = 0.5 + k * step
        a = rate(t, theta)
        b = rate(t + step / 2, theta + step / 2 * a)
        c = rate(t + step / 2, theta + step / 2 * b)
        theta += step / 6 * (a + 2 * b + 2 * c + rate(t + step, theta + step * c))
    X = (0.5, 0.5, theta)
    return float(rate(0.5, 0.5)), float(slow_law(X, 1.0, np)[1])


def slow_loop(dt: float, t_end: float, nodes: int = NODES) -> Trajectories:
    """That example by npred, U held over each step of dt."""
    plant = npred.plant("slow_unicycle")
    predictor = npred.predictor(plant, "rk4", nx=nodes)
    return npred.simulate(plant, predictor, D=1.0, D_hat=1.0, X0=[0.5, 0.5, 0.5], t_end=t_end, dt=dt)


def held_law(dt: float) -> float:
    """The largest |P2(t) - X(t + 1)|, component by component, up to 100 s: P takes the law where the robot holds U."""
    loop, ahead = slow_loop(dt, 100.0, 2 * NODES - 1), round(1.0 / dt)
    return float(np.abs(loop.P[:-ahead] - loop.X[ahead:]).max())


def first_commands_meant() -> tuple[float, float]:
    """The same by npred's loop."""
    loop = slow_loop(0.01, 0.01)
    return float(loop.U[0, 0]), float(loop.U[0, 1])


def held_row(dt: float) -> str:
    """The name of a row: U is held over dt."""
    return f"|P2 - X|, TAC 2017, U held {dt:g} s"


def measure() -> Measurements:
    """The L2 norms and the first commands."""
    X0 = starts()
    published, right = norm(published_loop(X0)[0], DX), meant(X0)
    commands = zip(first_commands(), first_commands_meant(), strict=True)
    return {
        "L2": Measured(float(published[1:].mean()), float(right[1:].mean())),
        "L2 from (1, 1, 1)": Measured(float(published[0]), float(right[0])),
    } | (
        {f"U{k}(0+), TAC 2017": Measured(*pair) for k, pair in enumerate(commands, 1)}
        | {held_row(dt): Measured(None, held_law(dt)) for dt in HELD}
    )


def others(rng: np.random.Generator) -> np.ndarray:
    """Starts to learn from, (3, 60), from a box 1.5 times as wide as that of the runs."""
    return 1.0 + rng.uniform(-0.3, 0.3, (3, OTHERS))


def by_network(predict: Predict) -> dict[str, float]:
    """The norms as published, of the published loop."""
    norms = norm(published_loop(starts(), predict=predict)[0], DX)
    return {"L2": float(norms[1:].mean()), "L2 from (1, 1, 1)": float(norms[0])}


def by_network_meant(predict: Predict) -> dict[str, float]:
    """The norms as they are meant."""
    norms = meant(starts(), Called(plant(), NODES, predict))
    return {"L2": float(norms[1:].mean()), "L2 from (1, 1, 1)": float(norms[0])}


LOOPS = {
    AS_PUBLISHED: NetworkLoop(
        pomet.plant,
        lambda: pomet.half_cell_short,
        lambda predict, rng: published_loop(others(rng), steps=EXPLORED, predict=predict),
        by_network,
        calls=2 * EXPLORED,
        kept=300,
        nodes=26,
        reads_end=True,
    ),
    AS_MEANT: NetworkLoop(
        plant,
        lambda: rk4().predict,
        lambda predict, rng: meant(others(rng), Called(plant(), NODES, predict), dt=10 * DT),
        by_network_meant,
        calls=STEPS // 10,
        kept=300,
        nodes=26,
    ),
}
EXPERIMENT = Experiment(
    "wheeled robot, two inputs with distinct delays",
    "Bajraktari, Bhan, Krstic, Shi, arXiv:2509.17131; Bekiaris-Liberis, Krstic, IEEE TAC 62 (2017) 516-531",
    (
        PublishedNumber("L2", "5.1311"),
        PublishedNumber("L2 from (1, 1, 1)", ""),
        PublishedNumber("U1(0+), TAC 2017", "-0.664906519"),
        PublishedNumber("U2(0+), TAC 2017", "-0.645494470"),
        *(PublishedNumber(held_row(dt), digits) for dt, digits in HELD.items()),
    ),
    measure,
    (*networks("L2", fno="5.1436", deeponet="4.8737"), *networks("L2 from (1, 1, 1)", fno="", deeponet="")),
    LoopNetworks(LOOPS),
    times=published_times("Euler, 100 steps", numerical=8.762, fno=30.850, deeponet=7.245),
    clock=partial(latency.of_loop, LOOPS[AS_MEANT], latency.METHODS),
)
