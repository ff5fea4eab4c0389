"""Five joints of a Baxter arm that follow a wave, every torque 0.5 s late.

Bhan, Krstic, Shi, Neural Operators for Predictor Feedback Control of Nonlinear Delay Systems, arXiv:2411.18964.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from npred import plants
from npred_experiments import baxter, latency, quirks
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
from npred_experiments.network_loop import NetworkLoop, Predict
from npred_robots import denavit_hartenberg, rigid_body

RUNS, SAMPLES, DT, LATE = 25, 100, 0.1, 5
OTHERS = 300  # runs to learn from, in each round
MIDDLE = (baxter.LOW + baxter.HIGH) / 2
SPIN = np.concatenate([baxter.LOW, -baxter.FASTEST]), np.concatenate([baxter.HIGH, baxter.FASTEST])

Dynamics = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


def draws() -> np.ndarray:
    """X0 (25, 10) of the published runs."""
    (noise,) = quirks.uniform(np.random.RandomState(1), RUNS, (-0.2, 0.2, 5))
    return np.concatenate([MIDDLE + noise.T, np.zeros((RUNS, 5))], axis=1)


def reference(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The wave, its rate and its acceleration, the same for all joints."""
    return MIDDLE + 0.1 * np.sin(t), np.full(5, 0.1 * np.cos(t)), np.full(5, -0.1 * np.sin(t))


def spun(h: np.ndarray, x: np.ndarray) -> np.ndarray:
    """h · x for every joint, (..., 5): h is the vector of Coriolis torques, which the code takes for their matrix."""
    return np.repeat((h * x).sum(axis=-1, keepdims=True), 5, axis=-1)


class PublishedArm:
    """q'' = M⁻¹ (τ - (h · q') 1 - G) and the law that makes it linear, torques within their limits."""

    def __init__(self, dynamics: Dynamics) -> None:
        self.dynamics = dynamics

    def rate(self, X: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """X'."""
        q, rates = X[..., :5], X[..., 5:]
        M, h, G = self.dynamics(q, rates)
        return np.concatenate([rates, _solved(M, torque - self.drag(h, rates) - G)], axis=-1)

    def drag(self, h: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """The torque that the plant has for that of Coriolis."""
        return spun(h, rates)

    def law(self, X: np.ndarray, target: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
        """The torques for a state and the reference of its time, clipped."""
        q, rates = X[..., :5], X[..., 5:]
        M, h, G = self.dynamics(q, rates)
        e1 = target[0] - q
        e2 = target[1] - rates + e1
        more = spun(h, target[1]) + G + spun(h, e1) - spun(h, e2)
        pull = target[2] - e1 + _solved(M, more) + 2 * e2
        return np.clip((M @ pull[..., None])[..., 0], -baxter.STRONGEST, baxter.STRONGEST)


class RightArm(PublishedArm):
    """M q'' + h + G = τ with τ = M (q_d'' - e1 + 2 e2) + h + G, so that e'' = -2 e' - e … without delay."""

    def drag(self, h: np.ndarray, rates: np.ndarray) -> np.ndarray:
        return h

    def law(self, X: np.ndarray, target: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
        q, rates = X[..., :5], X[..., 5:]
        M, h, G = self.dynamics(q, rates)
        e1 = target[0] - q
        pull = target[2] - e1 + 2 * (target[1] - rates + e1)
        return np.clip((M @ pull[..., None])[..., 0] + h + G, -baxter.STRONGEST, baxter.STRONGEST)


def _solved(M: np.ndarray, forces: np.ndarray) -> np.ndarray:
    return np.linalg.solve(M, forces[..., None])[..., 0]


def euler(arm: PublishedArm) -> Predict:
    """The predictor of the loop, Euler's method: P (B, 6, 10) of X (B, 10), u (B, 6, 5); none reads u's last row."""

    def predict(X: np.ndarray, u: np.ndarray, D: np.ndarray, t: Any) -> np.ndarray:
        nodes = [X]
        for k in range(LATE):
            nodes.append(advanced(arm, nodes[-1], u[:, k]))
        return np.stack(nodes, axis=1)

    return predict


def advanced(arm: PublishedArm, X: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A step of Euler's method."""
    return quirks.clipped(X + DT * arm.rate(X, torque), *SPIN)


def loop(
    arm: PublishedArm, predict: Predict | None = None, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """X and P, (100, 25, 10): Euler's method for plant and predictor, a gravity hold first, P in float32.

    No prediction is made in the first 0.5 s, when the law takes X itself. Another predictor may replace Euler's method,
    and other starts the published ones.
    """
    start = draws() if start is None else start
    predict, D, rest = predict or euler(arm), np.full(len(start), DT * LATE), np.zeros(5)
    torques = quirks.static_hold(arm.law(start, (start[:, :5], rest, rest)), LATE)
    X, P = np.empty((SAMPLES, *start.shape)), np.zeros((SAMPLES, *start.shape))
    X[0] = start
    for i in range(1, SAMPLES):
        P[i] = ahead = X[i - 1]
        if i > LATE:
            under_way = torques[i - 1 :]
            P[i] = ahead = predict(X[i - 1], np.stack([*under_way, under_way[-1]], axis=1), D, DT * (i - 1))[:, -1]
        torques.append(arm.law(ahead, reference(DT * (i + LATE - 1))))
        X[i] = advanced(arm, X[i - 1], torques[i - 1])
    return X, quirks.logged(P)


def tracking(X: np.ndarray) -> float:
    """The mean over the runs of the sum over the samples of |X - reference|."""
    goal = np.stack([np.concatenate(reference(DT * i)[:2]) for i in range(SAMPLES)])[:, None]
    return float(np.linalg.norm(X - goal, axis=-1).sum(axis=0).mean())


def prediction(X: np.ndarray, P: np.ndarray) -> float:
    """The mean of |P(t) - X(t + D)| where a prediction is made."""
    ahead = LATE - 1
    return float(np.linalg.norm(P[LATE + 1 : SAMPLES - ahead] - X[LATE + 1 + ahead :], axis=-1).mean())


def published() -> PublishedArm:
    """The arm as coded."""
    return PublishedArm(partial(baxter.dynamics, J=baxter.pseudo_inertia(about_centre=False)))


def right(about_centre: bool = True) -> PublishedArm:
    """The arm with its Coriolis vector and, by default, its inertia about the mass centres."""
    return RightArm(partial(baxter.dynamics, J=baxter.pseudo_inertia(about_centre)))


def recursive(about_centre: bool) -> Dynamics:
    """The matrices by npred's recursive algorithms: the same to rounding, and faster on many states."""
    bodies = denavit_hartenberg.bodies([link if about_centre else _about_frame(link) for link in baxter.TABLE])

    def dynamics(q: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        angles, speeds, rest = [*np.moveaxis(q, -1, 0)], [*np.moveaxis(rates, -1, 0)], [0.0] * baxter.LINKS
        M = [_stacked(row, angles) for row in rigid_body.mass_matrix(bodies, angles, np)]
        h = rigid_body.torques(bodies, angles, speeds, rest, 0.0, np)
        G = rigid_body.torques(bodies, angles, rest, rest, baxter.GRAVITY, np)
        return np.stack(M, axis=-2), _stacked(h, angles), _stacked(G, angles)

    return dynamics


def _stacked(parts: list[Any], angles: list[np.ndarray]) -> np.ndarray:
    return np.stack([part + np.zeros_like(angles[0]) for part in parts], axis=-1)


def _about_frame(link: denavit_hartenberg.Link) -> denavit_hartenberg.Link:
    """The link whose moments about its frame are those that the table has about its centre of mass."""
    x, y, z = link.centre
    moments = zip(link.moments, (y * y + z * z, x * x + z * z, x * x + y * y), strict=True)
    products = zip(link.products, (x * y, y * z, x * z), strict=True)
    less, more = ([number - link.mass * of for number, of in pairs] for pairs in (moments, products))
    return link._replace(moments=tuple(less), products=tuple(more))


def others(rng: np.random.Generator) -> np.ndarray:
    """Starts to learn from, a little wider than the published ones."""
    noise = rng.uniform(-0.22, 0.22, (OTHERS, baxter.LINKS))
    return np.concatenate([MIDDLE + noise, np.zeros_like(noise)], axis=1)


def metrics(X: np.ndarray, P: np.ndarray) -> dict[str, float]:
    """Both published metrics of a loop."""
    return {"tracking": tracking(X), "prediction": prediction(X, P)}


def measure() -> Measurements:
    """Both metrics; as meant in the same loop, whose Euler method is part of the set-up."""
    coded, meant = (metrics(*loop(arm)) for arm in (published(), right()))
    return {name: Measured(value, meant[name]) for name, value in coded.items()}


def _network_loop(arm: PublishedArm) -> NetworkLoop:
    """The loop of an arm, for networks."""
    return NetworkLoop(
        partial(plants.resolve, "baxter_arm5"),
        lambda: euler(arm),
        lambda predict, rng: loop(arm, predict, others(rng)),
        lambda predict: metrics(*loop(arm, predict)),
        calls=SAMPLES - LATE - 1,
        kept=SAMPLES - LATE - 1,
        spread=0.003,
        noise=0.01,
        rounds=4,
        quadratic=True,
    )


LOOPS = {
    AS_PUBLISHED: _network_loop(PublishedArm(recursive(about_centre=False))),
    AS_MEANT: _network_loop(RightArm(recursive(about_centre=True))),
}
LEARNING = {"loss": "kappa", "batch": 512, "epochs": 12}
BRANCH = {"basis": LATE + 1, "moments": LATE + 1}  # as many as the nodes that there are
EXPERIMENT = Experiment(
    "arm with five joints, constant delay",
    "Bhan, Krstic, Shi, arXiv:2411.18964",
    (PublishedNumber("tracking", "8.814358"), PublishedNumber("prediction", "0.000000")),
    measure,
    (
        *networks("tracking", fno="10.375936", deeponet="21.153382", fno_gru="13.684227", deeponet_gru="18.449608"),
        *networks("prediction", fno="0.009430", deeponet="0.174347", fno_gru="0.012214", deeponet_gru="0.043243"),
    ),
    LoopNetworks(
        LOOPS,
        {
            "deeponet": {**LEARNING, **BRANCH},
            "fno": {**LEARNING, "width": 48, "modes": 4},
            "deeponet_gru": {**LEARNING, "sizes": {**BRANCH, "steps": LATE}},
            "fno_gru": {**LEARNING, "sizes": {"width": 48, "modes": 4, "steps": LATE}},
        },
    ),
    times=(
        *published_times("Euler, 5 steps", numerical=10.11, fno=1.67, deeponet=0.38, fno_gru=1.82, deeponet_gru=0.55),
        *published_times(
            "Euler, 100 steps", numerical=205.31, fno=1.96, deeponet=0.49, fno_gru=2.05, deeponet_gru=0.77
        ),
    ),
    clock=partial(
        latency.of_loop,
        LOOPS[AS_MEANT],
        {
            "Euler, 5 steps": ("euler", LATE + 1),
            "Euler, 100 steps": ("euler", 101),
            "RK4, 5 steps": ("rk4", LATE + 1),
        },
    ),
)
