"""What tests of observers share: plants with outputs, and calls of an observer's kernels."""

import numpy as np

from npred import plants
from npred.estimation.observers import Observer
from npred.plants import Plant


def plant_of(kind: type, **changes: float) -> Plant:
    return Plant(kind.__name__, kind, changes)


class Spring:
    """Linear: position q and speed s, a force U; the position is measured."""

    states, inputs = ("q", "s"), ("U",)
    box = {"q": (-1.0, 1.0), "s": (-2.0, 2.0)}
    outputs = ("position",)
    f = lambda x, u, t, p, M: [x.s, -2.0 * x.q - 0.3 * x.s + 1.5 * u.U]
    kappa = lambda x, t, p, M: [-x.s]
    output = lambda x, t, p, M: [x.q]


SPRING_A, SPRING_B, SPRING_C = np.array([[0.0, 1.0], [-2.0, -0.3]]), np.array([[0.0], [1.5]]), np.array([[1.0, 0.0]])


class Swing:
    """A pendulum of which a sine and a product are measured."""

    states, inputs = ("angle", "rate"), ("U",)
    box = {"angle": (-1.0, 1.0), "rate": (-2.0, 2.0)}
    outputs = ("height", "product")
    f = lambda x, u, t, p, M: [x.rate, -4.0 * M.sin(x.angle) - 0.2 * x.rate + u.U]
    kappa = lambda x, t, p, M: [-x.rate]
    output = lambda x, t, p, M: [M.sin(x.angle), x.rate * M.cos(x.angle) + x.angle]


def swing_slope(x, u):
    return np.array([x[1], -4.0 * np.sin(x[0]) - 0.2 * x[1] + u])


def swing_jacobian(x):
    return np.array([[0.0, 1.0], [-4.0 * np.cos(x[0]), -0.2]])


def swing_output(x):
    return np.array([np.sin(x[0]), x[1] * np.cos(x[0]) + x[0]])


def swing_output_jacobian(x):
    return np.array([[np.cos(x[0]), 0.0], [1.0 - x[1] * np.sin(x[0]), np.cos(x[0])]])


def built_in(name: str) -> Plant:
    return plants.resolve(name)


def follow(observer: Observer, memory: np.ndarray, U, dt: float, t: float = 0.0, after=None, share=1.0) -> None:
    """The memory on by dt with the input U for the share, then `after`."""
    m = observer.plant.m
    U0, U1, shares = (
        np.broadcast_to(np.asarray(a, dtype=float), m).reshape(m, 1).copy()
        for a in (U, U if after is None else after, share)
    )
    observer.follow(U0, U1, shares, dt, t, observer.plant.p, observer.settings, memory)


def correct(observer: Observer, memory: np.ndarray, Y, t: float = 0.0, gate: float = np.inf):
    """Innovation and spread of a sample, which corrects the memory."""
    innovation, spread = np.empty((2, len(observer.outputs)))
    Y = np.asarray(Y, dtype=float).reshape(-1, 1)
    observer.correct(Y, t, observer.plant.p, gate, observer.settings, memory, innovation, spread)
    return innovation, spread


def swing_in(time=1.0, angle=1.0, rate=1.0, input=1.0, outputs=(1.0, 1.0)) -> Plant:
    """The Swing in other units: a second is `time` of the new ones, a radian `angle`, and so on."""

    class Scaled(Swing):
        box = {"angle": (-angle, angle), "rate": (-2.0 * rate, 2.0 * rate)}

        def f(x, u, t, p, M):
            x1, x2 = x.angle / angle, x.rate / rate
            return [angle / time * x2, rate / time * (-4.0 * M.sin(x1) - 0.2 * x2 + u.U / input)]

        kappa = lambda x, t, p, M: [-input / rate * x.rate]

        def output(x, t, p, M):
            x1, x2 = x.angle / angle, x.rate / rate
            return [outputs[0] * M.sin(x1), outputs[1] * (x2 * M.cos(x1) + x1)]

    return plant_of(Scaled)


class Tide:
    """A spring that time drives, whose gauge it shifts."""

    states, inputs, outputs = ("q", "s"), ("U",), ("gauge",)
    box = {"q": (-1.0, 1.0), "s": (-2.0, 2.0)}
    f = lambda x, u, t, p, M: [x.s, -2.0 * x.q - 0.3 * x.s + 1.5 * u.U + 2.0 * M.sin(3.0 * t)]
    kappa = lambda x, t, p, M: [-x.s]
    output = lambda x, t, p, M: [x.q + 0.5 * M.sin(5.0 * t)]
