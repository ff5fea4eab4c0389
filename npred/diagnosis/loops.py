"""Loops of a case: how they end, and their simulation from the box until they settle or are seen not to.

A loop *settles* if it stays within HOME of its target. One that does not settle *still converges*, *rests elsewhere*,
*swings* between the same ends (a limit cycle), *still moves away* at the end of the longest time simulated, or
*diverges*: it leaves every bound, that is, overflows or is farther than FAR boxes from its target. Only the last word
says that a loop is not bounded, and it is never said of a loop that is near.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from npred.base import randomness
from npred.diagnosis.case import MOST, SPAN, STEP, Case
from npred.loop.closed_loop import simulate
from npred.loop.trajectories import Trajectories
from npred.prediction.methods import RK4

LOOPS = 64  # starts, of the states of the box
STABLE = 2.0  # the longest step of RK4 that is stable, times the fastest rate on the box
HOME = 0.01  # share of the box, 2 % of half of it: this close to its target a loop has settled
FOLLOWS = 0.05  # share of the box: so near a loop follows its reference, for held commands are late by dt / 2
FALLING = 0.9  # a loop that still converges is this much closer in the last quarter than in the second

STARTS, CORNERS, INSIDE = 16, 8, 0.99  # loops of a D_hat, those from corners of the box, which are so near its ends
FIRST, TIMES = 8.0 / SPAN, 16  # share of the horizon that is looked at first, and how many times that at most
DELAYS = 10  # delays that a loop lasts at least: a stiff plant's would take too many steps
STEPS, NODES = (10, 50), 41  # control steps in D and nodes of the prediction, at least
FINE = 20  # control steps in a step of RK4, which are as many as it takes
WORK = 5e5  # nodes times control steps of a loop, at most
FAR = 1e6  # times the box: a loop that is so far away diverges: a rest or a swing is nearer, whatever pushes it
LARGEST = 6  # states up to which a plant is asked without a pipeline: the kernels of larger ones compile for a minute


class Fate(NamedTuple):
    """When each loop (B,) settles, infinite if it does not; which of the others come nearer, and which grow."""

    seconds: np.ndarray
    nearing: np.ndarray
    growing: np.ndarray

    @property
    def settled(self) -> np.ndarray:
        return np.isfinite(self.seconds)

    @property
    def converges(self) -> np.ndarray:
        """True for loops that have settled, or still come nearer."""
        return self.settled | self.nearing

    def text(self, case: Case) -> str:
        """How long the settled loops took."""
        times = self.seconds[self.settled]
        typical, slowest = (case.plant.time_text(time, ".3g") for time in (np.median(times), times.max()))
        return f"settle in {typical} (median), {slowest} (slowest)"

    @property
    def figures(self) -> dict[str, Any]:
        """The shares, and the times, by name."""
        times = self.seconds[self.settled]
        return {
            "settled": float(self.settled.mean()),
            "still_converging": float(self.nearing.mean()),
            "settling_time_median": float(np.median(times)) if times.size else None,
            "settling_time_largest": float(times.max()) if times.size else None,
        }


def numbers(names: Sequence[str], values: np.ndarray) -> dict[str, float | None]:
    """Values by name for a document, None where one is not finite."""
    return {name: value if math.isfinite(value) else None for name, value in zip(names, values.tolist(), strict=True)}


def fate(case: Case, X: np.ndarray, seconds: float, near: float = HOME, target: np.ndarray | None = None) -> Fate:
    """The fate of loops X (B, nt, n) over `seconds`: settled are those within `near` for the last quarter.

    That is of the plant's target, or of another (n,) that is given.
    """
    gaps = distances(case, X, seconds, target)
    _, middle, _, end = (part.max(axis=1) for part in np.array_split(gaps, 4, axis=1))
    outside = ~(gaps <= near)
    last = np.where(outside.any(axis=1), gaps.shape[1] - np.argmax(outside[:, ::-1], axis=1), 0)
    settles = np.where(end <= near, last * seconds / (gaps.shape[1] - 1), np.inf)
    return Fate(settles, ~(end <= near) & (end < FALLING * middle), ~(FALLING * end <= middle))


def distances(case: Case, X: np.ndarray, seconds: float, target: np.ndarray | None = None) -> np.ndarray:
    """Distances of loops X (B, nt, n) from their target, in widths of the box, (B, nt)."""
    if target is None:
        target = case.plant.target(np.linspace(0.0, seconds, X.shape[1]))
    with np.errstate(all="ignore"):
        return np.linalg.norm((X - target) / case.width, axis=-1)


def run(case: Case, D_hat: float | np.ndarray, X0: np.ndarray, t_end: float, dt: float, **parts: Any) -> Trajectories:
    """Loops of the case from X0 (B, n), predicted by the exact model over D_hat, one or (B,)."""
    delays = {"D": case.D, "D_hat": D_hat}
    if case.plant.declares_delay:
        delays = {"D_hat": 0.0} if np.all(D_hat == 0) else {}
    parts = {"u0": case.u0, "actuator": "history", "input_bounds": case.limits} | delays | parts
    exact = RK4(case.plant, nodes(case, float(np.max(D_hat))))
    return simulate(case.plant, exact, X0=X0, t_end=t_end, dt=dt, progress=False, **parts)


def nodes(case: Case, D_hat: float) -> int:
    """The nodes of the prediction, with which RK4 is stable."""
    return 2 if D_hat == 0 else max(NODES, math.ceil(STEP * D_hat / case.times[0] / STABLE) + 1)


def step(case: Case, steps: tuple[int, int] = STEPS) -> float:
    """The control step of simulated loops, of which there are so many in D: the first number for a slow plant."""
    h = case.times[0]
    return min(h, max(case.D / steps[1], min(case.D / steps[0], h / FINE)))


def applies(case: Case) -> bool:
    """True where loops of kappa lead somewhere, and to simulate them takes no more than moments."""
    small = case.experiment is not None or case.plant.n <= LARGEST
    simple = case.plant.traced and small and case.sound and case.leads == "yes"
    return simple and spans(case, case.D)[1] > DELAYS * case.D


def starts(case: Case) -> np.ndarray:
    """Corners of the box and states within, (STARTS, n)."""
    n, rng = case.plant.n, randomness.generator(0, "corners")
    sides = (
        2 * np.indices((2,) * n).reshape(n, -1).T - 1 if 2**n <= CORNERS else np.sign(rng.uniform(-1, 1, (CORNERS, n)))
    )
    corners = case.ends.mean(axis=1) + INSIDE * sides * np.ptp(case.ends, axis=1) / 2
    return np.concatenate([corners, case.X[: STARTS - len(corners)]])


@dataclass(frozen=True)
class Ensemble:
    """Loops (B,) with a constant D_hat: their fates, how long each was looked at, and whether it oscillates at the end.

    `last_low`, `last_high` are the ends (B, n) between which the states are in the last quarter, `low`, `high` those at
    any time, `past` is how far each went past its target. `enough` is how long the slowest linear motion takes.
    """

    case: Case
    D_hat: float
    enough: float
    fate: Fate
    looked: np.ndarray
    oscillates: np.ndarray
    low: np.ndarray
    high: np.ndarray
    last_low: np.ndarray
    last_high: np.ndarray
    past: np.ndarray

    @property
    def far(self) -> np.ndarray:
        """True (B,) for loops that overflow, or soon will."""
        target = self.case.plant.target(0.0)
        reach = np.maximum(self.last_high - target, target - self.last_low) / self.case.width
        return ~(reach.max(axis=1) < FAR)

    @property
    def diverges(self) -> np.ndarray:
        """True (B,) for loops that leave every bound."""
        return ~self.fate.converges & self.far

    @property
    def leaving(self) -> np.ndarray:
        """True (B,) for loops that still move away, and are not far: they may rest, swing or diverge later."""
        return self.fate.growing & ~(self.fate.converges | self.far)

    @property
    def swings(self) -> np.ndarray:
        """True (B,) for loops that oscillate between the same ends."""
        return self.oscillates & ~(self.fate.converges | self.fate.growing | self.far)

    @property
    def still(self) -> np.ndarray:
        """True (B,) for loops that no longer move."""
        return ~self.far & ((self.last_high - self.last_low) / self.case.width <= HOME).all(axis=1)

    @property
    def steady(self) -> np.ndarray:
        """True (B,) for loops that do not settle, and have come to rest elsewhere."""
        return self.still & (self.looked >= self.enough) & ~(self.fate.converges | self.fate.growing)

    @property
    def fails(self) -> np.ndarray:
        """True (B,) for loops that were seen not to settle."""
        return self.swings | self.diverges | self.steady | self.leaving

    @property
    def offset(self) -> np.ndarray:
        """How far the first loop ends from the target of t = 0, (n,)."""
        return (self.last_low + self.last_high)[0] / 2 - self.case.plant.target(0.0)

    @property
    def overshoot(self) -> np.ndarray:
        """How far each state goes past its target, (n,), in units of the state."""
        return self.past.max(axis=0)

    def text(self) -> str:
        """How the loops end, in words."""
        fate, looked = self.fate, self.case.plant.time_text(self.looked.max(), ".3g")
        parts = {
            f"still converge after {looked}": fate.nearing,
            f"have not settled after {looked}, the longest time simulated": ~(fate.converges | self.fails),
            "diverge": self.diverges,
        }
        if fate.settled.any():
            parts = {fate.text(self.case): fate.settled, **parts}
        if self.swings.any():
            low, high = self.last_low[self.swings].min(axis=0), self.last_high[self.swings].max(axis=0)
            i = int(np.argmax((high - low) / self.case.width > HOME))  # the first state that swings
            name = self.case.plant.states[i]
            parts[f"swing, {name} between {low[i]:.3g} and {self.case.amount(name, high[i])}"] = self.swings
        if self.leaving.any():
            target = self.case.plant.target(0.0)
            reach = np.maximum(self.last_high - target, target - self.last_low)[self.leaving].max(axis=0)
            i = int(np.argmax(reach / self.case.width))
            name = self.case.plant.states[i]
            away = f"{name} by then {self.case.amount(name, reach[i])} from its target"
            parts[f"still move away after {looked}, {away}"] = self.leaving
        if self.steady.any():
            rest = (self.last_low + self.last_high)[np.argmax(self.steady)] / 2
            parts[f"rest elsewhere, as at {self.case.state(rest)}"] = self.steady
        shares = {words: "all" if of.all() else f"{of.mean():.0%}" for words, of in parts.items() if of.any()}
        return ", ".join(f"{share} {words}" for words, share in shares.items())

    @property
    def figures(self) -> dict[str, Any]:
        """How the loops end, as numbers by name."""
        states = self.case.plant.states
        return {
            "D_hat": self.D_hat,
            **self.fate.figures,
            "swinging": float(self.swings.mean()),
            "resting_elsewhere": float(self.steady.mean()),
            "moving_away": float(self.leaving.mean()),
            "diverging": float(self.diverges.mean()),
            "overshoot": numbers(states, self.overshoot),
            "last_low": numbers(states, self.last_low.min(axis=0)),
            "last_high": numbers(states, self.last_high.max(axis=0)),
        }


def ensemble(case: Case, D_hat: float) -> Ensemble:
    """Loops from the box with a constant D_hat, simulated once for all questions."""
    if D_hat not in case.ensembles:
        near = HOME if case.plant.rests else FOLLOWS
        case.ensembles[D_hat] = simulated(case, D_hat, starts(case), near)
    return case.ensembles[D_hat]


def simulated(
    case: Case, D_hat: float, X0: np.ndarray, near: float = HOME, target: np.ndarray | None = None, **parts: Any
) -> Ensemble:
    """Loops from X0 (B, n), each longer and longer until it settles, diverges, or neither comes nearer nor grows.

    Fates are about the plant's target, or about another (n,) that is given.
    """
    plant, dt, lanes, count = case.plant, step(case), np.arange(len(X0)), len(X0)
    fates = Fate(np.full(count, np.inf), np.zeros(count, bool), np.zeros(count, bool))
    looked, oscillates, ends = np.zeros(count), np.zeros(count, bool), np.zeros((5, count, plant.n))
    enough, most = spans(case, D_hat)
    t_end = first = min(enough, most / 2)
    while True:
        loops = run(case, D_hat, X0[lanes], t_end, dt, **parts)
        X, late, now = loops.X, loops.X[:, -(loops.X.shape[1] // 4) :], fate(case, loops.X, loops.t[-1], near, target)
        for each, values in zip(fates, now, strict=True):
            each[lanes] = values
        with np.errstate(all="ignore"):
            error = X - plant.target(loops.t)
            past = (-np.sign(error[:, :1]) * error).max(axis=1, initial=0.0)
        looked[lanes], oscillates[lanes] = t_end, _oscillates(late, case.width)
        ends[:, lanes] = X.min(axis=1), X.max(axis=1), late.min(axis=1), late.max(axis=1), past
        result = Ensemble(case, D_hat, enough, fates, looked, oscillates, *ends)
        unsure = ~now.settled & ~result.far[lanes] & (now.nearing | now.growing | (t_end == first))
        if not unsure.any() or 2 * t_end > most:
            return result
        lanes, t_end = lanes[unsure], 2 * t_end


def spans(case: Case, D_hat: float) -> tuple[float, float]:
    """How long the slowest linear motion takes to settle, and how long loops are looked at, at most."""
    enough, dt = case.D + D_hat + FIRST * case.times[2], step(case)
    return enough, min(TIMES * enough, dt * WORK / nodes(case, D_hat), dt * MOST)


def _oscillates(X: np.ndarray, width: np.ndarray) -> np.ndarray:
    """True (B,) where a state of X (B, nt, n) is, in both halves of the time, in much the same range."""
    first, second = np.array_split(X, 2, axis=1)
    low, high = np.maximum(first.min(axis=1), second.min(axis=1)), np.minimum(first.max(axis=1), second.max(axis=1))
    span = np.ptp(X, axis=1)
    return ((span > HOME * width) & (high - low > span / 2)).any(axis=1)
