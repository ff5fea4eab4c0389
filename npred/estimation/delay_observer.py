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
has changed: the memory starts again from the window. All that is in npred/kernels/c/candidates.h.

The rates and times follow from one time T: L = 3 / T, omega = 8 / T, memory = 5 T, window = T. It is the largest of
    high / 4, of the largest delay, for the memory has to hold what all candidates say of one command;
    0.7 / the usual rate of kappa's loop, 0.5 / its slowest rate, and 1 / the rate of a reference (npred.plants.speed),
        for commands that move more slowly than an observer are taken for a disturbance;
    20 control steps, which a window needs.
Of the paper's plant with bounds of 0.1 to 4 s it is 1 s.

A controller that estimates its state from outputs with an observer that is driven by commands late by D_hat has an X
that confirms D_hat. There candidates are judged by the samples Y of the outputs, in
npred/kernels/c/observe_outputs.h: each with a state and an offset,
    x' = f(x, U(t - θ) + d),   x <- x + K_x (Y - y(x)),   d <- d + K_d (Y - y(x)),
with the gain K of one extended Kalman filter along the best candidate. Its variances scale Y - y(x), so that
differences of the sums are differences of log likelihoods [Magill, IEEE TAC 10 (1965) 434]. They are compared with what
noise makes of them, and the memory forgets them only for news.

The spread of D_hat is half the range of the candidates whose sums exceed the smallest one by no more than noise can
explain. With the time since the commands last showed the delay it grows to half the range of the bounds. Where D_hat
stands at a bound, it is the whole range of the bounds.

Errors, and all that follows from them, come from samples of the state only: a state that is predicted between two
samples, with commands that are read at D_hat, would confirm that D_hat. Between samples the observers go on by the
commands, and the gains are those of the time since the last one. A sample that arrives late is that of the step
at which it was taken, and the observers run that much behind.

Nothing is proven about this law; the nearest theory is that of multiple-model estimation with hysteresis switching
[Morse, Mayne, Goodwin, IEEE TAC 37 (1992) 1343]. docs/delay_laws.md says what was measured.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.estimation.delay_law import DelayLaw
from npred.estimation.observers import EKF, Observer
from npred.formulas import programs
from npred.formulas.tape import M
from npred.kernels.formula import Formulas, vector
from npred.kernels.kernel import Kernel, made, skeleton
from npred.plants.base import Plant
from npred.plants.black_box import difference
from npred.plants.speed import of_reference, rates
from npred.prediction.delays import problem, problem_of
from npred.prediction.methods.runge_kutta import Heun

SHARE, SLOW = 0.7, 0.5  # relative to the usual time constant, and to the slowest
FEWEST = 20  # control steps in a window, as npred/kernels/c/candidates.h has them
DIGITS = 9  # of a number of control steps, before it is rounded: half a step is that in any unit of time
NUMBERS = 10  # settings before shifts and thetas, as npred/kernels/c/candidates.h has them


@dataclass(frozen=True)
class DelayObserver(DelayLaw):
    """D_hat from X and the controller's own commands, by a bank of observers, one per candidate of the delay.

    Parameters
    ----------
    gamma : float, default 1.0
        Has no meaning here; laws of a pipeline have it.
    b : float, default 1.0
        Has no meaning here; laws of a pipeline have it.
    bounds : (low, high), in the plant's unit of time, optional
        The range of D_hat; by default 0.1 to 4 times the longest delay of a loop, widened to D and D_hat.
    candidates : int, default 80
        Largest number of candidates of the delay within the bounds.
    L : float, 1 / time, optional
        Rate at which an observer follows X; by default 3 / T, with T of `pace`.
    omega : float, 1 / time, optional
        Rate at which its disturbance follows; by default 8 / T.
    memory : float, in the plant's unit of time, optional
        Forgetting time of errors; by default 5 T.
    window : float, in the plant's unit of time, optional
        Forgetting time of the latest errors; by default T.

    Raises
    ------
    ConfigError
        For settings that make no sense.
    """

    integrates: ClassVar = False
    candidates: int = 80
    L: float | None = None
    omega: float | None = None
    memory: float | None = None
    window: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        values = [1.0 if value is None else value for value in (self.L, self.memory, self.window)]
        omega = array_checks.number("adaptation: omega", 1.0 if self.omega is None else self.omega)
        if not (array_checks.floats("adaptation: L, memory, window", values) > 0).all() or not 0 <= omega < math.inf:
            raise ConfigError(f"adaptation: expected L, memory, window > 0 and omega >= 0, got {self}; give others")
        if not isinstance(self.candidates, int | np.integer) or self.candidates < 3:
            raise ConfigError(f"adaptation: expected at least 3 candidates, got {self.candidates!r}; raise it")

    def check(self, plant: Plant) -> None:
        problem_of(plant).needs("observer")

    def rate(
        self, plant: Plant, X: np.ndarray, u: np.ndarray, P: np.ndarray, D_hat: np.ndarray, t: float
    ) -> np.ndarray:
        """Raises ConfigError: the estimate comes from the commands, which `rate` does not see."""
        raise ConfigError("adaptation DelayObserver: expected a loop that runs its observers, got a call of rate")

    def thetas(self, dt: float) -> np.ndarray:
        """The candidates (K,): whole control steps apart, from bound to bound."""
        low, high = (round(round(bound / dt, DIGITS)) for bound in self.bounds)
        stride = max(1, math.ceil((high - low) / (self.candidates - 1)))
        return np.arange(low, max(high, low + 2 * stride) + 1, stride) * dt

    def ends(self, dt: float) -> tuple[float, float]:
        """Half a candidate inside the bounds: it goes no nearer from inside."""
        thetas = self.thetas(dt)
        half = (thetas[1] - thetas[0]) / 2
        return self.bounds[0] + half, self.bounds[1] - half

    def pace(self, plant: Plant, dt: float) -> tuple[float, float, float, float]:
        """L, omega, memory and window, defaults by the T of the module, high being the upper bound of D_hat."""
        pace = rates(plant)
        slow = [share / rate for share, rate in ((SLOW, pace.slowest), (1.0, of_reference(plant))) if rate > 0]
        T = max(self.bounds[1] / 4, SHARE / pace.usual, FEWEST * dt, *slow)
        defaults = {"L": 3 / T, "omega": 8 / T, "memory": 5 * T, "window": T}
        L, omega, memory, window = (
            default if (value := getattr(self, name)) is None else value for name, default in defaults.items()
        )
        return L, omega, memory, window

    def observer(
        self, plant: Plant, dt: float, of_state: Observer | None = None
    ) -> tuple[Callable[..., None], np.ndarray, int]:
        thetas = self.thetas(dt)
        count, n, m = len(thetas), plant.n, plant.m
        L, omega, memory, window = self.pace(plant, dt)
        leak, fade = 1 - math.exp(-dt / memory), math.exp(-dt / window)
        shifts = np.rint(np.round(thetas[:, None] * plant.ratios / dt, DIGITS)).ravel()
        follow = 1 - math.exp(-L * dt), L * omega * dt
        kernel, compared, first, tail = (_traced if plant.traced else _called)(plant, count), n, 0, ()
        if of_state:
            of = of_state.filter
            kernel, compared, tail = _judging(of, count), len(of.outputs), (*of.settings, *of.start())
            first = count * (n + m) + len(of.start()) + of.size * compared
        settings = [count, compared, first, *follow, leak, fade, 2 * window / dt, *self.bounds]
        size = first + count * (3 * compared + m) + 5 * compared + 6  # numbers of the struct Bank, and those before it
        return kernel, np.array([*settings, *shifts, *thetas, *tail], dtype=float), size


def _traced(plant: Plant, count: int) -> Kernel:
    """OBSERVE of a plant, compiled, for at most `count` candidates: they step by Heun's method with the input held."""
    n, m, of = plant.n, plant.m, Formulas(plant, ())
    trace = of.trace
    x, u, t, h = trace.vector("x", n), trace.vector("v", m), trace.input("t"), trace.input("h")
    X, weights = trace.vector("X", n), [1.0 / unit for unit in trace.vector("w", n)]
    y = Heun.step(trace.f, x, u, u, u, t, h)
    e = [M.where(trace.input("inject") > 0, X[c] - y[c], 0.0) for c in range(n)]  # no sample, no error
    along = trace.f(x, u, t)
    G = [programs.derivative(along, list(u), list(unit)) for unit in np.eye(m)]
    power = sum(g * w * g for column in G for g, w in zip(column, weights, strict=True)) + 1e-300
    moves = [sum(g * w * r for g, w, r in zip(column, weights, e, strict=True)) / power for column in G]
    arguments = [vector("x", n), vector("v", m, "wide"), vector("X", n), vector("w", n), "inject", "t", "h"]
    functions = {"STEP": of.function([*y, *e, *moves], arguments, {"out": 2 * n + m}, "wide")}
    return _compiled(plant, count, functions)


def _judging(of: EKF, count: int) -> Kernel:
    """OBSERVE of a plant whose state is estimated from outputs: the candidates step as those of `_traced`."""
    plant = of.plant
    n, m, formulas = plant.n, plant.m, Formulas(plant, ())
    trace = formulas.trace
    x, u, t, h = trace.vector("x", n), trace.vector("v", m), trace.input("t"), trace.input("h")
    y, late = Heun.step(trace.f, x, u, u, u, t, h), trace.input("late")
    outputs = of.traced_outputs(trace, y + late * (y - x), t + (1 + late) * h)
    arguments = [vector("x", n, "1"), vector("v", m, "1"), "t", "h", "late"]
    functions = {"STEP": formulas.function([*y, *outputs], arguments, {"out": n + len(outputs)}, "1")}
    sizes = {"N": n, "M": m, "SIZE": of.size, "OUTPUTS": len(outputs)}
    return made(
        "observe", problem.OBSERVE, skeleton("observe_outputs.h"), functions, sizes,
        {"FOLLOWED": of.follow, "CORRECTED": of.correct_with_gains},
        before=[skeleton("candidates.h")], work=lambda nx, lanes, _: count,
    )  # fmt: skip


def _called(plant: Plant, count: int) -> Callable[..., None]:
    """OBSERVE of a plant that is not traced: it takes what STEP writes from here, G by differences."""
    n, m, units = plant.n, plant.m, np.eye(plant.m)
    kernel = _compiled(plant, count, {}, 2 * n + m)

    @np.errstate(all="ignore")
    def observe(
        k: int, dt: float, X: np.ndarray, held: np.ndarray, t: float, p: np.ndarray, law: np.ndarray,
        memory: np.ndarray, D_hat: np.ndarray,
    ) -> None:  # fmt: skip
        first, states = np.isnan(memory[-1]), count * n  # f gets no NaN of a memory that has not begun
        x = np.where(first, X, memory[:states].reshape(count, n, -1))
        push = np.where(first, 0.0, memory[states : states + count * m].reshape(count, m, -1))
        floor = memory[3 * states + count * m :][:n]
        shifts = law[NUMBERS : NUMBERS + count * m].astype(int).reshape(count, m)
        x, v = np.moveaxis(x, 1, -1), np.moveaxis(held[(k - 1 - shifts) % len(held), np.arange(m)] + push, 1, -1)
        y = Heun.step(plant.f, x, v, v, v, t - dt, dt)
        e, w = np.where(np.isnan(X.T), 0.0, X.T - y), 1.0 / floor.T
        G = [difference(lambda v: plant.f(x, v, t - dt), v, np.broadcast_to(unit, v.shape)) for unit in units]
        power = sum((w * g * g).sum(axis=-1) for g in G) + 1e-300
        moves = [((w * g * e).sum(axis=-1) / power)[..., None] for g in G]
        moved = np.moveaxis(np.concatenate([y, e, *moves], axis=-1), -1, 1)
        kernel(k, dt, X, held, t, p, law, memory, D_hat, scratch=moved.ravel())

    return observe


def _compiled(plant: Plant, count: int, functions: Mapping[str, str], called: int = 0) -> Kernel:
    """OBSERVE of a plant's state, for at most `count` candidates: `called` numbers of each that come before a call."""
    return made(
        "observe", problem.OBSERVE, skeleton("observe.h"), functions, {"N": plant.n, "M": plant.m, "MOVED": called},
        before=[skeleton("candidates.h")], work=lambda nx, lanes, _: (4 + count * called) * lanes + count,
    )  # fmt: skip
