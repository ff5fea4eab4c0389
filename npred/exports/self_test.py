"""The test inside an exported controller: calls that move its whole memory, and the answers of the one in Python.

A plant whose delay is another one than D_hat is kicked about. Its samples come in time, late, wrong, or not at all.
"""

from collections.abc import Iterator
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from npred.base.errors import ConfigError, DivergedError
from npred.base.randomness import generator
from npred.loop.controller import Controller

# What a call does, as npred/exports/c/controller.c numbers it.
SAMPLED, STAMPED, APPLIED, SAVED, ESTIMATE, TIME, ANEW, SET = (1 << bit for bit in range(8))
NOW = SAMPLED | STAMPED
DOES = {"plain": SAMPLED, "none": STAMPED, "restart": STAMPED | TIME, "anew": STAMPED | ANEW}
DOES |= {"applied": NOW | APPLIED, "saved": NOW | SAVED, "estimate": NOW | ESTIMATE, "time": NOW | TIME}
DOES |= {"set": NOW | SET}
# sizes of the kicks: the first one is taken that does not amplify rounding errors too much.
SIZES = (1.0, 0.5, 0.2, 0.1, 0.03)
EDGES = {"edge": 0.99, "over": 1.01}  # times the gate: a sample that is still believed, and one that is not
GROWTH = 200.0  # times a relative error of the samples, up to which the test takes these
TURNED = 1e-9  # that error
MOVED = 0.02  # share of a parameter's value by which it is changed
X_ROWS, U_ROWS, MEASURED_CALLS = 5, 4, 24  # for a controller that gets u: rows that are taken in turn

ROUNDED = {"earlier": 0.47, "later": 0.53}  # in control steps: a sample's time, which is moved to the nearest begin
USED = 1  # a sample's fate: npred/kernels/c/controller.h
BISECTIONS = 12  # that find how wide the gate is


class Test(NamedTuple):
    """Calls, and their samples: X (calls or rows, outputs), and u (rows, nx, m) or nothing."""

    does: np.ndarray
    t: np.ndarray
    taken: np.ndarray
    X: np.ndarray
    u: np.ndarray


def designed(controller: Controller) -> tuple[Test, float]:
    """The calls that test a controller, and how much larger an error of a sample is in U."""
    draw = _recalled if controller.settings.reads_commands else _measured
    least, best = np.inf, None
    for size in SIZES:
        test = draw(controller, size)
        growth = _growth(controller, test)
        if best is None or growth < least:
            best, least = test, growth
        if least <= GROWTH:
            break
    assert best is not None
    return best, least


def answers(controller: Controller, test: Test) -> tuple[np.ndarray, np.ndarray]:
    """U (calls, m), NaN where a call is refused, and D_hat (calls,) of a new controller."""
    rows = [(U, D_hat) for U, D_hat, _ in _played(controller, test)]
    return np.array([U for U, _ in rows]), np.array([D_hat for _, D_hat in rows])


def kept(controller: Controller, test: Test) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The least h that a safety filter predicts in each call, whether it changes U there, and how much larger an error
    of the samples is in U or h (calls,).
    """

    def of(test: Test) -> tuple[np.ndarray, np.ndarray]:
        rows = [
            (*U, z.kept[0], z.filtered[0]) for U, _, twin in _played(controller, test) for z in [twin.memory.signals]
        ]
        return np.array(rows)[:, :-1], np.array(rows)[:, -1]

    numbers, filtered = of(test)
    h = numbers[:, -1]
    sizes = np.append(np.nanmax(np.abs(numbers[:, :-1]), axis=0), np.nanmedian(np.abs(h)))
    grown = [_grown(numbers, of(turned)[0], sizes) for turned in _turned(test)]
    return h, filtered, np.maximum(*grown)


def _played(controller: Controller, test: Test) -> Iterator[tuple[np.ndarray, float, Controller]]:
    """U and D_hat of each call of a new controller, and it."""
    player = _Player(controller, test.u)
    for s, (does, t, taken) in enumerate(zip(test.does, test.t, test.taken, strict=True)):
        yield *player.call(s, int(does), t, taken, test.X[s % len(test.X)]), player.twin


def moved(controller: Controller) -> dict[str, float]:
    """Other values of the parameters that can be set, as the test sets them one after the other."""
    twin, values = controller.fresh(), {}
    for name, value in controller.parameters.items():
        for share in () if name in controller.fixed else (MOVED, -MOVED):
            values[name] = value + share * (abs(value) or 1.0)
            with suppress(ConfigError):
                twin.set(**{name: values[name]})
                break
    return values


class _Player:
    """A new controller that takes the calls of a test."""

    def __init__(self, controller: Controller, u: np.ndarray) -> None:
        self.first, self.twin, self.u, self.moved = controller, controller.fresh(), u, moved(controller)

    def call(self, s: int, does: int, t: float, taken: float, X: np.ndarray) -> tuple[np.ndarray, float]:
        if does & ANEW:
            self.twin = self.first.fresh()
        for name, value in self.moved.items() if does & SET else ():
            with suppress(ConfigError):
                self.twin.set(**{name: value})
        if does & SAVED:
            saved, self.twin = self.twin.state(), self.first.fresh()
            self.twin.restore(saved)
        if does & ESTIMATE:
            self.twin.D_hat = self.first.D_hat
        if does & TIME:
            self.twin.t = t
        try:
            U = self._step(s, does, t, taken, X).copy()
        except (ConfigError, DivergedError):
            U = np.full(self.twin.plant.m, np.nan)
        return U, self.twin.D_hat

    def _step(self, s: int, does: int, t: float, taken: float, X: np.ndarray) -> np.ndarray:
        twin = self.twin
        if not twin.settings.reads_commands:
            u, other = (self.u[(s + k) % len(self.u)] for k in (0, 1))
            return twin.step(X, u, other if does & STAMPED else None)
        if not does & STAMPED:
            return twin.step(X)
        applied = 0.5 * twin.memory.signals.U[:, 0] if does & APPLIED else None
        return twin.step(X, t=t, sampled_at=taken, applied=applied) if does & SAMPLED else twin.step(t=t)


def _at_the_gate(twin: Controller, s: int, t: float, Y: np.ndarray, share: float) -> np.ndarray:
    """A sample of time t with an output that is a share of the gate off what the controller expects; Y without one."""
    one, saved = s % len(Y), twin.state()
    if not twin.settings.gated:
        return Y
    scout = twin.fresh()

    def tried(sample: np.ndarray) -> Controller:
        scout.restore(saved)
        scout.step(sample, t=t)
        return scout

    def believed(off: float) -> bool:
        tried(np.where(np.arange(len(Y)) == one, expected + off, expected))
        return int(scout.memory.signals.fate[one, 0]) == USED if scout.observer else scout.status.age == 0.0

    try:
        expected = Y - tried(Y).status.innovation
        sign = 1.0 if s % 2 else -1.0
        wide = next((w for w in 2.0 ** np.arange(-20, 20) * max(1.0, abs(Y[one])) if not believed(sign * w)), None)
        if wide is None or not np.isfinite(expected).all():
            return Y
        low, high = 0.5 * wide, wide
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if believed(sign * middle) else (low, middle)
    except (ConfigError, DivergedError):
        return Y
    expected[one] += share * sign * low
    return expected


class _World:
    """The plant, which gets each command a delay later; only a maker of samples."""

    def __init__(self, controller: Controller, size: float) -> None:
        self.plant, self.dt, self.random = controller.plant, controller.dt, generator(0, "self-test")
        self.middle = self.plant.target(0.0)
        wide = np.ptp(self.plant.ranges(half=0.0), axis=1) / 2
        self.half = np.where(wide > 0, wide, 0.3 * np.maximum(np.abs(self.middle), 1.0))
        low, high = controller.settings.bounds
        self.D = min(max(0.7 * controller.D_hat, low), high)
        self.size, self.t, self.X = size, controller.t, self.middle
        first = controller.u0 if controller.keeps_commands else np.zeros(self.plant.m)
        self.sent, self.past = [(-np.inf, first)], [self.X]
        self.kick()

    def kick(self) -> None:
        """Put the state to some place about the target."""
        self.X = self.middle + 0.6 * self.size * self.half * self.random.uniform(-1.0, 1.0, len(self.middle))
        self.past.append(self.X)

    def to(self, t: float) -> None:
        """Go on to a time, by Heun's method."""
        steps = min(max(int((t - self.t) / self.dt * 2), 1), 40)
        h = (t - self.t) / steps
        for k in range(steps):
            at = self.t + k * h
            D = float(self.plant.delay(self.X, at)) if self.plant.declares_delay else self.D
            arrived = (at - D * r for r in self.plant.ratios)
            U = np.array([next(U[i] for t, U in reversed(self.sent) if t <= s) for i, s in enumerate(arrived)])
            rate = self.plant.f(self.X, U, at)
            self.X = self.X + h / 2 * (rate + self.plant.f(self.X + h * rate, U, at + h))
            self.X = np.clip(self.X, self.middle - 2 * self.half, self.middle + 2 * self.half)
        self.t = t
        if not (np.abs(self.X - self.middle) < 2 * self.half).all():
            self.kick()
        self.past.append(self.X)


def _calls(controller: Controller) -> Iterator[tuple[str, float, float]]:
    """The event, how many control steps after the call before, and how many a sample is old."""
    rows, d = len(controller.memory.signals.held), max(controller.D_hat / controller.dt, 1.0)
    waits, oldest = controller.watchdog.after / controller.dt if controller.watchdog else 4.0, controller.memory.oldest
    now = ("now", 1.0, 0.0)
    yield from 10 * [("plain", 1.0, 0.0)]
    for part in 6 * [0.25, 0.0, 0.75, 0.0]:  # three times the delay
        yield "now", max(round(d / 8), 1) + part, 0.0
    for gap in (0.75, 1.25, 0.5, 0.25, 0.125, 0.5, 0.375, 0.25, 1.75, 2.5, 1.0, 1.004, 1.0, 1.371):
        yield "now", gap, 0.0
    for gap, age in ((1.25, 0.5), (1.75, 1.0), (4.25, 3.25), (3.0, 1.5), (1.125, 3.25), (1.0, 12.0)):
        yield "now", gap, age
    yield from [("none", 1.0, 0.0), ("none", 1.5, 0.0), ("none", 1.0, 0.0), ("applied", 1.0, 0.0), now]
    yield from [("none", 1.0, 0.0), ("far", 1.25, 0.25), ("now", 1.0, 1.5), now, ("estimate", 1.0, 0.0)]
    yield from [("set", 1.0, 0.0), now]
    for age in (oldest / 2, oldest + 3.0, oldest + 0.5, oldest - 0.5, 0.0):
        yield from [("none", oldest / 2 + 3.5, 0.0), ("none", oldest / 2 + 1.25, 0.0), ("now", 1.0, age)]
    for what in EDGES:
        for gap, age in ((1.0, 0.0), (2.5, 1.5), (2.5, 1.5), (1.0, 0.0)):
            yield from [(what, gap, age), now, ("nan", 0.375, 0.0)]
        yield from [("none", oldest + 3.25, 0.0), (what, oldest + 4.0, max(oldest - 2.0, 0.0)), now]
    yield from [("back", -1.0, 0.0), ("far", 2.0, 0.0), now, ("nan", 1.0, 0.0), ("none", 1.0, 0.0), ("far", 1.0, 0.0)]
    yield from [now, ("kick", 1.0, 0.5), *5 * [("far", round(d / 3) + 0.5, 0.0)], *3 * [now]]
    yield from [("saved", 1.0, 0.0), ("estimate", 1.25, 0.0), now, ("time", 1.0, 0.0), now]
    yield from [("restart", 1.0, 0.0), ("now", 1.0, oldest + 0.5), ("now", 1.0, 3.0), now, ("now", 1.0, 0.25)]
    yield from [*4 * [("none", round(waits / 3) + 0.25, 0.0)], *3 * [now], ("kick", 1.0, 0.0)]
    for gap, first in ((rows + 3.5, "now"), (4.0 * rows + 7.0, "far")):
        yield from [(first, gap, 0.0), ("kick", 0.75, 0.0), ("now", 1.25, 0.5), *4 * [now], ("estimate", 1.0, 0.0)]
    yield from [("none", 4.0 * rows + 9.0, 0.0), ("far", 1.0, 0.0), *3 * [now], *4 * [("plain", 1.0, 0.0)]]
    yield from [*(2 * [(what, 1.375, 0.0) for what in ROUNDED]), now]
    yield from [("far", 1.0, 0.0), ("restart", 1.0, 0.0), *5 * [("far", round(d / 3) + 0.5, 0.0)], *2 * [now]]
    yield from [("anew", 1.0, 0.0), ("now", 1.0, oldest + 0.5), now, ("now", 1.0, 1.0), now, ("none", 1.0, 0.0)]
    yield from 5 * [now]


def _recalled(controller: Controller, size: float) -> Test:
    """Those of a controller that remembers its commands."""
    world, player, shift, rows = _World(controller, size), _Player(controller, np.zeros(0)), 0.0, []
    outputs, gate = controller.observer.measured if controller.observer else np.asarray, controller.outlier_limit or 0.3
    for s, (what, gap, age) in enumerate(_calls(controller)):
        world.to(world.t + max(gap, 0.0) * controller.dt * (s > 0))
        if what == "kick":
            world.kick()
        shift += 1.7 * (what in ("time", "restart"))
        t, X = world.t + shift + min(gap, 0.0) * controller.dt, world.past[max(len(world.past) - 1 - round(age), 0)]
        Y = np.asarray(outputs(X + 1.2 * gate * world.half * (what == "far")), dtype=float)
        Y = np.full(len(Y), np.nan) if what in ("nan", "none", "restart", "anew") else Y
        age = (t / controller.dt - ROUNDED[what]) % 1.0 if what in ROUNDED else age
        taken = t - age * controller.dt
        Y = _at_the_gate(player.twin, s, taken, Y, EDGES[what]) if what in EDGES else Y
        call = DOES.get(what, NOW), t, taken, Y
        rows.append(call)
        world.sent.append((world.t, np.nan_to_num(player.call(s, *call)[0])))
    does, t, taken, X = (np.array(column) for column in zip(*rows, strict=True))
    return Test(does, t, taken, X, np.zeros(0))


def _measured(controller: Controller, size: float) -> Test:
    """Those of a controller that is given u: laws of states about the target, and waves."""
    world, nx = _World(controller, size), controller.predictor.nx
    low, high = controller.settings.input_bounds.reshape(-1, 2).T
    x, X, u = np.linspace(0.0, 1.0, nx)[:, None], [], []
    for row in range(X_ROWS):
        world.kick()
        X.append(world.X)
        a, b = (controller.plant.kappa(world.X * k + world.middle * (1 - k)) for k in (0.3, 0.9))
        u.append(np.clip(a + (b - a) * x + 0.2 * (b - a) * np.sin((3 + row) * x), low, high))
    does = np.full(MEASURED_CALLS, SAMPLED)
    does[1::2] |= STAMPED
    does[[5, 9, 13, 17]] |= SET, SAVED, ESTIMATE, TIME
    t = controller.t + (np.arange(MEASURED_CALLS) + 20.0 * (np.arange(MEASURED_CALLS) >= 17)) * controller.dt
    return Test(does, t, t, np.array(X), np.array(u[:U_ROWS]))


def _growth(controller: Controller, test: Test) -> float:
    """The largest error of U, of its size, over a relative error of the samples; infinity where one is refused anew."""
    U, _ = answers(controller, test)
    size = np.nanmax(np.abs(U), axis=0)
    return max(float(_grown(U, answers(controller, turned)[0], size).max()) for turned in _turned(test))


def _turned(test: Test) -> Iterator[Test]:
    """The test with errors of its samples."""
    random = generator(0, "self-test", "growth")
    for _ in range(2):
        yield test._replace(X=test.X * (1 + TURNED * random.uniform(-1, 1, test.X.shape)))


def _grown(numbers: np.ndarray, turned: np.ndarray, size: np.ndarray) -> np.ndarray:
    """That of each call, from its numbers and those with such errors."""
    apart = np.abs(turned - numbers) / np.where(size > 0, size, 1.0) / TURNED
    apart = np.where(np.isnan(turned) != np.isnan(numbers), np.inf, np.nan_to_num(apart))
    return apart.max(axis=1)
