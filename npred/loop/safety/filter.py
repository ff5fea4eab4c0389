"""The kernel of the safety filter, and the grid of time over which it rolls loops out."""

import re
import time
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from npred.base.errors import ConfigError
from npred.formulas import Value, programs, tape
from npred.kernels.formula import Formulas, vector
from npred.kernels.kernel import Kernel, made, skeleton
from npred.plants import inputs
from npred.plants.base import Plant
from npred.prediction.delays import problem

STEPS, HELD, BLOCKS = 64, 8, 7  # of a rollout: its steps, those that hold U over a control step, the pieces of a plan
GROWTH = 1.2  # from step to step, up to
LONGEST = 0.6  # times the fastest rate of the loop
SPAN = 6.0  # the horizon, times the slowest rate, where that many steps reach so far
RISE = 0.1  # of the horizon: how soon a plan has its whole reserve
ERROR = 1e-6  # of the box: what a predicted state may err by
DRAWN = 256  # states of the box
SURVEYED, REPEATED = 12, 2  # states that a survey looks at, and how often each is timed
SHARE = 0.5  # of dt: what a step of the filter may take
TINY = 1e-6  # a rate that is none
AHEAD = (0.0, 0.0, 3.0, -1.0, -2.0, -8.0, -8.0, -8.0)  # how far ahead brakes rest, over the slowest rate
MANY = len(AHEAD)
TURNING = 2  # the last ones, which brake until they are slow, then hold that or let kappa go on
FOREVER = 1e9  # horizons, in which no plan ends
OVER = 100.0  # horizons in which a loop that ever rests no longer depends on time
LATE, LATER = 64, 10.0  # moments after a plan at which limits that depend on time are looked at, in so many horizons
TAIL, PARTS = 192, 6  # steps beyond the grid in which a plan is to rest, and the parts after which it is asked
OPERATIONS = re.compile(r" [-+*/] |\b[a-z_]+\(")
LARGEST = 64 << 17  # numbers of scratch memory, of 8 bytes


@cache
def kernel(plant: Plant, ends: int) -> Kernel:
    """npred.prediction.delays.problem.PROTECT of a plant, for so many predicted states."""
    n, m, K, needed = plant.n, plant.m, plant.limits, scratch(plant, ends)
    if needed > LARGEST:
        what = f"expected plans of at most {LARGEST >> 17} MB, got {needed >> 17} MB for {K} limits and {m} inputs"
        raise ConfigError(f"safety: {what}; declare fewer limits")
    of, functions = formulas(plant)
    variables, rows = BLOCKS * m, conditions(plant)
    x, u, t = of.trace.vector("x", n), of.trace.vector("u", m), of.trace.input("t")
    timed, moves = (programs.depends([*values], [t]) for values in (of.trace.safe(x, t), of.trace.f(x, u, t)))
    sizes = {"N": n, "M": m, "K": K, "ENDS": ends, "STEPS": STEPS, "HELD": HELD, "BLOCKS": BLOCKS}
    sizes |= {"VARIABLES": variables, "ROWS": rows, "ACTIVE": 2 * variables, "WORK": needed}
    sizes |= {"MANY": MANY, "TURNING": TURNING, "TAIL": TAIL, "PARTS": PARTS}
    sizes |= {"PARAMETERS": len(plant.p_names), "TIMED": int(timed), "TIMES": LATE if timed or not plant.rests else 1}
    sizes |= {"MOVES": int(timed or moves)}
    text = "".join(skeleton(f"{name}.h") for name in ("nearest", "plans", "resting", "replan", "protect"))
    return made("protect", problem.PROTECT, text, functions, sizes, before=of.called(), work=lambda *of: needed)


@cache
def formulas(plant: Plant) -> tuple[Formulas, dict[str, str]]:
    """The functions of a plant's kernel."""
    n, m, K = plant.n, plant.m, plant.limits
    of = Formulas(plant)
    trace = of.trace
    x, u, v, t, h = trace.vector("x", n), trace.vector("u", m), trace.vector("v", m), trace.input("t"), trace.input("h")
    low, high, before, lag = trace.vector("l", m), trace.vector("h", m), trace.vector("r", n), trace.input("lag")
    until, w = trace.input("until"), trace.vector("w", m)

    def within(U: np.ndarray) -> np.ndarray:
        clipped = [tape.M.minimum(tape.M.maximum(a, b), c) for a, b, c in zip(U, low, high, strict=True)]
        return np.array(clipped, dtype=object)

    def along(x: np.ndarray, before: np.ndarray, t: Value) -> np.ndarray:
        """f with kappa in its bounds, which is held: it is as late as half a control step."""
        U = within(within(trace.kappa(x - lag * before, tape.M.minimum(t - lag, until)) + w) + v)
        return trace.f(x, U, t)

    def step(rate: Callable[..., np.ndarray]) -> list[Value]:
        """The state at the end of a step of RK4, and in its middle (Hairer, Nørsett, Wanner, II.6.22)."""
        k1 = rate(x, before, t)
        k2 = rate(x + h / 2 * k1, k1, t + h / 2)
        k3 = rate(x + h / 2 * k2, k2, t + h / 2)
        k4 = rate(x + h * k3, k3, t + h)
        states = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), x + h / 24 * (5 * k1 + 4 * k2 + 4 * k3 - k4)
        return [value for state in states for value in plant.stopped([*state], tape.M)]

    results = {"y": n, "middle": n}
    bounds = vector("low", m, "1", "l"), vector("high", m, "1", "h")
    functions = {
        "LAW": of.function(trace.kappa(x, t), [vector("x", n), "t"], {"U": m}),
        "LIMITS": of.function([*trace.safe(x, t)], [vector("x", n), "t"], {"h": K}),
        "STEP": of.function(
            step(lambda x, before, t: trace.f(x, u, t)), [vector("x", n), vector("u", m), "t", "h"], results
        ),
        "ALONG": of.function(
            step(along),
            [vector("x", n), vector("w", m), vector("v", m), vector("r", n), *bounds, "lag", "until", "t", "h"],
            results,
        ),
    }
    return of, functions


def scratch(plant: Plant, ends: int) -> int:
    """The numbers of scratch memory of the kernel: the Rollouts of npred/kernels/c/protect.h."""
    n, m, K, variables = plant.n, plant.m, plant.limits, BLOCKS * plant.m
    rows, side, points = conditions(plant), variables + 1, 2 * n + 1
    lanes = max(side + ends - 1, ends * MANY)
    abreast = lanes * (4 * n + 4 * m + 6 * K + variables + 6)
    ball = points * (3 * n + 2 * m + K) + 3 * n * n + 2 * max(n, m) ** 2 + 2 * m
    solved = 2 * rows + 4 * variables**2 + 7 * variables + 2
    planned = abreast + rows * side + 7 * variables + BLOCKS + 4
    return planned + max(ball, solved) + ends * (n + 1) + m + remembered(plant)


def conditions(plant: Plant) -> int:
    """Those of a plan: of each limit at the end and in the middle of a step, and on v."""
    return STEPS * 2 * plant.limits + 2 * BLOCKS * plant.m


def remembered(plant: Plant) -> int:
    """The numbers that a loop remembers: the Memory of npred/kernels/c/plans.h."""
    return 2 * BLOCKS * (plant.m + 1) + 2 * plant.m + plant.n + len(plant.p_names) + 5


def operations(plant: Plant, ends: int) -> int:
    """Floating-point operations of the longest step at most: rollouts of the law alone, a plan (twice with variables
    that are moved), three sets of brakes, two plans that are looked at again; whether they rest; the programmes of a
    plan. A call of a function counts as one.
    """
    n, m, K, (of, functions) = plant.n, plant.m, plant.limits, formulas(plant)
    one = {name: len(OPERATIONS.findall(text)) for name, text in functions.items()}
    if of.called():
        one = {name: count + sum(map(len, map(OPERATIONS.findall, of.called()))) for name, count in one.items()}
    variables, steps = BLOCKS * m, (3 + 3 * MANY) * (STEPS + TAIL)
    lanes = ends * (steps + 3 * STEPS) + 2 * (variables + ends) * STEPS
    rolled = lanes * (max(one["STEP"], one["ALONG"]) + one["LAW"] + 6 * one["LIMITS"] + 30 * K + 8 * m + 3 * n)
    checks, moments = ends * (3 + 3 * MANY) * (PARTS + 1), 1 if plant.rests else LATE
    points = 2 * moments * (2 * n + 1) * (one["STEP"] + one["LAW"] + one["LIMITS"] + 6 * m)
    rested = checks * (points + 24 * 6 * n**3 + 4 * moments * n**3)
    rows, active = conditions(plant), 2 * variables
    solved = 3 * active * (3 * rows * variables + 2 * active**2 * variables + active**3 // 3 + 2 * active**2)
    return int(rolled + rested + 2 * (6 * rows * variables + solved))


class Survey(NamedTuple):
    """Of states in the box that a command may meet: how many are within the limits, of these how many are promised, and
    the longest step of the kernel in seconds.
    """

    inside: int
    promised: int
    longest: float
    ends: int = 1

    def doubts(self, dt: float, unit: float) -> list[str]:
        """What a user should know before the first command, dt being in units of so many seconds."""
        texts = []
        if self.ends > 1:
            texts.append("with delay above 0 nothing is promised for good: kappa reads a prediction that may be wrong")
        elif self.inside and not self.promised:
            texts.append(f"of {self.inside} states of the box within the limits none is promised to keep them for good")
        if self.longest > SHARE * dt * unit:
            cure = "declare fewer limits, take delay = 0 or a shorter horizon, or lengthen dt"
            texts.append(f"its longest step took {self.longest:.2g} s here, dt is {dt * unit:.2g} s; {cure}")
        return [f"safety: {text}" for text in texts]


@cache
def survey(plant: Plant, ends: int, values: tuple[float, ...], bounds: tuple[tuple[float, float], ...]) -> Survey:
    """A survey of the kernel of a plant, with its numbers, one state at a time."""
    X = plant.drawn("limits", DRAWN)
    with np.errstate(all="ignore"):
        X = X[(plant.safe(X) > values[plant.n]).all(axis=-1)][:SURVEYED]
    protect, p, longest, promised = kernel(plant, ends), plant.p, 0.0, 0
    low, high = (np.ascontiguousarray(side[:, None]) for side in np.array(bounds).T)
    for x in X:
        took = np.inf
        for _ in range(REPEATED):
            at = np.repeat(x[None, :, None], ends, axis=0).copy(), np.zeros((ends, 1)), p, np.array(values), low, high
            U, plan = np.array(plant.kappa(x), dtype=float)[:, None].copy(), np.zeros((remembered(plant), 1))
            results = [np.zeros(1) for _ in range(5)]
            start = time.perf_counter()
            protect(*at, U, plan, *results)
            took = min(took, time.perf_counter() - start)
        longest, promised = max(longest, took), promised + int(results[3][0])
    return Survey(len(X), promised, longest, ends)


def numbers(
    plant: Plant, dt: float, input_bounds: ArrayLike, margin: float, alpha: float | None, horizon: float | None
) -> np.ndarray:
    """What npred/kernels/c/protect.h reads, in the order there: sizes, and the grid of time."""
    X = plant.drawn("limits", DRAWN)
    box, (fastest, slowest) = np.ptp(X, axis=0), rates(plant, X)
    lengths = np.minimum(dt * GROWTH ** np.maximum(np.arange(STEPS) - HELD + 1, 0), max(LONGEST / fastest, dt))
    longest, held, total = lengths[-1], HELD * dt, min(lengths.sum(), horizon or SPAN / slowest)
    lengths[HELD:] *= max(total - held, dt) / lengths[HELD:].sum()
    ends = np.cumsum(lengths)
    edges = np.maximum(ends[-1] / 2.0 ** np.arange(BLOCKS)[::-1], dt * np.arange(1, BLOCKS + 1))
    decay = np.ones(STEPS) if alpha is None else np.exp(-alpha * ends)
    ramp = 1.0 - np.exp(-np.maximum(ends - held, 0.0) / (RISE * ends[-1]))
    widths = np.ptp(inputs.widest(plant, np.asarray(input_bounds, dtype=float)), axis=1)
    widths = np.where(np.isfinite(widths) & (widths > 0), widths, 1.0)
    with np.errstate(all="ignore"):
        sizes = np.nanmedian(np.abs(plant.safe(X)), axis=0)
    sizes = np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0)
    ahead = np.array(AHEAD) / slowest
    return np.array(
        [
            *(ERROR * box),
            margin,
            dt,
            longest,
            LATER * ends[-1],
            *still(plant, X, ends[-1]),
            *widths,
            *sizes,
            *ahead,
            *lengths,
            *decay,
            *ramp,
            *edges,
        ]
    )


def still(plant: Plant, X: np.ndarray, horizon: float) -> tuple[bool, float]:
    """Whether the loop no longer depends on time, at the latest after OVER horizons, and how long the time of kappa has
    to last for that: a law that tracks is stopped at the horizon.
    """
    times, lasts = OVER * horizon * np.linspace(1, 2, LATE), FOREVER * horizon
    if plant.rests:
        return True, lasts

    def ends(moments: np.ndarray) -> bool:
        F = [np.hstack([plant.f(X, U := plant.kappa(X, s), t), U]) for s, t in zip(moments, times, strict=True)]
        return bool(np.allclose(F, F[0], rtol=1e-9, atol=1e-9 * np.abs(F[0]).max()))

    with np.errstate(all="ignore"):
        if ends(times):
            return True, lasts
        return (True, horizon) if ends(np.full(LATE, times[0])) else (False, lasts)


def rates(plant: Plant, X: np.ndarray) -> tuple[float, float]:
    """The fastest rate of the loop without delay on states X, and the slowest at which it comes to rest."""
    U = plant.kappa(X)
    with np.errstate(all="ignore"):
        f_X, f_U = plant.jacobians(X, U)
        A = f_X + f_U @ plant.kappa_jacobian(X)
        values = np.linalg.eigvals(A[np.isfinite(A).all(axis=(-2, -1))])
    fastest = float(np.quantile(np.abs(values).max(axis=-1), 0.95)) if len(values) else 0.0
    if not fastest > 0:
        return overall(X, plant.f(X, U))
    try:
        at_rest = np.linalg.eigvals(plant.linearised()[0]).real
    except ConfigError:
        at_rest = np.median(np.sort(values.real, axis=-1), axis=0)
    slowest = float(np.min(-at_rest[at_rest < 0], initial=np.inf))
    return fastest, slowest if np.isfinite(slowest) else fastest / 10


def overall(X: np.ndarray, F: np.ndarray) -> tuple[float, float]:
    """The same where no slope tells it, as of a law that switches between two U: of the linear loop that is nearest to
    the rates F on all of X, or of the way across X.
    """
    fits = np.isfinite(F).all(axis=-1)
    X, F = X[fits], F[fits]
    values = np.linalg.eigvals(np.linalg.lstsq(np.column_stack([X, np.ones(len(X))]), F, rcond=None)[0][:-1])
    across = float(np.max(np.abs(F) / np.ptp(X, axis=0), initial=TINY))
    fastest = max(float(np.abs(values).max()), across)
    falling = -values.real[values.real < -TINY]
    return fastest, float(falling.min(initial=fastest)) if len(falling) else fastest / 10
