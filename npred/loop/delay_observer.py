"""npred's law for an actuator that nobody measures: observers of the state, one per candidate of the delay.

Each candidate θ has an observer that is driven by the controller's own commands, late by θ,
    x' = f(x, U(t - θ) + d) + L (X - x),   d' = L ω G⁺(X - x),   G = f_U,
where d absorbs a disturbance at the input. The candidate whose predictions have the smallest errors is the delay. Of
each state the squares of these errors are summed with the forgetting times `memory` and `window`, and divided by the
smallest such sum of all candidates, so that no unit and no noise level has to be given. The estimate moves only while
the candidates differ: where the commands tell them nothing, it stays. Two rules say what an old error is worth, by what
the errors in the window tell, w, and those in the memory, W, each the largest cost of a candidate:
    J' = r (e² - J / memory),   r = min(1, 2 w / W),
so that little movements, of a disturbance at rest say, replace the errors of a transient only slowly; and where w is of
the size of W, errors in the window far above their level, and far above those of another candidate, mean that the delay
has changed: the memory starts again from the window. All that is in npred.loop.delay_candidates.

Errors, and all that follows from them, come from samples of the state only: a state that is predicted between two
samples, with commands that are read at D_hat, would confirm that D_hat. Between samples the observers go on by the
commands, and the gains are those of the time since the last one. A sample that arrives late is that of the step
at which it was taken, and the observers run that much behind.

Nothing is proven about this law; the nearest theory is that of multiple-model estimation with hysteresis switching
[Morse, Mayne, Goodwin, IEEE TAC 37 (1992) 1343]. docs/delay_laws.md says what was measured.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from npred import array_checks, json_files
from npred.delays import family, family_of
from npred.delays.family import Kernel
from npred.errors import ConfigError
from npred.loop import delay_candidates
from npred.loop.delay_candidates import COUNT, NUMBERS, begin, decide, gains, parts
from npred.loop.delay_law import DelayLaw
from npred.plants.base import Plant
from npred.plants.black_box import difference
from npred.predictors.heun import Heun
from npred.symbolic import kernels, programs
from npred.symbolic.tape import M
from npred.symbolic.trace import Trace

# The decision of all plants, which each plant's kernel calls: with its text changes the kernel's.
DECISION = f"from npred.loop.delay_candidates import *  # {json_files.sha256(Path(delay_candidates.__file__))}\n"
OBSERVE = """\
    n, lanes = X.shape
    rows, m, count = held.shape[0], held.shape[1], int(law[COUNT])
    {parameters}
    if np.isnan(memory[memory.shape[0] - 1, 0]):
        begin(X, memory, count, n, m)
        return
    x, d, long, short, floor, level, scale, calls, pace, gap = parts(memory, count, n, m)
    newest = (k - 1) % rows  # of the commands; rows before the first are counted from the last, as NumPy does
    gain = np.empty((4, lanes))
    gains(X, dt, law, calls, gap, gain)
    h = dt
    t = t - h
    for i in range(count):
        for l in range(lanes):
            {candidate}
    decide(X, long, short, floor, level, scale, calls, pace, gain, law, law[NUMBERS + count * m :], D_hat)
"""


@dataclass(frozen=True)
class DelayObserver(DelayLaw):
    """D_hat from X and the controller's own commands, by a bank of observers, one per candidate of the delay.

    `bounds` (seconds) are the candidates' range, `candidates` how many they are at most, `L` (1/s) the rate at which an
    observer follows X, `omega` (1/s) that at which its disturbance follows, `memory` and `window` (s) the forgetting
    times. gamma and b, which the laws of a pipeline have, mean nothing here.
    Raises ConfigError for settings that make no sense.
    """

    candidates: int = 80
    L: float = 3.0
    omega: float = 8.0
    memory: float = 5.0
    window: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        rates = array_checks.floats("adaptation: L, memory, window", (self.L, self.memory, self.window))
        if not (rates > 0).all() or not 0 <= array_checks.number("adaptation: omega", self.omega) < math.inf:
            raise ConfigError(f"adaptation: expected L, memory, window > 0 and omega >= 0, got {self}; give others")
        if not isinstance(self.candidates, int | np.integer) or self.candidates < 3:
            raise ConfigError(f"adaptation: expected at least 3 candidates, got {self.candidates!r}; raise it")

    def check(self, plant: Plant) -> None:
        family_of(plant).needs("observer")

    def rate(
        self, plant: Plant, X: np.ndarray, u: np.ndarray, P: np.ndarray, D_hat: np.ndarray, t: float
    ) -> np.ndarray:  # fmt: skip
        """It has none: the estimate comes from the commands, which `rate` does not see. Raises ConfigError."""
        raise ConfigError("adaptation DelayObserver: expected a loop that runs its observers, got a call of rate")

    def thetas(self, dt: float) -> np.ndarray:
        """The candidates (K,), in seconds: whole control steps apart, from bound to bound."""
        low, high = (round(bound / dt) for bound in self.bounds)
        stride = max(1, math.ceil((high - low) / (self.candidates - 1)))
        return np.arange(low, max(high, low + 2 * stride) + 1, stride) * dt

    def ends(self, dt: float) -> tuple[float, float]:
        """Half a candidate inside the bounds: it goes no nearer from inside."""
        thetas = self.thetas(dt)
        half = (thetas[1] - thetas[0]) / 2
        return self.bounds[0] + half, self.bounds[1] - half

    def observer(self, plant: Plant, dt: float) -> tuple[Kernel, np.ndarray, int]:
        thetas = self.thetas(dt)
        count, n, m = len(thetas), plant.n, plant.m
        leak, fade = 1 - math.exp(-dt / self.memory), math.exp(-dt / self.window)
        shifts = np.rint(thetas[:, None] * plant.ratios / dt).ravel()
        follow = 1 - math.exp(-self.L * dt), self.L * self.omega * dt
        settings = [count, *follow, leak, fade, 2 * self.window / dt, *self.bounds]
        kernel = _traced(plant) if plant.traced else _called(plant)
        return kernel, np.array([*settings, *shifts, *thetas], dtype=float), delay_candidates.size(count, n, m)


def _traced(plant: Plant) -> Kernel:
    """OBSERVE of a plant, compiled: its candidates step by Heun's method with the input held."""
    n, m, trace = plant.n, plant.m, Trace(plant)
    x, u, t, h = trace.vector("x", n), trace.vector("v", m), trace.input("t"), trace.input("h")
    y = Heun.step(trace.f, x, u, u, u, t, h)
    e = [M.where(trace.input("s") > 0, trace.input(f"X{c}") - y[c], 0.0) for c in range(n)]  # no sample, no error
    weights = [1.0 / trace.input(f"w{c}") for c in range(n)]
    along = trace.f(x, u, t)
    G = [programs.derivative(along, list(u), list(unit)) for unit in np.eye(m)]
    power = sum(g * w * g for column in G for g, w in zip(column, weights, strict=True)) + 1e-300
    moves = [sum(g * w * r for g, w, r in zip(column, weights, e, strict=True)) / power for column in G]
    names = {f"x{c}": f"x[i, {c}, l]" for c in range(n)} | {f"X{c}": f"X[{c}, l]" for c in range(n)}
    names["s"] = "gain[0, l]"
    names |= {f"w{c}": f"floor[{c}, l]" for c in range(n)}
    for c in range(m):
        late = f"newest - int(law[NUMBERS + i * {m} + {c}])"
        names[f"v{c}"] = f"(held[{late}, {c}, l] + d[i, {c}, l])"
    targets = [f"{name}{c}" for name, size in (("y", n), ("e", n), ("g", m)) for c in range(size)]
    lines = programs.lines([*y, *e, *moves], names, targets)
    for c in range(n):
        lines += [f"long[i, {c}, l] += pace[l] * (e{c} * e{c} - gain[2, l] * long[i, {c}, l])"]
        lines += [f"short[i, {c}, l] = gain[3, l] * short[i, {c}, l] + e{c} * e{c}"]
        lines += [f"x[i, {c}, l] = y{c} + gain[0, l] * e{c}"]
    lines += [f"d[i, {c}, l] += gain[1, l] * g{c}" for c in range(m)]
    source = kernels.fill(OBSERVE, parameters=kernels.parameters(len(plant.p)), candidate=lines)
    return family.build("observe", family.OBSERVE, source, DECISION)


def _called(plant: Plant) -> Kernel:
    """OBSERVE of a plant that is not traced: the same formulas on arrays, G by differences."""
    n, m, units = plant.n, plant.m, np.eye(plant.m)

    @np.errstate(all="ignore")
    def observe(
        k: int, dt: float, X: np.ndarray, held: np.ndarray, t: float, p: np.ndarray, law: np.ndarray,
        memory: np.ndarray, D_hat: np.ndarray,
    ) -> None:  # fmt: skip
        count = int(law[COUNT])
        if np.isnan(memory[-1, 0]):
            return begin(X, memory, count, n, m)
        x, d, long, short, floor, level, scale, calls, pace, gap = parts(memory, count, n, m)
        gains(X, dt, law, calls, gap, gain := np.empty((4, X.shape[1])))
        shifts = law[NUMBERS : NUMBERS + count * m].astype(int).reshape(count, m)
        states, inputs = np.moveaxis(x, 1, -1), np.moveaxis(held[(k - 1 - shifts) % len(held), np.arange(m)] + d, 1, -1)
        y = Heun.step(plant.f, states, inputs, inputs, inputs, t - dt, dt)
        e, w = np.where(np.isnan(X.T), 0.0, X.T - y), 1.0 / floor.T
        G = [difference(lambda v: plant.f(states, v, t - dt), inputs, np.broadcast_to(v, inputs.shape)) for v in units]
        power = sum((w * g * g).sum(axis=-1) for g in G) + 1e-300
        for c, g in enumerate(G):
            d[:, c] += gain[1] * (w * g * e).sum(axis=-1) / power
        squares = np.moveaxis(e * e, -1, 1)
        long += pace * (squares - gain[2] * long)
        short[:] = gain[3] * short + squares
        x[:] = np.moveaxis(y + gain[0][:, None] * e, -1, 1)
        return decide(X, long, short, floor, level, scale, calls, pace, gain, law, law[NUMBERS + count * m :], D_hat)

    return observe
