"""Plants of the benchmarks, and the forty whose set-points are asked for by benchmarks/rests.py.

A model has f(x, u, M), the boxes of its states and the bounds of its inputs, and the set-points: states, or functions
of them, with the ranges from which they are drawn, which go beyond what the plant can hold.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

import npred
from npred.plants.builtin import (
    activator_repressor,
    cart_pole,
    chemostat,
    planar_arm,
    pvtol,
    transport_tank,
    van_der_pol,
)

Pair = tuple[float, float]


def declared(
    name: str, states: str, inputs: str, f: Callable[..., Any], box: Sequence[Pair] = (), *bounds: Pair, **parts: Any
) -> type:  # fmt: skip
    """A plant's class, as a user writes it; `aim` is a parameter, and the set-point of the state of that name."""
    names = tuple(states.split())
    own = {"states": names, "inputs": tuple(inputs.split()), "f": f, "box": dict(zip(names, box, strict=False))}
    if bounds:
        own["input_bounds"] = bounds
    if aim := parts.pop("aim", None):
        state, value = aim
        own["parameters"] = parts.pop("parameters", {}) | {"aim": value}
        own["setpoint"] = lambda x, t, p, M: [getattr(x, state) - p.aim]
    if output := parts.pop("measured", None):
        own["outputs"] = (f"{output}_m",)
        own["output"] = lambda x, t, p, M: [getattr(x, output)]
    return type(name, (), own | parts)


def derived(name: str, base: type, **parts: Any) -> type:
    return type(name, (base,), parts)


# with limits: of a part of the state, then others

Pole = derived(  # on a cart, whose track alone is limited: no limit knows the pole
    "Pole", cart_pole.CartPole, parameters=cart_pole.CartPole.parameters | {"mass": 0.2, "length": 0.4, "end": 0.6},
    box={"p": (-0.5, 0.5), "v": (-0.2, 0.2), "theta": (-0.15, 0.15), "omega": (-0.2, 0.2)},
    input_bounds=((-25.0, 25.0),), safe=lambda x, t, p, M: [p.end - x.p, p.end + x.p],
)  # fmt: skip
Pendulum = declared(  # hangs, is sent to 1.5 rad, and must not turn faster than 1.2 rad/s; 1 kg at 1 m, with friction
    "Pendulum", "theta omega", "torque",
    lambda x, u, t, p, M: [x.omega, u.torque - 9.81 * M.sin(x.theta) - 0.2 * x.omega],
    [(-0.5, 2.0), (-1.0, 1.0)], (-15.0, 15.0), guess=(1.5, 0.0),
    kappa=lambda x, t, p, M: [9.81 * M.sin(x.theta) - 6.0 * (x.theta - 1.5) - 3.0 * x.omega],
    safe=lambda x, t, p, M: [1.2 - x.omega, 1.2 + x.omega],
)  # fmt: skip
Drone = derived(  # above the ground, which is 0.5 below where it goes; some starts fall
    "Drone", pvtol.PVTOL, box=pvtol.PVTOL.box | {"y": (-0.4, 0.5), "vy": (-1.0, 1.0)},
    input_bounds=((0.0, 2.5), (-2.0, 2.0)), safe=lambda x, t, p, M: [x.y + 0.5],
)  # fmt: skip
Elbow = derived(  # stops of the second joint alone
    "Elbow", planar_arm.arm(2), input_bounds=((-20.0, 20.0), (-10.0, 10.0)),
    safe=lambda x, t, p, M: [0.85 - x.theta2, x.theta2 - 0.2],
)  # fmt: skip


def _series(x, u, t, p, M):
    first, second = M.sqrt(M.maximum(x.h1, 1e-3)), M.sqrt(M.maximum(x.h2, 1e-3))
    return [u.q - 0.6 * first, 0.6 * first - 0.6 * second]


Series = declared(  # two tanks, one flowing into the other, whose level must stay below 0.57 m on the way to 0.55 m
    "Series", "h1 h2", "q", _series, [(0.2, 0.8), (0.2, 0.55)], (0.0, 1.2), guess=(0.55, 0.55),
    kappa=lambda x, t, p, M: [0.6 * 0.55**0.5 - 1.0 * (x.h1 - 0.55) - 4.0 * (x.h2 - 0.55)],
    safe=lambda x, t, p, M: [0.57 - x.h2],
)  # fmt: skip
Lane = declared(  # a car at 20 m/s, a bicycle of 2.7 m, that changes to the middle of its lane; its steering lags
    "Lane", "y psi delta", "steer",
    lambda x, u, t, p, M: [20.0 * M.sin(x.psi), 20.0 / 2.7 * M.tan(x.delta), (u.steer - x.delta) / 0.1],
    [(-1.0, 1.0), (-0.08, 0.08), (-0.01, 0.01)], (-0.06, 0.06),
    kappa=lambda x, t, p, M: [-0.01 * x.y - 0.25 * x.psi - 0.3 * x.delta],
    safe=lambda x, t, p, M: [1.2 - x.y, 1.2 + x.y],
)  # fmt: skip
Cart = declared(  # a mass that the law sends to 5 cm before the end of its track, with an overshoot
    "Cart", "p v", "F", lambda x, u, t, p, M: [x.v, u.F], [(-0.2, 0.2), (-0.3, 0.3)], (-5.0, 5.0),
    parameters={"end": 0.25, "stiffness": 4.0, "damping": 1.2},
    kappa=lambda x, t, p, M: [-p.stiffness * (x.p - p.end + 0.05) - p.damping * x.v],
    safe=lambda x, t, p, M: [p.end - x.p, p.end + x.p],
)  # fmt: skip
Arm = derived(  # a stop at each side of both angles; the reference needs 0.03 rad more than the first angle has
    "Arm", planar_arm.arm(2),
    safe=lambda x, t, p, M: [0.37 - x.theta1, x.theta1 + 0.05, 0.9 - x.theta2, x.theta2 - 0.25],
)  # fmt: skip
Tank = derived(  # the temperature, with a set point half a kelvin too hot; no input moves the level; one delay
    "Tank", transport_tank.TransportTank, delay=None, guess=(2.0, 24.5),
    parameters=transport_tank.TransportTank.parameters | {"T_set": 24.5},
    safe=lambda x, t, p, M: [24.0 - x.T, x.T - 16.0],
)  # fmt: skip
Aircraft = derived("Aircraft", pvtol.PVTOL, safe=lambda x, t, p, M: [0.25 - x.theta, 0.25 + x.theta])
Clock = derived(  # the repressor, which falls to its set point, 5.25, kept above a floor that is above it
    "Clock", activator_repressor.ActivatorRepressor, safe=lambda x, t, p, M: [x.x2 - 6.0]
)
Cubic = declared(  # without bounds of u: between two nodes the prediction grows by whole factors
    "Cubic", "x", "u", lambda x, u, t, p, M: [x.x + 1.5 * x.x**3 + u.u], [(-0.5, 0.5)],
    kappa=lambda x, t, p, M: [-x.x - 1.5 * x.x**3 - 4.0 * (x.x - 0.9)], safe=lambda x, t, p, M: [1.0 - x.x**2],
)  # fmt: skip


# with set-points that are stepped

Lifted = declared(  # a pendulum without friction, lifted by a torque; more than 9 Nm it cannot
    "Lifted", "angle rate", "torque", lambda x, u, t, p, M: [x.rate, u.torque - p.pull * M.sin(x.angle)],
    [(-1.5, 1.5), (-3.0, 3.0)], (-9.0, 9.0), parameters={"pull": 9.81}, aim=("angle", 0.3),
)  # fmt: skip


def _row(x, u, t, p, M):
    first, second = p.c * M.sqrt(M.maximum(x.h1, 1e-3)), p.c * M.sqrt(M.maximum(x.h2, 1e-3))
    return [u.q1 - first, u.q2 + first - second]


TwoTanks = declared(  # in a row, each with a pump: levels h1 and h2 in metres; h1 flows into h2
    "TwoTanks", "h1 h2", "q1 q2", _row, [(0.5, 2.5), (1.0, 6.0)], (0.0, 2.0), (0.0, 2.0), guess=(1.0, 2.0),
    parameters={"c": 0.5, "first": 1.0, "second": 2.0},
    setpoint=lambda x, t, p, M: [x.h1 - p.first, x.h2 - p.second],
)  # fmt: skip
Oscillator = derived(  # van der Pol's, held at some x1
    "Oscillator", van_der_pol.VanDerPol, parameters={"mu": 1.0, "aim": 0.0}, kappa=None, V=None,
    setpoint=lambda x, t, p, M: [x.x1 - p.aim],
)  # fmt: skip
Reactor = derived(  # the chemostat, led to some substrate S; which biomass Z that takes follows
    "Reactor", chemostat.Chemostat, parameters={"a": 3.5, "rho": 1.0, "m": 0.1, "S_in": 2 + 10 / 3, "aim": 2.0},
    kappa=None, V=None, setpoint=lambda x, t, p, M: [x.S - p.aim],
)  # fmt: skip
Oven = declared(  # a temperature whose kappa reads the set-point itself
    "Oven", "T", "heat", lambda x, u, t, p, M: [u.heat - p.loss * x.T], [(0.0, 100.0)],
    parameters={"loss": 0.4, "k": 1.5, "aim": 20.0}, kappa=lambda x, t, p, M: [p.loss * p.aim - p.k * (x.T - p.aim)],
)  # fmt: skip


# with one output and its set-point: what else is a state is not measured


def _neutral(x, u, t, p, M):
    r = x.w / 0.3
    pH = 7 + 2 * M.log(r + M.sqrt(r * r + 1)) / 2.302585
    return [(200 * u.q - 160 - (20 + u.q) * x.w) / 60, (pH - x.e) / 0.15]


def _culture(x, u, t, p, M):
    growth = 0.5 * x.s / (1.0 + x.s)
    return [(growth - u.q) * x.b, u.q * (6.0 - x.s) - growth * x.b / 0.5]


def _below(x, u, t, p, M):
    above, below = (M.sqrt(M.maximum(level, 0.01)) for level in (x.h, x.g))
    return [(u.q - 4.0 * above) / 20.0, (above - below) / 5.0]


AIMED = {  # a tank's pH, a heated tank, both with sensors that lag; a chemostat by Monod's law, fed at the rate q; …
    "Neutral": declared(
        "Neutral", "w e", "q", _neutral, [(-1.0, 1.0), (4.5, 9.5)], (0.0, 2.0), guess=(0.0, 7.0), time_unit="min",
        measured="e", aim=("e", 7.0),
    ),
    "Heated": declared(
        "Heated", "T s", "P", lambda x, u, t, p, M: [(20.0 - x.T) / 10.0 + 0.12 * u.P, (x.T - x.s) / 1.5],
        [(20.0, 80.0), (20.0, 80.0)], (0.0, 100.0), guess=(50.0, 50.0), time_unit="min", measured="s", aim=("s", 50.0),
    ),
    "Servo": declared(
        "Servo", "a w", "U", lambda x, u, t, p, M: [x.w, -3.0 * x.w - 0.5 * M.tanh(5 * x.w) + 4.0 * u.U],
        [(-2.0, 2.0), (-4.0, 4.0)], (-8.0, 8.0), guess=(0.0, 0.0), measured="a", aim=("a", 0.0),
    ),
    "Culture": declared(
        "Culture", "b s", "q", _culture, [(1.0, 4.5), (0.2, 3.0)], (0.02, 0.5), guess=(2.2, 1.0), time_unit="h",
        measured="s", aim=("s", 1.0),
    ),
    "Tanks": declared(
        "Tanks", "h g", "q", _below, [(2.0, 25.0), (2.0, 25.0)], (0.0, 30.0), guess=(10.0, 10.0), measured="g",
        aim=("g", 10.0),
    ),
    "Pendulum": declared(
        "Pendulum", "a w", "U", lambda x, u, t, p, M: [x.w, 2.0 * M.sin(x.a) - 0.3 * x.w + u.U],
        [(-0.8, 0.8), (-2.0, 2.0)], (-4.0, 4.0), guess=(0.0, 0.0), measured="a", aim=("a", 0.0),
    ),
    "Motor": declared(
        "Motor", "w i", "U",
        lambda x, u, t, p, M: [(0.1 * x.i - 0.004 * x.w) / 0.005, (u.U - 1.0 * x.i - 0.1 * x.w) / 0.05],
        [(0.0, 100.0), (-5.0, 15.0)], (-24.0, 24.0), guess=(50.0, 2.0), measured="w", aim=("w", 50.0),
    ),
}  # fmt: skip


# and others

DCMotor = declared(  # of 10 g m², driven by its voltage
    "DCMotor", "angle speed current", "voltage",
    lambda x, u, t, p, M: [
        x.speed, (p.K * x.current - p.b * x.speed) / p.J, (u.voltage - p.R * x.current - p.K * x.speed) / p.L
    ],
    3 * [(-1.0, 1.0)], parameters={"J": 0.01, "b": 0.1, "K": 0.01, "R": 1.0, "L": 0.5},
    kappa=lambda x, t, p, M: [-20 * x.angle - 2 * x.speed - x.current],
)  # fmt: skip
Climber = declared(  # an aircraft of 1 kg that climbs by its thrust; it is to hover at 2 m
    "Climber", "z v", "thrust", lambda x, u, t, p, M: [x.v, u.thrust - p.gravity], [(1.0, 3.0), (-1.0, 1.0)],
    parameters={"gravity": 9.81}, guess=(2.0, 0.0), kappa=lambda x, t, p, M: [p.gravity - (x.z - 2.0) - 2 * x.v],
)  # fmt: skip
TwoDelays = declared(  # two inputs, the second one later; unstable without them
    "TwoDelays", "x y", "a b", lambda x, u, t, p, M: [0.3 * x.x + x.y + u.a, 0.2 * x.x - 0.1 * x.y + u.b],
    delays=(0.4, 1.0), kappa=lambda x, t, p, M: [-2.3 * x.x - 0.4 * x.y, -0.5 * x.x - 2.2 * x.y],
)  # fmt: skip
Follower = declared(  # along 0.3 sin(1.5 t): a plant whose commands never rest
    "Follower", "x", "u", lambda x, u, t, p, M: [0.5 * x.x + u.u], [(-1.0, 1.0)],
    kappa=lambda x, t, p, M: [0.45 * M.cos(1.5 * t) - 2.5 * x.x + 0.6 * M.sin(1.5 * t)],
    V=lambda x, t, p, M: (x.x - 0.3 * M.sin(1.5 * t)) ** 2, reference=lambda t, p, M: [0.3 * M.sin(1.5 * t)],
)  # fmt: skip
Led = declared(  # along sin t
    "Led", "x", "U", lambda x, u, t, p, M: [u.U - x.x / 2], V=lambda x, t, p, M: (x.x - M.sin(t)) ** 2,
    kappa=lambda x, t, p, M: [x.x / 2 + M.cos(t) - (x.x - M.sin(t))], reference=lambda t, p, M: [M.sin(t)],
)  # fmt: skip
Lag = declared(  # T x' = -x + K u
    "Lag", "x", "u", lambda x, u, t, p, M: [(p.K * u.u - x.x) / p.T], [(0.0, 2.0)], (0.0, 4.0),
    parameters={"T": 1.0, "K": 1.0}, aim=("x", 1.0),
)  # fmt: skip
Integral = declared(  # the same with the integral of the error as a second state
    "Integral", "x xi", "u", lambda x, u, t, p, M: [u.u - x.x, x.x - 1], [(0.0, 2.0), (-1.0, 1.0)], guess=(1.0, 0.0)
)
Traced = declared(  # an upright pendulum
    "Traced", "theta omega", "torque", lambda x, u, t, p, M: [x.omega, 10.0 * M.sin(x.theta) + u.torque],
    [(-0.5, 0.5), (-0.5, 0.5)], kappa=lambda x, t, p, M: [-10.0 * M.sin(x.theta) - 4.0 * (x.theta + x.omega)],
    V=lambda x, t, p, M: x.theta**2 + x.omega**2,
)  # fmt: skip
Called = type("Called", (), {  # the same, as functions of rows
    "traced": False, "states": Traced.states, "inputs": Traced.inputs, "box": Traced.box,
    "f": lambda X, u, t, p: np.stack([X[:, 1], 10.0 * np.sin(X[:, 0]) + u[:, 0]], axis=1),
    "kappa": lambda X, t, p: (-10.0 * np.sin(X[:, 0]) - 4.0 * X.sum(axis=1))[:, None],
    "V": lambda X, t, p: (X**2).sum(axis=1),
})  # fmt: skip


# the forty


class Model(NamedTuple):
    """`guess` is where it rests at first, by default the box's middle; `rates` are states that are per unit of time;
    `walls` are its state_bounds; `read` are set-points that are functions (x, M) of the states.
    """

    f: Callable[..., list[Any]]
    box: dict[str, Pair]
    inputs: dict[str, Pair]
    aims: dict[str, Pair]
    guess: tuple[float, ...] = ()
    rates: tuple[str, ...] = ()
    walls: Mapping[str, Pair] = {}
    read: Mapping[str, Callable[..., Any]] = {}
    second: float = 1.0  # how many of them are its own time


def shipped(name: str, states: str, inputs: dict[str, Pair], aims: dict[str, Pair], **more: Any) -> Model:
    """A plant of npred: its f and its box, of the states that are named; the law is another."""
    declared = npred.plant(name).declared
    p = type("Parameters", (), declared.parameters)
    boxes = {state: declared.box[state] for state in states.split()}
    return Model(lambda x, u, M: declared.f(x, u, 0.0, p, M), boxes, inputs, aims, **more)


def _pendulum(x, u, M):
    return [x.rate, u.torque - 9.81 * M.sin(x.angle)]


def _reactor(x, u, M):
    rate = 7.2e10 * M.exp(-8750.0 / x.T) * x.c
    return [1.0 - x.c - rate, 350.0 - x.T + 209.2 * rate + 2.092 * (u.Tc - x.T)]


def _two_inputs(x, u, M):
    rate = 7.2e10 * M.exp(-8750.0 / x.T) * x.c
    return [u.q * (1.0 - x.c) - rate, u.q * (350.0 - x.T) + 209.2 * rate + 2.092 * (u.Tc - x.T)]


def _tanks(x, u, M):
    one, two = (0.3 * M.sqrt(2 * 981 * M.maximum(h, 0.01)) for h in (x.h1, x.h2))
    return [(u.q - one) / 50, (one - two) / 50]


def _two_tanks(x, u, M):
    first, second = (0.5 * M.sqrt(M.maximum(h, 1e-3)) for h in (x.h1, x.h2))
    return [u.q1 - first, u.q2 + first - second]


def _three_tanks(x, u, M):
    one, two = (0.6 * d / (d * d + 0.01) ** 0.25 for d in (x.h1 - x.h3, x.h3 - x.h2))
    return [u.q1 - one, u.q2 + two - M.sqrt(M.maximum(x.h2, 1e-3)), one - two]


def _quadruple(gamma, k):
    """Johansson's quadruple tank, IEEE Trans. Control Systems Technology 8, 2000; levels in cm, pumps in V."""

    def f(x, u, M):
        areas, holes = (28.0, 32.0, 28.0, 32.0), (0.071, 0.057, 0.071, 0.057)
        out = [a * M.sqrt(2 * 981 * M.maximum(h, 1e-6)) for a, h in zip(holes, (x.h1, x.h2, x.h3, x.h4), strict=True)]
        q1, q2 = k[0] * u.v1, k[1] * u.v2
        flows = [
            out[2] - out[0] + gamma[0] * q1, out[3] - out[1] + gamma[1] * q2, (1 - gamma[1]) * q2 - out[2],
            (1 - gamma[0]) * q1 - out[3],
        ]  # fmt: skip
        return [flow / area for flow, area in zip(flows, areas, strict=True)]

    return f


def _boiler(x, u, M):
    """Bell and Åström's boiler-turbine unit, 160 MW: pressure, power, density."""
    steam = x.p**1.125
    return [
        -0.0018 * u.steam * steam + 0.9 * u.fuel - 0.15 * u.feed, (0.073 * u.steam - 0.016) * steam - 0.1 * x.P,
        (141 * u.feed - (1.1 * u.steam - 0.19) * x.p) / 85,
    ]  # fmt: skip


def _quadrotor(x, u, M):
    (s1, c1), (s2, c2), (s3, c3) = ((M.sin(a), M.cos(a)) for a in (x.roll, x.pitch, x.yaw))
    push, turn = u.thrust / 1.2, s1 * x.q + c1 * x.r
    return [
        x.vx, x.vy, x.vz, push * (c1 * s2 * c3 + s1 * s3), push * (c1 * s2 * s3 - s1 * c3), push * c1 * c2 - 9.81,
        x.p + s2 / c2 * turn, c1 * x.q - s1 * x.r, turn / c2, -0.8 * x.q * x.r + u.t1 / 0.01,
        0.8 * x.p * x.r + u.t2 / 0.01, u.t3 / 0.02,
    ]  # fmt: skip


def _exchanger(x, u, M):
    hot, cold = (90.0, x.a1, x.a2, x.a3), (15.0, x.b1, x.b2, x.b3)
    heat = [0.8 * (hot[k] - cold[k]) for k in (1, 2, 3)]
    return [
        *(u.flow * (hot[k - 1] - hot[k]) - heat[k - 1] for k in (1, 2, 3)),
        *(1.2 * (cold[k - 1] - cold[k]) + heat[k - 1] for k in (1, 2, 3)),
    ]


def _furuta(x, u, M):
    arm, pole, coupling, weight = 4e-3, 1.2e-3, 1.3e-3, 0.085
    s, c = M.sin(x.pole), M.cos(x.pole)
    a, b = arm + pole * s * s, coupling * c
    spin = 2 * pole * s * c * x.arm_rate * x.pole_rate
    one = u.torque - 2e-3 * x.arm_rate - spin + coupling * s * x.pole_rate**2
    two = pole * s * c * x.arm_rate**2 + weight * s - 1e-4 * x.pole_rate
    det = a * pole - b * b
    return [x.arm_rate, x.pole_rate, (pole * one - b * two) / det, (a * two - b * one) / det]


def _two_links(x, u, M):
    c, s = M.cos(x.q2), M.sin(x.q2)
    m11, m12, m22 = 1.5 + 0.6 * c, 0.3 + 0.3 * c, 0.3
    one = u.t1 + 0.3 * s * (2 * x.w1 * x.w2 + x.w2**2) - 15 * M.sin(x.q1) - 4 * M.sin(x.q1 + x.q2) - x.w1
    two = u.t2 - 0.3 * s * x.w1**2 - 4 * M.sin(x.q1 + x.q2) - x.w2
    det = m11 * m22 - m12 * m12
    return [x.w1, x.w2, (m22 * one - m12 * two) / det, (m11 * two - m12 * one) / det]


def _flexible(x, u, M):
    spring = 30.0 * (x.motor - x.link)
    return [x.link_rate, x.motor_rate, -9.8 * M.sin(x.link) + spring, (u.torque - spring - x.motor_rate) / 0.3]


def _pH(x, M):
    y = x.a / 2e-7  # of strong acid less strong base, in mol/L
    return 7.0 - M.sign(y) * M.log(M.abs(y) + M.sqrt(y * y + 1.0)) / 2.302585092994046


VALVE = ([0.0, 0.2, 0.4, 0.7, 1.0], [0.0, 0.02, 0.15, 0.6, 1.0])
MODELS = {
    "scalar": shipped("scalar", "X", {"U": (-1.0, 1.0)}, {"X": (-3.0, 3.0)}),
    "van der Pol": shipped("van_der_pol", "x1 x2", {"u": (-2.0, 2.0)}, {"x1": (-4.0, 4.0)}, rates=("x2",)),
    "chemostat": shipped(
        "chemostat", "Z S", {"u": (0.3, 1.5)}, {"S": (0.01, 6.0)}, guess=(3.0, 2.0), walls={"Z": (0.0, 1e3)}
    ),
    "activator": shipped(
        "activator_repressor", "x1 x2", {"U": (-0.2, 0.5)}, {"x1": (0.0, 0.7)}, guess=(0.0939, 5.2525)
    ),
    "cart pole": shipped(
        "cart_pole", "p v theta omega", {"F": (-5.0, 5.0)}, {"p": (-3.0, 3.0)}, rates=("v", "omega"),
        walls={"p": (-2.0, 2.0)},
    ),
    "PVTOL": shipped(
        "pvtol", "x y theta vx vy omega", {"thrust": (0.0, 2.0), "moment": (-1.0, 1.0)},
        {"x": (-3.0, 3.0), "y": (-2.0, 2.0)}, rates=("vx", "vy", "omega"), walls={"x": (-2.0, 2.5), "y": (-1.0, 1.9)},
    ),
    "feedforward": shipped(
        "strict_feedforward2", "z1 z2", {"u": (-1.0, 1.0)}, {"z1": (-3.0, 3.0)}, walls={"z1": (-2.0, 2.0)}
    ),
    "transport tank": shipped(
        "transport_tank", "h T", {"u": (-20.0, 20.0)}, {"T": (1.0, 60.0)}, guess=(2.0, 20.0), second=1.0
    ),
    "reactor": Model(
        _reactor, {"c": (0.4, 0.6), "T": (345.0, 355.0)}, {"Tc": (280.0, 320.0)}, {"T": (300.0, 420.0)},
        guess=(0.5, 350.0), second=0.2,
    ),
    "ball and beam": Model(
        lambda x, u, M: [x.v, 5 / 7 * 9.81 * M.sin(u.angle)], {"r": (-0.2, 0.2), "v": (-0.1, 0.1)},
        {"angle": (-0.3, 0.3)}, {"r": (-1.0, 1.0)}, rates=("v",), walls={"r": (-0.6, 0.6)},
    ),
    "tanks": Model(
        _tanks, {"h1": (5.0, 25.0), "h2": (5.0, 25.0)}, {"q": (0.0, 100.0)}, {"h2": (1.0, 90.0)}, second=50.0
    ),
    "glucose": Model(
        lambda x, u, M: [2.0 - (0.01 + x.X) * x.G, 1.3e-5 * (x.I - 7.0) - 0.025 * x.X, u.insulin / 12.0 - 0.09 * x.I],
        {"G": (80.0, 180.0), "X": (0.0, 0.02), "I": (5.0, 40.0)}, {"insulin": (0.0, 200.0)}, {"G": (5.0, 450.0)},
        guess=(100.0, 0.01, 20.0), second=10.0,
    ),
    "Furuta": Model(
        _furuta, {"arm": (-0.5, 0.5), "pole": (-0.1, 0.1), "arm_rate": (-0.5, 0.5), "pole_rate": (-0.5, 0.5)},
        {"torque": (-0.2, 0.2)}, {"arm": (-3.0, 3.0)}, rates=("arm_rate", "pole_rate"), walls={"arm": (-2.0, 2.0)},
        second=0.1,
    ),
    "servo": Model(
        lambda x, u, M: [x.speed, 8.0 * u.voltage - 5.0 * x.speed - 6.0 * M.tanh(x.speed / 0.05)],
        {"angle": (-1.0, 1.0), "speed": (-2.0, 2.0)}, {"voltage": (-12.0, 12.0)}, {"angle": (-5.0, 5.0)},
        walls={"angle": (-3.0, 3.0)}, second=0.02,
    ),
    "pendulum": Model(
        _pendulum, {"angle": (-1.5, 1.5), "rate": (-3.0, 3.0)}, {"torque": (-9.0, 9.0)}, {"angle": (-1.55, 1.55)},
        rates=("rate",),
    ),
    "two tanks": Model(
        _two_tanks, {"h1": (0.5, 2.5), "h2": (1.0, 6.0)}, {"q1": (0.0, 2.0), "q2": (0.0, 2.0)},
        {"h1": (0.2, 6.0), "h2": (0.5, 12.0)}, guess=(1.0, 2.0),
    ),
    "oven": Model(
        lambda x, u, M: [u.heat - 0.4 * x.T], {"T": (0.0, 100.0)}, {"heat": (0.0, 30.0)}, {"T": (-20.0, 110.0)}
    ),
    "piezo": Model(
        lambda x, u, M: [x.v, -((2 * M.pi * 5e3) ** 2) * (x.x + 1e-4 * x.x**2 - 30 * u.u) - 400 * M.pi * x.v],
        {"x": (-100.0, 100.0), "v": (-1e6, 1e6)}, {"u": (-10.0, 10.0)}, {"x": (-450.0, 450.0)}, rates=("v",),
        second=2e-4,
    ),
    "quadruple tank": Model(
        _quadruple((0.7, 0.6), (3.33, 3.35)),
        {"h1": (5.0, 20.0), "h2": (5.0, 20.0), "h3": (0.5, 5.0), "h4": (0.5, 5.0)},
        {"v1": (0.0, 10.0), "v2": (0.0, 10.0)}, {"h1": (1.0, 60.0), "h2": (1.0, 60.0)}, guess=(12.4, 12.7, 1.8, 1.4),
        second=50.0,
    ),
    "the same, non-minimum phase": Model(
        _quadruple((0.43, 0.34), (3.14, 3.29)),
        {"h1": (5.0, 20.0), "h2": (5.0, 20.0), "h3": (1.0, 9.0), "h4": (1.0, 9.0)},
        {"v1": (0.0, 10.0), "v2": (0.0, 10.0)}, {"h1": (1.0, 60.0), "h2": (1.0, 60.0)}, guess=(12.6, 13.0, 4.8, 4.9),
        second=50.0,
    ),
    "van de Vusse": Model(
        lambda x, u, M: [-50 * x.a - 10 * x.a**2 + (10 - x.a) * u.q, 50 * x.a - 100 * x.b - x.b * u.q],
        {"a": (0.5, 5.0), "b": (0.5, 1.3)}, {"q": (3.0, 60.0)}, {"b": (0.05, 1.6)}, guess=(3.0, 1.11), second=0.02,
    ),
    "boiler": Model(
        _boiler, {"p": (90.0, 125.0), "P": (40.0, 90.0), "rho": (380.0, 480.0)},
        {"fuel": (0.0, 1.0), "steam": (0.0, 1.0), "feed": (0.0, 1.0)},
        {"p": (60.0, 150.0), "P": (10.0, 130.0), "rho": (300.0, 560.0)}, guess=(108.0, 66.65, 428.0),
        walls={"rho": (310.0, 540.0)}, second=60.0,
    ),
    "quadrotor": Model(
        _quadrotor,
        {"x": (-1.0, 1.0), "y": (-1.0, 1.0), "z": (0.0, 3.0), "vx": (-1.0, 1.0), "vy": (-1.0, 1.0), "vz": (-1.0, 1.0),
         "roll": (-0.3, 0.3), "pitch": (-0.3, 0.3), "yaw": (-1.0, 1.0), "p": (-1.0, 1.0), "q": (-1.0, 1.0),
         "r": (-1.0, 1.0)},
        {"thrust": (0.0, 25.0), "t1": (-0.3, 0.3), "t2": (-0.3, 0.3), "t3": (-0.1, 0.1)},
        {"x": (-6.0, 6.0), "y": (-6.0, 6.0), "z": (-0.5, 6.0), "yaw": (-3.0, 3.0)},
        rates=("vx", "vy", "vz", "p", "q", "r"), walls={"x": (-5.0, 5.0), "y": (-5.0, 5.0), "z": (0.0, 5.5)},
        second=0.3,
    ),
    "heat exchanger": Model(
        _exchanger, dict.fromkeys(("a1", "a2", "a3", "b1", "b2", "b3"), (20.0, 80.0)), {"flow": (0.05, 3.0)},
        {"b3": (10.0, 80.0)}, second=0.5,
    ),
    "reactor with two inputs": Model(
        _two_inputs, {"c": (0.4, 0.6), "T": (345.0, 355.0)}, {"q": (0.3, 3.0), "Tc": (270.0, 330.0)},
        {"c": (0.02, 0.98), "T": (310.0, 400.0)}, guess=(0.5, 350.0), second=0.2,
    ),
    "magnet": Model(
        lambda x, u, M: [x.v, 9.81 - 2e-3 * (u.i / x.gap) ** 2], {"gap": (5e-3, 2e-2), "v": (-0.2, 0.2)},
        {"i": (0.2, 1.8)}, {"gap": (1e-3, 0.04)}, rates=("v",), second=0.05,
    ),
    "motor": Model(
        lambda x, u, M: [(0.05 * x.i - 1e-4 * x.w) / 2e-4, (u.V - 1.2 * x.i - 0.05 * x.w) / 3e-3],
        {"w": (-300.0, 300.0), "i": (-5.0, 5.0)}, {"V": (-24.0, 24.0)}, {"w": (-700.0, 700.0)}, second=0.05,
    ),
    "pH": Model(
        lambda x, u, M: [(3e-3 - x.a) - u.base * (x.a + 3e-3)], {"a": (-1e-3, 1e-3)}, {"base": (0.2, 2.0)},
        {"pH": (2.0, 12.0)}, read={"pH": _pH},
    ),
    "room": Model(
        lambda x, u, M: [(u.heat - 0.2 * (x.air - x.wall)) / 0.5, (0.2 * (x.air - x.wall) - 0.1 * (x.wall - 5)) / 20],
        {"air": (15.0, 25.0), "wall": (10.0, 22.0)}, {"heat": (0.0, 3.0)}, {"air": (-10.0, 70.0)}, second=1.0,
    ),
    "three tanks": Model(
        _three_tanks, {"h1": (0.5, 3.0), "h2": (0.2, 2.0), "h3": (0.3, 2.5)}, {"q1": (0.0, 1.2), "q2": (0.0, 1.2)},
        {"h1": (0.1, 8.0), "h2": (0.1, 5.0)}, guess=(1.5, 0.8, 1.1),
    ),
    "cone": Model(
        lambda x, u, M: [(u.q - 0.8 * M.sqrt(M.maximum(x.h, 1e-4))) / (0.3 * M.maximum(x.h, 1e-2) ** 2)],
        {"h": (0.3, 2.0)}, {"q": (0.1, 1.5)}, {"h": (0.003, 6.0)}, guess=(1.0,),
    ),
    "vessel": Model(
        lambda x, u, M: [u.valve * M.sqrt(M.maximum(10.0 - x.P, 1e-6)) - 0.4 * x.P], {"P": (1.0, 7.0)},
        {"valve": (0.05, 2.0)}, {"P": (0.1, 12.0)},
    ),
    "two links": Model(
        _two_links, {"q1": (-1.0, 1.0), "q2": (-1.0, 1.0), "w1": (-1.0, 1.0), "w2": (-1.0, 1.0)},
        {"t1": (-14.0, 14.0), "t2": (-3.0, 3.0)}, {"q1": (-3.0, 3.0), "q2": (-3.0, 3.0)}, rates=("w1", "w2"),
    ),
    "generator": Model(
        lambda x, u, M: [x.rate, u.power - x.E * M.sin(x.angle) - 0.1 * x.rate, u.field - 1.5 * x.E + M.cos(x.angle)],
        {"angle": (0.2, 1.2), "rate": (-0.3, 0.3), "E": (0.8, 1.5)}, {"power": (0.0, 1.3), "field": (0.0, 2.0)},
        {"angle": (-0.5, 1.5), "E": (0.3, 2.2)}, guess=(0.6, 0.0, 1.1), rates=("rate",),
    ),
    "car": Model(
        lambda x, u, M: [(u.F - 0.4 * x.v * M.abs(x.v) - 150.0) / 1200], {"v": (5.0, 40.0)}, {"F": (0.0, 2000.0)},
        {"v": (0.1, 100.0)}, second=20.0,
    ),
    "propofol": Model(
        lambda x, u, M: [
            u.dose - 0.5 * x.c1 + 0.055 * x.c2 + 0.0033 * x.c3, 0.11 * x.c1 - 0.055 * x.c2, 0.042 * x.c1 - 0.0033 * x.c3
        ],
        {"c1": (0.0, 6.0), "c2": (0.0, 12.0), "c3": (0.0, 70.0)}, {"dose": (0.0, 3.0)}, {"c1": (-2.0, 14.0)},
        second=2.0,
    ),
    "flexible joint": Model(
        _flexible, {"link": (-1.0, 1.0), "motor": (-1.3, 1.3), "link_rate": (-1.0, 1.0), "motor_rate": (-1.0, 1.0)},
        {"torque": (-8.0, 8.0)}, {"link": (-1.5, 1.5)}, rates=("link_rate", "motor_rate"), second=0.3,
    ),
    "boost converter": Model(
        lambda x, u, M: [(12.0 - 0.1 * x.i - (1 - u.d) * x.v) / 1e-3, ((1 - u.d) * x.i - x.v / 10) / 1e-3],
        {"i": (1.0, 12.0), "v": (13.0, 35.0)}, {"d": (0.0, 0.8)}, {"v": (2.0, 60.0)}, guess=(4.0, 20.0), second=5e-3,
    ),
    "ship": Model(
        lambda x, u, M: [(0.2 * x.rudder - x.r - 400 * x.r**3) / 20, (u.order - x.rudder) / 2],
        {"r": (-0.05, 0.05), "rudder": (-0.5, 0.5)}, {"order": (-0.6, 0.6)}, {"r": (-0.12, 0.12)}, rates=("r",),
        second=10.0,
    ),
    "tank with a valve": Model(
        lambda x, u, M: [(0.9 * M.interp(u.valve, *VALVE) - 0.4 * M.sqrt(M.maximum(x.h, 1e-4)))], {"h": (0.2, 3.0)},
        {"valve": (0.05, 0.95)}, {"h": (0.0005, 7.0)}, guess=(1.0,),
    ),
}  # fmt: skip
