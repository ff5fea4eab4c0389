"""What an adversary finds that a guard lets pass, and how large the errors of U are there.

    python benchmarks/guard_adversary.py [MODEL] [--nx 51] [--states box|data|domain]
    python benchmarks/guard_adversary.py --answers 20000

MODEL is pipeline/paper.toml:deeponet by default, and has to be trained. One row of a Markdown table is printed; the
search ends after `--seconds` or `--calls`. `--output` names a .npz for the calls that DOP853 looked at. Inputs are u
and D_hat in the ranges of the data, and X in the plant's box, as `npred certify` searches, or in the range of the data;
with `--states domain` all three as far as the guard's domain reaches, and u ten times as wide from node to node, for
the domain knows three moments of u alone. `readings agree` counts those passes for which the readings of u differ by a
quarter of the tolerance at most, and `above` the wrong ones among them. `--answers` prints instead the errors of U that
the numerical predictor makes in the calls that do not pass, of rows of the data with X from the plant's box or its
range in half of them.

Neither the guard, nor npred's integrators, nor its plants say here what the true U is. Hill climbing from rows of the
data, and CMA-ES from the best that it came to, maximise the error of U among the calls that pass. That error is the
smallest over four readings of u between its nodes: linear, cubic, constant around each node, and by the means of half
cells, as npred reads it. How u is read is no part of it. f and kappa of the plants are written here once more. RK4 on 2
steps a cell leads the search, and on 16 steps a cell it counts the calls above the tolerance. SciPy's DOP853 integrates
the worst of these, and some at random, once more: at rtol 1e-12, cell by cell. An error that is not finite does not
count.
"""

import argparse
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import cma
import harness
import numpy as np
from scipy.integrate import solve_ivp

from npred.base import grid
from npred.guard.guarded import Guarded
from npred.lab.training.data.dataset import Dataset
from npred.prediction.delays import problem, problem_of
from npred.prediction.methods import RK4

READINGS = ("linear", "cubic", "constant", "means")
COARSE, FINE = 2, 16  # steps of RK4 a cell: to search by, and to count by; even, so that a reading's jumps are between
AGREE = 0.25  # of the tolerance: how far U may differ by readings of u that agree
PENALTY = 1.5  # of a call that does not pass, by the logarithm of how far it is from passing
CHAINS, MOVES = 500, 40  # of a round of hill climbing
POPULATIONS, SIZE, GENERATIONS, KEPT = 24, 20, 120, 6  # of a round of CMA-ES; those that the next round begins with
SHAPES = {"waves": 0.25, "stairs": 0.2, "lines": 0.2, "nodes": 0.1, "rough": 0.25}  # by which a population moves u
NUMBERS = (1, 2, 3, 5, 8, 16)  # of shapes of u that a population has
WHOLE = 60  # coordinates up to which CMA-ES adapts a whole covariance
FLAT = 0.3  # of the populations that begin at a constant u
ROUGH = 0.4  # of the starts and of the moves of u that turn from node to node
TURNS = (1, 1, 1, 2, 3, 4, 5, 7, 10)  # nodes after which a rough u turns
CELLS = (1, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40)  # on which straight lines may be what a prediction reads of u
WIDE = 10.0  # spans of u in the data, as far as the domain's moments let u go from node to node
PENDING = 2000  # calls above the tolerance by COARSE steps that are counted at once by FINE ones
WORST, SAMPLE = 10, 10  # calls above the tolerance that are integrated by DOP853: the worst, and random ones
STATES = ("box", "data", "domain")
STATES = ("box", "data", "domain")  # where X comes from
HEAD = ["network, nodes", "where X", "calls", "passed", "above", "above 2", "readings agree", "above", "worst"]
HEAD += ["DOP853 agrees"]


class System(NamedTuple):
    """A plant in plain NumPy: f(x, u) and kappa(x, t) of sequences of components, and the delays of its inputs as
    shares of the longest. Where the history of an input has ended, kappa acts.
    """

    f: Callable[[Any, Any], list[Any]]
    kappa: Callable[[Any, Any], list[Any]]
    ratios: tuple[float, ...] = (1.0,)


def hill(x: Any) -> Any:
    """f1 of the activator/repressor."""
    return (300.0 * x[0] ** 2 + 0.04) / (1.0 + x[0] ** 2 + x[1] ** 2)


def haldane(S: Any) -> Any:
    """The growth rate of the chemostat: 1 at the set point."""
    return 3.5 * S / (1.0 + S + S**2)


def pomet(x: Any, t: Any) -> list[Any]:
    """The law of the unicycle."""
    p, q = x[0] * np.cos(x[2]) + x[1] * np.sin(x[2]), x[0] * np.sin(x[2]) - x[1] * np.cos(x[2])
    s, c = np.sin(3 * t), np.cos(3 * t)
    turn = -5 * p**2 * c - p * q * (1 + 25 * c**2) - x[2]
    return [turn, -p + 5 * q * (s - c) + q * turn]


SYSTEMS = {
    "activator_repressor": System(
        lambda x, u: [u[0] - x[0] + hill(x), (300.0 * x[0] ** 2 + 0.004) / (1.0 + x[0] ** 2) - 0.5 * x[1]],
        lambda x, t: [hill((0.0939, 5.2525)) - hill(x)],
    ),
    "chemostat": System(
        lambda x, u: [(haldane(x[1]) - 0.1 - u[0]) * x[0], u[0] * (16 / 3 - x[1]) - haldane(x[1]) * x[0]],
        lambda x, t: [0.3 * haldane(x[1]) * x[0] + np.where(x[1] < 2, np.abs(haldane(x[1]) - 1), 0.0) ** 1.5],
    ),
    "unicycle": System(lambda x, u: [u[1] * np.cos(x[2]), u[1] * np.sin(x[2]), u[0]], pomet, (0.25 / 0.6, 1.0)),
}


class Calls(NamedTuple):
    """X (B, n), u (B, nx, m), D_hat (B,), t (B,)."""

    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray
    t: np.ndarray


class Judged(NamedTuple):
    """Of each call whether it passed, the guard's estimate, the error of U, the score of the search, and whether the
    readings agree, (B,) each.
    """

    passed: np.ndarray
    estimate: np.ndarray
    error: np.ndarray
    score: np.ndarray
    agree: np.ndarray


def weights(reading: str, nx: int, places: np.ndarray, middle: float) -> np.ndarray:
    """The weights of `values` of nx nodes in u at places (k,), counted in nodes and of one cell, (k, 3 nx - 2).

    `middle` is that of a step over these places: it says which cell, and on which side of a jump u is meant.
    """
    cell, result = min(int(middle), nx - 2), np.zeros((len(places), 3 * nx - 2))
    if reading == "means":
        result[:, nx + cell], result[:, 2 * nx - 1 + cell] = 1 - (places - cell), places - cell
        return result
    first, width = {
        "linear": (cell, 2), "cubic": (min(max(cell - 1, 0), max(nx - 4, 0)), min(nx, 4)), "constant": (cell, 2),
    }[reading]  # fmt: skip
    at = np.full(len(places), cell + float(middle - cell > 0.5)) if reading == "constant" else places
    s = at - first
    for k in range(width):  # Lagrange's polynomials of the nodes first, first + 1, …
        result[:, first + k] = np.prod([(s - j) / (k - j) for j in range(width) if j != k], axis=0)
    return result


def values(u: np.ndarray) -> np.ndarray:
    """u (nx, ...) at the nodes, and the begins and ends of its lines by the means of half cells, (3 nx - 2, ...).

    Of a node's mean m, m - q is of the lower half of its cell, m + q of the upper one: docs/predictors.md.
    """
    q = np.zeros_like(u)
    for j in range(1, len(u) - 1):
        a, b = u[j] - u[j - 1], u[j + 1] - u[j]
        beside = [np.abs(u[k] - u[k - 1]) if 0 < k < len(u) else 0 * a for k in (j - 1, j + 2)]
        large = np.abs(a + b)
        least = np.maximum(large / 8, large / 2 - np.maximum(*beside))
        q[j] = np.where(a * b > 0, np.sign(a) * np.minimum(least, np.minimum(np.abs(a), np.abs(b))), 0.0)
    low, high = u[:-1] + q[:-1], u[1:] - q[1:]
    middle = (low + high) / 2
    most_steep = np.minimum(np.abs(middle - u[:-1]), np.abs(u[1:] - middle))
    steep = np.clip(high - low, -most_steep, most_steep)
    return np.concatenate([u, middle - steep, middle + steep])


@cache
def pieces(ratios: tuple[float, ...], nx: int, steps: int) -> np.ndarray:
    """Where pieces of x begin and end: `steps` for each cell of each input, and the ends of histories."""
    ends = [r * np.arange((nx - 1) * steps + 1) / ((nx - 1) * steps) for r in (1.0, *ratios)]
    edges = np.sort(np.concatenate(ends))
    return edges[np.append(True, np.diff(edges) > 1e-12)]


@cache
def stages(ratios: tuple[float, ...], nx: int, steps: int) -> list[tuple[float, float, list[np.ndarray | None]]]:
    """Each piece's begin and end, and for each input the weights of `values` at its begin, middle and end by each
    reading, (3 readings, 3 nx - 2); None where its history has ended.
    """
    result, edges = [], pieces(ratios, nx, steps)
    for begin, end in zip(edges, edges[1:], strict=False):
        middle, of_inputs = (begin + end) / 2, []
        for r in ratios:
            places = np.array([begin, middle, end]) / r * (nx - 1)
            W = [weights(reading, nx, places, places[1]) for reading in READINGS] if middle < r else None
            of_inputs.append(None if W is None else np.stack(W, axis=1).reshape(-1, 3 * nx - 2))
        result.append((begin, end, of_inputs))
    return result


def by_rk4(system: System, calls: Calls, steps: int) -> np.ndarray:
    """U by each reading of u, (readings, m, B): Kutta's method on `steps` steps a cell, an even number."""
    X, u, D_hat, t = calls
    nx, at = u.shape[1], {}
    x = np.repeat(X.T[:, None], len(READINGS), axis=1)
    by_input = values(u.swapaxes(0, 1)).transpose(2, 0, 1)

    def f(x: np.ndarray, inputs: list[np.ndarray | None], now: np.ndarray) -> np.ndarray:
        law = system.kappa(x, now) if any(v is None for v in inputs) else inputs
        return np.array(system.f(x, [law[c] if v is None else v for c, v in enumerate(inputs)]))

    for begin, end, of_inputs in stages(system.ratios, nx, steps):
        at[round(begin, 9)], h = x, D_hat * (end - begin)
        read = [
            None if W is None else (W @ v).reshape(3, len(READINGS), -1)
            for W, v in zip(of_inputs, by_input, strict=True)
        ]
        u0, um, u1 = ([None if v is None else v[k] for v in read] for k in range(3))
        t0, t1 = t + begin * D_hat, t + end * D_hat
        k1 = f(x, u0, t0)
        k2 = f(x + h / 2 * k1, um, (t0 + t1) / 2)
        k3 = f(x + h / 2 * k2, um, (t0 + t1) / 2)
        k4 = f(x + h * k3, u1, t1)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    at[1.0] = x
    laws = [system.kappa(at[round(r, 9)], t + r * D_hat)[c] for c, r in enumerate(system.ratios)]
    return np.array(laws).swapaxes(0, 1)


def by_dop853(system: System, X: np.ndarray, u: np.ndarray, D_hat: float, t: float) -> np.ndarray:
    """U of one call by each reading of u, (readings, m): piece by piece, for u is smooth on each only."""
    nx, shares, read = len(u), np.linspace(0.0, 1.0, 4), values(u)
    powers = np.linalg.inv(np.vander(shares))

    def end(reading: str) -> np.ndarray:
        x, at, edges = X, {}, pieces(system.ratios, nx, 2)
        for begin, until in zip(edges, edges[1:], strict=False):
            at[round(begin, 9)], h, cubics = x, D_hat * (until - begin), []
            for c, r in enumerate(system.ratios):
                places = (begin + (until - begin) * shares) / r * (nx - 1)
                W = weights(reading, nx, places, places.mean()) if (begin + until) / 2 < r else None
                cubics.append(None if W is None else (powers @ W @ read[:, c]).tolist())

            def f(s: float, x: np.ndarray, begin=begin, h=h, cubics=cubics) -> list[float]:
                v = [k and ((k[0] * s + k[1]) * s + k[2]) * s + k[3] for k in cubics]
                law = system.kappa(x, t + begin * D_hat + s * h) if None in cubics else v
                slopes = system.f(x.tolist(), [law[c] if k is None else k for c, k in enumerate(v)])
                return [h * slope for slope in slopes]

            x = solve_ivp(f, (0.0, 1.0), x, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        at[1.0] = x
        return np.array([system.kappa(at[round(r, 9)], t + r * D_hat)[c] for c, r in enumerate(system.ratios)])

    return np.stack([end(reading) for reading in READINGS])


def gap(U: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """The error of U (m, ...), its largest component, by that of the exact ones (readings, m, ...) that is nearest."""
    return np.abs(U - exact).max(axis=1).min(axis=0)


def agree(exact: np.ndarray, tolerance: float) -> np.ndarray:
    """Whether all readings' U (readings, m, ...) are within AGREE of the tolerance."""
    return (exact.max(axis=0) - exact.min(axis=0)).max(axis=0) <= AGREE * tolerance


@np.errstate(all="ignore")
def judge(guard: Guarded, system: System, calls: Calls) -> Judged:
    """What the guard makes of calls, and the error of U by COARSE steps; 0 where that is not finite."""
    P = guard.model(*calls)
    estimate, fallback = guard.judge(P, *calls)
    exact = by_rk4(system, calls, COARSE)
    error = np.nan_to_num(gap(command(guard, P, calls), exact), nan=0.0, posinf=0.0)
    ratios = estimate / guard.threshold, guard.beyond(*calls)
    doubt = sum(np.log(np.maximum(ratio, 1.0)) for ratio in ratios)
    score = np.nan_to_num(np.log(error) - PENALTY * doubt, nan=-1e9, neginf=-1e9)
    return Judged(~fallback, estimate, error, score, agree(exact, guard.tolerance))


def command(guard: Guarded, P: np.ndarray, calls: Calls) -> np.ndarray:
    """U of predictions, (m, B), as a loop makes it: by a step between nodes where an input's history ends there."""
    U = np.empty((len(P), guard.plant.m))
    times = calls.t if guard.plant.clocked else np.zeros(len(P))
    control = problem_of(guard.plant).control(RK4.step)
    problem.by_time(control, (P, calls.u, calls.D_hat), times, (guard.plant.p,), (U,))
    return U.T


class Ranges:
    """The inputs that may be searched as coordinates z in [0, 1]^k: X, or asinh(X / bend) in the guard's domain, then u
    at the nodes, D_hat and, where the plant reads a clock, the time.
    """

    def __init__(self, guard: Guarded, data: Dataset, states: str) -> None:
        self.n, self.nx, self.m = guard.plant.n, guard.nx, guard.plant.m
        X, u, D_hat = (edges(a) for a in (data.X, data.u.reshape(-1, self.m), data.D_hat[:, None]))
        if states == "box":
            X = harness.box(guard.plant)
        elif states == "domain":
            X, u, D_hat = reach(guard, u)
        clock = np.array([[0.0], [guard.plant.period or np.nanmax(data.t)]])[:, : int(guard.plant.clocked)]
        self.clocked, domain = guard.plant.clocked, guard.domain
        self.bend = domain.bend if domain is not None and states == "domain" else None
        spans = zip(X, np.tile(u, self.nx), D_hat, clock, strict=True)
        self.low, self.high = (np.concatenate(parts) for parts in spans)

    @property
    def end(self) -> int:
        """Where the coordinates of u end."""
        return self.n + self.nx * self.m

    def calls(self, z: np.ndarray) -> Calls:
        """The inputs of coordinates (B, k)."""
        v = self.low + (self.high - self.low) * z
        t = v[:, -1] if self.clocked else np.zeros(len(v))
        X = v[:, : self.n] if self.bend is None else self.bend * np.sinh(v[:, : self.n])
        return Calls(X, v[:, self.n : self.end].reshape(-1, self.nx, self.m), v[:, self.end], t)

    def of_rows(self, data: Dataset, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray) -> np.ndarray:
        """The nearest coordinates of calls (B, k) whose X, u, D_hat and time are those of these rows of the data."""
        inputs = grid.means(data.u[u], self.nx).reshape(len(u), -1)
        clock = (data.t[t, None] % self.high[-1])[:, : int(self.clocked)]
        states = data.X[X] if self.bend is None else np.arcsinh(data.X[X] / self.bend)
        v = np.concatenate([states, inputs, data.D_hat[D_hat, None], clock], axis=1)
        return np.clip((v - self.low) / np.where(self.high > self.low, self.high - self.low, 1.0), 0.0, 1.0)

    def starts(self, rng: np.random.Generator, data: Dataset, count: int) -> np.ndarray:
        """Rows of the data, at the nearest coordinates; half of them with X anywhere in its range."""
        z = self.of_rows(data, *[rng.integers(0, len(data), count)] * 4)
        z[::2, : self.n] = rng.uniform(size=z[::2, : self.n].shape)
        size = (rng.uniform(size=(count, 1)) < ROUGH) * 10 ** rng.uniform(-2.5, 0.0, (count, 1))
        waves = rough(rng, count, self.nx)[..., None] * rng.uniform(-1, 1, (count, 1, self.m))
        z[:, self.n : self.end] += size * waves.reshape(count, -1)
        return np.clip(z, 0.0, 1.0)


def edges(a: np.ndarray) -> np.ndarray:
    """The smallest and the largest of each column, (2, k)."""
    return np.stack([a.min(axis=0), a.max(axis=0)])


def reach(guard: Guarded, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The box around the guard's domain: asinh(X / bend) (2, n), u (2, m) and D_hat (2, 1)."""
    domain, (n, m) = guard.domain, (guard.plant.n, guard.plant.m)
    assert domain is not None
    spread = domain.limit * np.sqrt(np.diag(np.linalg.inv(domain.whiten.T @ domain.whiten)))
    low = np.maximum(domain.mean - spread, domain.middle - domain.half)
    high = np.minimum(domain.mean + spread, domain.middle + domain.half)
    features = np.stack([low, high])
    means = features[:, n + 1 : n + 1 + 3 * m : 3]  # the first Legendre moment of each input, its mean over x
    u = np.stack([np.minimum(u[0], means[0]), np.maximum(u[1], means[1])])
    u = u + np.array([[-0.5], [0.5]]) * (WIDE - 1) * (u[1] - u[0])
    return features[:, :n], u, np.maximum(features[:, n : n + 1], 0.0)


def rough(rng: np.random.Generator, count: int, nx: int) -> np.ndarray:
    """Waves over the nodes, (count, nx): signs that turn after a few nodes or at random, or sines.

    Half of them are without the straight lines nearest on some cells: a prediction on few steps may read these alone.
    """
    x, turns, first = np.arange(nx), rng.choice(TURNS, (count, 1)), rng.integers(0, max(TURNS), (count, 1))
    waves = np.where(rng.uniform(size=(count, 1)) < 0.3, rng.choice([-1.0, 1.0], (count, nx)), 1.0)
    waves = np.where(rng.uniform(size=(count, 1)) < 0.7, waves * (-1.0) ** ((x + first) // turns), 0.0)
    sines = np.sin(2 * np.pi * (x * rng.uniform(0.05, 0.5, (count, 1)) + rng.uniform(size=(count, 1))))
    waves = np.where(waves == 0, sines, waves)
    taken, lines = slice(0, (count + 1) // 2), read_by_lines(int(rng.choice([k for k in CELLS if 2 * k < nx - 1])), nx)
    waves[taken] -= waves[taken] @ np.linalg.pinv(lines) @ lines
    return waves[rng.permutation(count)]


@cache
def read_by_lines(cells: int, nx: int) -> np.ndarray:
    """Sums over the nodes, each of which stands for what is around it, (2 cells + 1, nx): the integrals of u and of s u
    over each of so many cells, and that of s² u over all.
    """
    begins, ends = (np.clip(np.arange(nx) + side, 0, nx - 1) for side in (-0.5, 0.5))
    edges = np.linspace(0, nx - 1, cells + 1)[:, None]
    low, high = np.maximum(begins, edges[:-1]), np.minimum(ends, edges[1:])
    mass = np.maximum(high - low, 0.0)
    return np.concatenate([mass, mass * (low + high), (ends - begins)[None] * np.arange(nx) ** 2])


def shapes(kind: str, count: int, nx: int) -> np.ndarray:
    """Shapes of u over the nodes that a population moves by, (k, nx)."""
    x = np.linspace(0.0, 1.0, nx)
    if kind == "waves":
        return np.array([np.cos(np.pi * k * x) / np.sqrt(1 + k) for k in range(count)])
    if kind == "stairs":
        return (np.minimum((x * count).astype(int), count - 1) == np.arange(count)[:, None]).astype(float)
    if kind == "lines":
        return np.array([np.interp(x, np.linspace(0, 1, count + 1), row) for row in np.eye(count + 1)])
    return np.eye(nx)


class Population:
    """CMA-ES around a call z0, in X, D_hat, the time, and shapes of each input."""

    def __init__(self, z0: np.ndarray, ranges: Ranges, rng: np.random.Generator) -> None:
        self.ranges, self.z0, self.best, self.score = ranges, z0.copy(), z0, -np.inf
        if rng.uniform() < FLAT:
            self.z0[ranges.n : ranges.end] = np.tile(z0[ranges.n : ranges.n + ranges.m], ranges.nx)
        kind = str(rng.choice(list(SHAPES), p=list(SHAPES.values())))
        count = int(rng.choice(NUMBERS))
        self.shapes = rough(rng, count, ranges.nx) if kind == "rough" else shapes(kind, count, ranges.nx)
        size = len(z0) - ranges.nx * ranges.m + len(self.shapes) * ranges.m
        options = {"popsize": SIZE, "verbose": -9, "seed": np.nan, "CMA_diagonal": size > WHOLE, "maxstd": 1.0}
        options["randn"] = lambda *shape: rng.standard_normal(shape)
        self.search = cma.CMAEvolutionStrategy(np.zeros(size), float(10 ** rng.uniform(-2, -0.5)), options)

    def ask(self) -> np.ndarray:
        """The next coordinates (SIZE, k), reflected at their ends."""
        self.points = np.array(self.search.ask())
        n, m, inner = self.ranges.n, self.ranges.m, len(self.shapes) * self.ranges.m
        u = np.einsum("bkm,kj->bjm", self.points[:, n : n + inner].reshape(SIZE, -1, m), self.shapes)
        moved = np.column_stack([self.points[:, :n], u.reshape(SIZE, -1), self.points[:, n + inner :]])
        z = np.abs(self.z0 + moved) % 2.0
        self.z = np.minimum(z, 2.0 - z)
        return self.z

    def tell(self, scores: np.ndarray) -> None:
        """Adapt to the scores (SIZE,) of what was asked."""
        self.search.tell(list(self.points), (-scores).tolist())
        if scores.max() > self.score:
            self.score, self.best = scores.max(), self.z[scores.argmax()]


class Search:
    """Calls by calls, what passed, what of that is above the tolerance, and which of these are kept."""

    def __init__(self, guard: Guarded, system: System, data: Dataset, states: str, seed: int) -> None:
        self.guard, self.system, self.data, self.ranges = guard, system, data, Ranges(guard, data, states)
        self.rng = np.random.default_rng(seed)
        self.made = self.passed = self.above = self.twice = self.agreed = self.agreed_above = 0
        k = len(self.ranges.low)
        self.worst, self.sample = (np.zeros((0, k + 3)) for _ in range(2))  # rows z, estimate, error, a random number
        self.pending = np.zeros((0, k + 1))  # rows z, estimate
        self.largest = 0.0  # error that passed, whether or not above the tolerance

    @np.errstate(all="ignore")
    def score(self, z: np.ndarray) -> np.ndarray:
        """Judge and count the calls of coordinates (B, k); their scores, (B,)."""
        calls = self.ranges.calls(z)
        passed, estimate, error, score, alike = judge(self.guard, self.system, calls)
        above = passed & (error > self.guard.tolerance)
        self.made, self.passed = self.made + len(z), self.passed + int(passed.sum())
        self.agreed += int((passed & alike).sum())
        self.largest = max(self.largest, error[passed & ~above].max(initial=0.0))
        self.pending = np.concatenate([self.pending, np.column_stack([z[above], estimate[above]])])
        if len(self.pending) > PENDING:
            self.count()
        return score

    @np.errstate(all="ignore")
    def count(self) -> None:
        """Count those of the pending calls that are above the tolerance by FINE steps too."""
        if not len(self.pending):
            return
        z, estimate = self.pending[:, :-1], self.pending[:, -1]
        calls = self.ranges.calls(z)
        exact = by_rk4(self.system, calls, FINE)
        error = gap(command(self.guard, self.guard.model(*calls), calls), exact)
        error = np.nan_to_num(error, nan=0.0, posinf=0.0)
        above, twice = (error > k * self.guard.tolerance for k in (1, 2))
        self.above, self.twice = self.above + int(above.sum()), self.twice + int(twice.sum())
        self.agreed_above += int((above & agree(exact, self.guard.tolerance)).sum())
        self.largest = max(self.largest, error.max(initial=0.0))
        kept = np.column_stack([z, estimate, error, self.rng.uniform(size=len(z))])[above]
        self.worst, self.sample = most(self.worst, kept, -2, WORST), most(self.sample, kept, -1, SAMPLE)
        self.pending = self.pending[:0]

    def run(self, seconds: float, calls: float) -> None:
        """Rounds of both searches, until there were so many seconds or calls."""
        end, best = time.monotonic() + seconds, np.zeros((0, len(self.ranges.low)))

        def over() -> bool:
            return time.monotonic() > end or self.made >= calls

        while not over():
            z = self.ranges.starts(self.rng, self.data, CHAINS)
            z[: len(best)] = best
            best = self.evolve(self.climb(z, over)[:KEPT], z[self.rng.permutation(len(z))], over)
        self.count()

    @np.errstate(all="ignore")
    def answers(self, count: int) -> np.ndarray:
        """The errors of U of the numerical predictor in those of so many calls that it answers."""
        errors = []
        for _ in range(-(-count // PENDING)):
            calls = self.ranges.calls(self.ranges.starts(self.rng, self.data, PENDING))
            calls = Calls(*(part[self.guard.fallback(*calls)] for part in calls))
            exact = by_rk4(self.system, calls, FINE)
            errors.append(gap(command(self.guard, self.guard.exact(*calls), calls), exact))
        return np.nan_to_num(np.concatenate(errors), nan=0.0, posinf=0.0)

    def climb(self, z: np.ndarray, over: Callable[[], bool]) -> np.ndarray:
        """Random moves of each chain that are kept where the score is larger; the chains, the best first."""
        score = self.score(z)
        for _ in range(MOVES):
            if over():
                break
            moved = np.clip(self.moved(z), 0.0, 1.0)
            scores = self.score(moved)
            better = scores > score
            z, score = np.where(better[:, None], moved, z), np.maximum(scores, score)
        return z[np.argsort(-score)]

    def moved(self, z: np.ndarray) -> np.ndarray:
        """Each chain with X, u and D_hat moved, together or one of them; u by a bump, by a jump, or along x."""
        rng, (n, nx, m), count = self.rng, (self.ranges.n, self.ranges.nx, self.ranges.m), len(z)
        size = 10 ** rng.uniform(-3.5, -0.3, (count, 1))
        parts, x = rng.uniform(size=(3, count, 1)) < 0.5, np.linspace(0.0, 1.0, nx)
        center, width = rng.uniform(size=(count, 1)), (1 / nx) ** rng.uniform(size=(count, 1))
        shape = np.where(rng.uniform(size=(count, 1)) < 0.5, np.exp(-(((x - center) / width) ** 2)), x > center)
        waves, part = rough(rng, count, nx), rng.uniform(size=(count, 1))
        shape = np.where(part < ROUGH / 2, waves, np.where(part < ROUGH, shape * waves, shape))
        u = z[:, n : self.ranges.end].reshape(count, nx, m)
        places = np.clip(np.arange(nx) + rng.integers(-2, 3, (count, 1)), 0, nx - 1)
        u = np.where(rng.uniform(size=(count, 1, 1)) < 0.1, np.take_along_axis(u, places[..., None], 1), u)
        u = u + (parts[0] * size * shape)[..., None] * rng.standard_normal((count, 1, m))
        X = z[:, :n] + parts[1] * size * rng.standard_normal((count, n))
        rest = z[:, self.ranges.end :]
        rest = rest + parts[2] * size * rng.standard_normal(rest.shape)
        return np.column_stack([X, u.reshape(count, -1), rest])

    def evolve(self, best: np.ndarray, others: np.ndarray, over: Callable[[], bool]) -> np.ndarray:
        """Populations around the best chains and some others, side by side; where the best of them came to."""
        around = [*best, *others[: POPULATIONS - len(best)]]
        populations = [Population(z, self.ranges, self.rng) for z in around]
        for _ in range(GENERATIONS):
            if over():
                break
            scores = self.score(np.concatenate([population.ask() for population in populations]))
            for population, values in zip(populations, scores.reshape(len(populations), -1), strict=True):
                population.tell(values)
        populations.sort(key=lambda population: -population.score)
        return np.array([population.best for population in populations[:KEPT]])

    def confirmed(self) -> tuple[np.ndarray, np.ndarray]:
        """The errors of the worst calls and of a random share of all above, by FINE steps and by DOP853, (B,) each."""
        rows = np.concatenate([self.worst, self.sample])
        calls = self.ranges.calls(rows[:, :-3])
        P = self.guard.model(*calls) if len(rows) else np.zeros((0, self.ranges.nx, self.ranges.n))
        errors = [
            float(gap(U, by_dop853(self.system, X, u, float(D_hat), float(t))))
            for U, X, u, D_hat, t in zip(command(self.guard, P, calls).T, *calls, strict=True)
        ]
        return rows[:, -2], np.array(errors)


def most(rows: np.ndarray, others: np.ndarray, column: int, count: int) -> np.ndarray:
    """The rows of both with the largest numbers in a column, the largest first."""
    both = np.concatenate([rows, others])
    return both[np.argsort(-both[:, column])[:count]]


def row(search: Search, options: argparse.Namespace) -> list[str]:
    """What the table says of a search."""
    guard = search.guard
    judge(guard, search.system, search.ranges.calls(search.ranges.starts(search.rng, search.data, 2)))  # compiles
    search.run(options.seconds, options.calls)
    errors, exact = search.confirmed()
    if options.output and len(exact):
        z = np.concatenate([search.worst, search.sample])
        np.savez(options.output, **search.ranges.calls(z[:, :-3])._asdict(), estimate=z[:, -3], error=exact)
    worst = f"{search.largest:.3g}"
    if len(exact):
        at = search.ranges.calls(search.worst[:1, :-3])
        X = ", ".join(f"{value:.3g}" for value in at.X[0])
        worst += f" (X = ({X}), D̂ = {at.D_hat[0]:.3g}: estimate {search.worst[0, -3]:.2g})"
    agrees = f"{(exact > guard.tolerance).sum()} of {len(exact)}"
    agrees += f", to {np.max(np.abs(errors / exact - 1)):.0e}" if len(exact) else ""
    numbers = (search.made, search.passed, search.above, search.twice, search.agreed, search.agreed_above)
    counts = [f"{k:,}".replace(",", " ") for k in numbers]
    return [f"`{Path(options.model).name}`, {options.nx}", options.states, *counts, worst, agrees]


def main() -> None:
    options = harness.options(
        __doc__, {"model": harness.PAPER}, nx=51, states=STATES, tolerance=0.01, seconds=60.0,
        calls=np.inf, answers=0, seed=0, store=Path, output=Path,
    )  # fmt: skip
    guard, data = Guarded(harness.network(options), options.tolerance), harness.samples(options.model, options.store)
    search = Search(guard, SYSTEMS[guard.plant.name], data, options.states, options.seed)
    if options.answers:
        errors = search.answers(options.answers)
        above = f"{(errors > options.tolerance).mean():.2%} of them wrong by more than {options.tolerance:g}"
        print(f"{len(errors)} calls answered, {above}, the largest by {errors.max():.2g}")
        return
    harness.head(*HEAD)
    harness.row(*row(search, options))


if __name__ == "__main__":
    main()
