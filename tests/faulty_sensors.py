"""Sensors that fail for a time, and the loops of controllers that get their samples."""

import contextlib
import itertools
from functools import cache

import numpy as np

import npred
from npred.base.errors import DivergedError

DT, BAND = 0.01, 0.1  # of the half widths of the box: an estimate that is nearer is settled
PLANTS = {  # the delay, what is measured, and whether an offset of the input is estimated
    "chemostat": ("chemostat", 1.5, ("S",), True), "chemostat, both": ("chemostat", 1.5, ("Z", "S"), False),
    "van_der_pol": ("van_der_pol", 0.3, ("x1",), False), "scalar": ("scalar", 0.3, ("X",), False),
}  # fmt: skip
OBSERVERS = {"EKF": npred.observers.EKF, "Luenberger": npred.observers.Luenberger}


def controller(name, kind, watched=True, nx=21, **named):
    """A controller whose delay is known, and whose samples are those outputs."""
    name, D, outputs, offset = PLANTS[name]
    plant = npred.plant(name)
    if kind in OBSERVERS:
        named["observer"] = OBSERVERS[kind](plant, outputs=outputs, offset=offset)
    return npred.controller(
        plant, npred.predictor(plant, "heun", nx=nx), named.pop("adaptation", None), DT, D_hat=D, actuator="history",
        u0="equilibrium", max_sample_age=0.1,
        watchdog=npred.Watchdog(after=0.5, then="hold") if watched else None, **named,
    )  # fmt: skip


def constant(value):
    return lambda k, y: np.full_like(y, value)


def frozen():
    first = {}
    return lambda k, y: first.setdefault("y", y)


def cycle(*values):
    return lambda k, y: y + values[k % len(values)]


def burst():
    """Each output is off by up to 10^12 in half of the samples."""
    rng = np.random.default_rng(0)
    return lambda k, y: y + (rng.random(len(y)) < 0.5) * 10.0 ** rng.uniform(-1, 12, len(y))


def noise():
    rng = np.random.default_rng(1)
    return lambda k, y: y + 3.0 * rng.standard_normal(len(y))


FAULTS = {
    **{f"{value:g}": lambda value=value: constant(value) for value in (np.inf, -np.inf, 1e12, 1e200, 1e308)},
    **{f"{value:g}": lambda value=value: constant(value) for value in (np.nan, 0.0, 4.0, 30.0, 100.0, 1000.0)},
    "frozen": frozen, "ramp": lambda: lambda k, y: y + 0.02 * k, "steep ramp": lambda: lambda k, y: y + 1.0 * k,
    "off by 4": lambda: cycle(4.0), "turned": lambda: lambda k, y: -y, "noise": noise, "burst": burst,
    "every other one": lambda: cycle(1e6, 0.0), "some missing": lambda: cycle(1e6, np.nan),
    "all kinds": lambda: cycle(np.inf, np.nan, 50.0, -1e300),
}  # fmt: skip


def of_one(fault):
    """The same of the first output only."""

    def failing(k, y):
        y[:1] = fault(k, y[:1].copy())
        return y

    return failing


class Loop:
    """The plant by RK4, with the commands late by D, and a controller that gets a sample each control step."""

    def __init__(self, one, X0=None):
        self.one, self.plant = one, one.plant
        self.X, self.U = np.array(self.plant.equilibrium if X0 is None else X0, dtype=float), one.u0
        self.line, self.errors, self.handed = [self.U] * round(one.D_hat / DT), [], []

    def run(self, seconds, fault=None):
        for k in range(round(seconds / DT)):
            Y = np.array(self.one.observer.measured(self.X) if self.one.observer else self.X)
            self.call(Y if fault is None else fault(k, Y))
            self.line.append(self.U)
            self.X = self.moved(self.line.pop(0))
        return self

    def call(self, Y):
        with contextlib.suppress(DivergedError):  # the last command is held
            self.U = self.one.step(Y, t=len(self.errors) * DT).copy()
        half = np.array([np.ptp(self.plant.box.get(name, (-1.0, 1.0))) / 2 for name in self.plant.states])
        self.errors.append(np.abs((self.one.X_hat - self.X) / half).max())
        self.handed.append(self.one.status.handed_over)

    def moved(self, U):
        f, x = lambda x: self.plant.f(x, U), self.X
        a = f(x)
        b = f(x + DT / 2 * a)
        c = f(x + DT / 2 * b)
        return x + DT / 6 * (a + 2 * b + 2 * c + f(x + DT * c))

    def settled(self, since):
        """Seconds from then until the estimate is within BAND, and U the controller's, for good."""
        bad = ~(np.array(self.errors) < BAND) | np.array(self.handed)
        return max(np.append(np.nonzero(bad)[0], -1).max() + 1 - round(since / DT), 0) * DT


@cache
def settling(name, kind):
    """Seconds in which the observer settles: from its start, the plant in any corner of the box, and from an error of
    half the box in a state that is not measured, at rest.
    """
    one, times = controller(name, kind), [0.0]
    plant = one.plant
    ends = [plant.box.get(state, (0.0, 0.0)) for state in plant.states]
    for X0 in itertools.product(*[(0.8 * a + 0.2 * b, 0.2 * a + 0.8 * b) for a, b in ends]):
        times.append(Loop(controller(name, kind), X0).run(6.0).settled(0.0))
    hidden = [i for i, state in enumerate(plant.states) if one.observer and state not in one.outputs]
    for i, sign in itertools.product(hidden, (-1, 1)):
        loop = Loop(controller(name, kind)).run(1.0)
        loop.one.memory.signals.filter[i] += sign * np.ptp(ends[i]) / 2
        times.append(loop.run(6.0).settled(1.0))
    return max(times)
