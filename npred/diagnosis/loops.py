"""Loops of a case: what becomes of them, and their simulation from the box until they settle or are seen not to."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from npred.base import randomness
from npred.diagnosis.case import Case
from npred.loop.closed_loop import simulate
from npred.loop.trajectories import Trajectories
from npred.prediction.methods import RK4

HORIZON = 100.0  # s, over which a reference and its loops are looked at where no experiment says how long
LOOPS = 64  # starts, of the states of the box
STEP, BEARS = 0.5, 2.0  # a step of RK4, times the fastest rate on the box; the longest that is stable
MOST = 20_000  # steps
SPAN = 30.0  # time constants of the slowest rate at the equilibrium
HOME = 0.01  # share of the box, 2 % of half of it: this close to its target a loop has settled
FOLLOWS = 0.05  # share of the box: so near a loop follows its reference, for held commands are late by dt / 2
FALLING = 0.9  # a loop that still converges is this much closer in the last quarter than in the second

STARTS, CORNERS, INSIDE = 16, 8, 0.99  # loops of a D_hat, those from corners of the box, which are so near its ends
FIRST, TIMES = 8.0 / SPAN, 16  # share of the horizon that is looked at first, and how many times that at most
STEPS, NODES = (10, 50), 41  # control steps in D and nodes of the prediction, at least
FINE = 20  # control steps in a step of RK4, which are as many as it takes
WORK = 5e5  # nodes times control steps of a loop, at most
FAR = 1e3  # times the box: a loop that is so far away is lost
LARGEST = 6  # states up to which a plant is asked without a pipeline: the kernels of larger ones compile for a minute


class Fate(NamedTuple):
    """When each loop (B,) settles, infinite where it does not; which of those come nearer, and which grow."""

    seconds: np.ndarray
    nearing: np.ndarray
    growing: np.ndarray

    @property
    def settled(self) -> np.ndarray:
        return np.isfinite(self.seconds)

    @property
    def kept(self) -> np.ndarray:
        """True for loops that have settled, or still converge."""
        return self.settled | self.nearing

    def text(self, case: Case) -> str:
        """How long those take that settle."""
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


def fate(case: Case, X: np.ndarray, seconds: float, near: float = HOME) -> Fate:
    """The fate of loops X (B, nt, n) over `seconds`: settled are those within `near` for the last quarter."""
    gaps = distances(case, X, seconds)
    _, middle, _, end = (part.max(axis=1) for part in np.array_split(gaps, 4, axis=1))
    outside = ~(gaps <= near)
    last = np.where(outside.any(axis=1), gaps.shape[1] - np.argmax(outside[:, ::-1], axis=1), 0)
    settles = np.where(end <= near, last * seconds / (gaps.shape[1] - 1), np.inf)
    return Fate(settles, ~(end <= near) & (end < FALLING * middle), ~(FALLING * end <= middle))


def times(case: Case) -> tuple[float, float, float]:
    """The step, the seconds to look at, and the seconds that are needed: SPAN time constants, or HORIZON."""
    plant, X = case.plant, case.X
    f_X, f_U = plant.jacobians(X, case.u)
    rates = np.abs(np.linalg.eigvals(np.concatenate([f_X, f_X + f_U @ plant.kappa_jacobian(X)]))).max()
    horizon = HORIZON
    if plant.rests:
        eigenvalues = np.linalg.eigvals(plant.linearised()[0])
        rates, horizon = max(rates, np.abs(eigenvalues).max()), SPAN / -eigenvalues.real.max()
    h = STEP / rates if rates > 0 else horizon / MOST
    return h, min(horizon, MOST * h), horizon


def distances(case: Case, X: np.ndarray, seconds: float) -> np.ndarray:
    """Distances of loops X (B, nt, n) from their target, in widths of the box, (B, nt)."""
    target = case.plant.target(np.linspace(0.0, seconds, X.shape[1]))
    with np.errstate(all="ignore"):
        return np.linalg.norm((X - target) / case.width, axis=-1)


def run(case: Case, D_hat: float, X0: np.ndarray, t_end: float, dt: float, **parts: Any) -> Trajectories:
    """Loops of the case from X0 (B, n), predicted by the exact model over a constant D_hat."""
    delays = {"D": case.D, "D_hat": D_hat}
    if case.plant.declares_delay:
        delays = {"D_hat": 0.0} if D_hat == 0 else {}
    parts = {"u0": case.u0, "actuator": "history", "input_bounds": case.limits} | delays | parts
    return simulate(case.plant, RK4(case.plant, nodes(case, D_hat)), X0=X0, t_end=t_end, dt=dt, progress=False, **parts)


def nodes(case: Case, D_hat: float) -> int:
    """The nodes of the prediction, which RK4 bears."""
    return 2 if D_hat == 0 else max(NODES, math.ceil(STEP * D_hat / times(case)[0] / BEARS) + 1)


def step(case: Case, steps: tuple[int, int] = STEPS) -> float:
    """The control step of simulated loops, of which there are so many in D: the first number for a slow plant."""
    h = times(case)[0]
    return min(h, max(case.D / steps[1], min(case.D / steps[0], h / FINE)))


def applies(case: Case) -> bool:
    """True where loops of kappa lead somewhere, and to simulate them takes no more than moments."""
    small = case.experiment is not None or case.plant.n <= LARGEST
    return case.plant.traced and small and case.sound and case.leads == "yes"


def starts(case: Case) -> np.ndarray:
    """Corners of the box and states within, (STARTS, n)."""
    n, rng = case.plant.n, randomness.generator(0, "corners")
    sides = (
        2 * np.indices((2,) * n).reshape(n, -1).T - 1 if 2**n <= CORNERS else np.sign(rng.uniform(-1, 1, (CORNERS, n)))
    )
    corners = case.ends.mean(axis=1) + INSIDE * sides * np.ptp(case.ends, axis=1) / 2
    return np.concatenate([corners, case.X[: STARTS - len(corners)]])


@dataclass(frozen=True)
class Outcome:
    """Loops (B,) from X0 with a constant D_hat: their fates, how long each was looked at, the ends between which each
    state was, (B, n), at any time (`low`, `high`) and in the last quarter (`last_low`, `last_high`), and how far it
    went past its target, `past`.
    """

    case: Case
    D_hat: float
    fate: Fate
    looked: np.ndarray
    low: np.ndarray
    high: np.ndarray
    last_low: np.ndarray
    last_high: np.ndarray
    past: np.ndarray

    @property
    def far(self) -> np.ndarray:
        """True (B,) for loops that left the finite numbers, or soon will."""
        return ~((np.maximum(np.abs(self.last_low), np.abs(self.last_high)) / self.case.width).max(axis=1) < FAR)

    @property
    def lost(self) -> np.ndarray:
        """True (B,) for loops that leave every bound."""
        return self.far | (~self.fate.kept & self.fate.growing)

    @property
    def swings(self) -> np.ndarray:
        """True (B,) for loops that neither settle nor rest elsewhere, and stay bounded."""
        return ~(self.fate.kept | self.lost | self.steady)

    @property
    def steady(self) -> np.ndarray:
        """True (B,) for loops that have come to rest, wherever that is."""
        return ~self.far & ((self.last_high - self.last_low) / self.case.width <= HOME).all(axis=1)

    @property
    def offset(self) -> np.ndarray:
        """How far the first loop ends from the target of t = 0, (n,)."""
        return (self.last_low + self.last_high)[0] / 2 - self.case.plant.target(0.0)

    @property
    def overshoot(self) -> np.ndarray:
        """How far each state goes past its target, (n,), in units of the state."""
        return self.past.max(axis=0)

    def text(self) -> str:
        """What became of the loops, in words."""
        case, fate, time = self.case, self.fate, self.case.plant.time_text
        elsewhere = ~(fate.kept | self.lost | self.swings)
        parts = []
        if fate.settled.any():
            parts.append(fate.text(case))
        if (late := fate.nearing).any():
            parts.append(f"still converge after {time(self.looked[late].max(), '.3g')}")
        if self.swings.any():
            low, high = self.last_low[self.swings].min(axis=0), self.last_high[self.swings].max(axis=0)
            i = int(np.argmax((high - low) / case.width > HOME))  # the first of those that swing
            parts.append(
                f"swing, {case.plant.states[i]} between {low[i]:.3g} and {case.amount(case.plant.states[i], high[i])}"
            )
        if elsewhere.any():
            first = int(np.argmax(elsewhere))
            parts.append(f"rest elsewhere, as at {case.state((self.last_low + self.last_high)[first] / 2)}")
        if self.lost.any():
            parts.append("are lost")
        shares = [each.mean() for each in (fate.settled, fate.nearing, self.swings, elsewhere, self.lost) if each.any()]
        return ", ".join(
            f"{'all' if share == 1 else f'{share:.0%}'} {part}" for share, part in zip(shares, parts, strict=True)
        )

    @property
    def figures(self) -> dict[str, Any]:
        """The same as numbers, by name."""
        states = self.case.plant.states
        return {
            "D_hat": self.D_hat,
            **self.fate.figures,
            "swinging": float(self.swings.mean()),
            "lost": float(self.lost.mean()),
            "overshoot": dict(zip(states, self.overshoot.tolist(), strict=True)),
            "last_low": dict(zip(states, self.last_low.min(axis=0).tolist(), strict=True)),
            "last_high": dict(zip(states, self.last_high.max(axis=0).tolist(), strict=True)),
        }


def outcome(case: Case, D_hat: float) -> Outcome:
    """Loops from the box with a constant D_hat, simulated once for all questions."""
    if D_hat not in case.outcomes:
        near = HOME if case.plant.rests else FOLLOWS
        case.outcomes[D_hat] = simulated(case, D_hat, starts(case), near)
    return case.outcomes[D_hat]


def simulated(case: Case, D_hat: float, X0: np.ndarray, near: float = HOME, **parts: Any) -> Outcome:
    """Loops from X0 (B, n), each for longer and longer until it settles, is lost, or neither comes nearer nor grows."""
    plant, dt, lanes, shape = case.plant, step(case), np.arange(len(X0)), (len(X0), case.plant.n)
    fates = Fate(np.full(len(X0), np.inf), np.zeros(len(X0), bool), np.zeros(len(X0), bool))
    looked, ends = np.zeros(len(X0)), np.zeros((5, *shape))
    linear = case.D + D_hat + FIRST * times(case)[2]
    longest = min(TIMES * linear, dt * WORK / nodes(case, D_hat), dt * MOST)
    t_end = first = min(linear, longest / 2)
    while True:
        loops = run(case, D_hat, X0[lanes], t_end, dt, **parts)
        X, late, now = loops.X, loops.X[:, -(loops.X.shape[1] // 4) :], fate(case, loops.X, loops.t[-1], near)
        for each, values in zip(fates, now, strict=True):
            each[lanes] = values
        with np.errstate(all="ignore"):
            error = X - plant.target(loops.t)
            past = (-np.sign(error[:, :1]) * error).max(axis=1, initial=0.0)
        looked[lanes], ends[:, lanes] = t_end, (X.min(axis=1), X.max(axis=1), late.min(axis=1), late.max(axis=1), past)
        result = Outcome(case, D_hat, fates, looked, *ends)
        unsure = ~now.settled & ~result.far[lanes] & (now.nearing | now.growing | (t_end == first))
        if not unsure.any() or 2 * t_end > longest:
            return result
        lanes, t_end = lanes[unsure], 2 * t_end
