"""The search for gamma, b and gains of kappa whose loops cost least, and the judgement on other starts.

CMA-ES [Hansen 2016, arXiv:1604.00772] on the training starts; each time that its best improves, the held-out starts
judge that, and choose nothing.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from npred.base import randomness
from npred.base.errors import ConfigError, unlisted
from npred.lab.config import Pipeline, Tune, conditions
from npred.lab.config.results import JudgedLoops, Tuned, TunedNumber
from npred.lab.report.terminal import interruption
from npred.lab.report.terminal.console import Console
from npred.lab.stages.tuning.cost import ALPHA, LAW, Loops, LqrWeights, Progress, Settling, Yardstick, gains
from npred.plants import Plant

SPREAD = 0.25  # standard deviation that a search starts with, as a share of each range
# A default range is the present number divided and multiplied by this …
FAR = {"gamma": 100.0, "b": 100.0, "Q": 100.0, "R": 100.0}
GAIN_FAR = 5.0  # … or, of a gain, by this
RESAMPLES = 4000


@dataclass(frozen=True)
class Ranges:
    """The numbers that are free, at present, and their ranges: low, high (k,)."""

    present: Mapping[str, float]
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, pipeline: Pipeline, plant: Plant, table: Tune) -> "Ranges":
        """Those of a pipeline. Raises ConfigError for a name that is no gain, and where nothing is free."""
        law = conditions.adaptation(pipeline.evaluate, plant)
        chosen = [name for name in table.free if name != ALPHA and (name not in LAW or law is None)]
        weights = LqrWeights.of(plant)
        chosen = weights.named(chosen) if weights else chosen
        offered = {name: plant.parameters[name] for name in gains(plant)} if plant.traced or chosen else {}
        offered |= weights.present if weights else {}
        for name in chosen:
            if name not in offered:
                raise ConfigError(unlisted("free", name, offered, "gains, which kappa reads and the plant does not:"))
        present = ({"gamma": law.gamma, "b": law.b} if law else {}) | {name: offered[name] for name in chosen}
        if ALPHA in table.free:
            if pipeline.evaluate.safety is None:
                expected = "expected a safety filter in [evaluate], found none; add safety = { alpha = 1.0 }"
                raise ConfigError(f"free: {ALPHA} {expected}")
            present |= {ALPHA: pipeline.evaluate.safety.alpha}
        spans = {name: _span(name, value, table.bounds) for name, value in present.items()}
        free = {name: value for name, value in present.items() if spans[name][0] < spans[name][1]}
        if not free:
            names = ", ".join(offered) if plant.traced else "none"
            raise ConfigError(f"free: expected something to tune, got nothing; name gains of kappa, here: {names}")
        low, high = np.array([spans[name] for name in free], dtype=float).T
        return cls(free, low, high)

    def numbers(self, z: np.ndarray) -> dict[str, float]:
        """The numbers at z (k,) in [0, 1], on a logarithmic scale where low > 0."""
        z = np.clip(z[: len(self.low)], 0.0, 1.0)
        ends = zip(self.low.tolist(), self.high.tolist(), z.tolist(), strict=True)
        values = [low * (high / low) ** s if low > 0 else low + s * (high - low) for low, high, s in ends]
        return dict(zip(self.present, values, strict=True))

    def start(self) -> np.ndarray:
        """z (k,) of the present numbers, or of the nearest in range."""
        ends = zip(self.low, self.high, np.clip([*self.present.values()], self.low, self.high), strict=True)
        z = [np.log(x / low) / np.log(high / low) if low > 0 else (x - low) / (high - low) for low, high, x in ends]
        return np.array(z)


def _span(name: str, value: float, bounds: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    """The range of a number: its bounds, or those of all Q or R, which are times the present weight, or by default."""
    letter, dot, _ = name.partition(".")
    if name in bounds:
        return bounds[name]
    if dot and letter in bounds:
        return bounds[letter][0] * value, bounds[letter][1] * value
    far = FAR.get(letter, GAIN_FAR)
    if value == 0:
        raise ConfigError(f"free: expected a range for {name}, which is 0 now, got none; write {name}=LOW:HIGH")
    low, high = sorted((value / far, value * far))
    return low, high


@dataclass(frozen=True)
class _Best:
    """The numbers of least cost, and their loops from the training and the held-out starts."""

    numbers: dict[str, float]
    cost: float
    training: Settling
    held_out: Settling


def tune(pipeline: Pipeline, plant: Plant, jobs: int = 1, console: Console | None = None) -> Tuned:
    """Search with [tune] of the pipeline. What interrupts it gives the best up to then; `jobs` bounds the threads.

    The cost is the mean over the loops of [evaluate]'s cases and of all its scenarios, each from the same initial
    states, of time / T_0 + effort weight * E / (E + E_0): see npred.lab.stages.tuning.cost. There is something to gain
    where the held-out cost falls by the share `margin` or more, and 95 % of its bootstrap over initial states is above
    0. Deterministic by the pipeline's seed, for any number of jobs. Raises ConfigError for what cannot be tuned.
    """
    table, console = pipeline.tune or Tune(), console or Console(quiet=True)
    ranges = Ranges.of(pipeline, plant, table)
    loops = Loops(pipeline, plant, table.starts, "training")
    judges = Loops(pipeline, plant, table.held_out, "held out")
    total = (table.evaluations + 1) * loops.steps + judges.steps
    with console.bar("tune", total, "steps") as bar, ThreadPoolExecutor(jobs) as pool:
        training, held_out = (each.run(ranges.present, bar.advance) for each in (loops, judges))
        yardstick = Yardstick.of(training, table.effort, pipeline.evaluate.dt)
        before = _Best(dict(ranges.present), float(yardstick.costs(training).mean()), training, held_out)
        search = _Search(ranges, loops, judges, yardstick, before, pool, console)
        interrupted = False
        try:
            search.run(table.evaluations, randomness.generator(pipeline.seed, "tune", "search"), bar.advance)
        except KeyboardInterrupt:
            interrupted = True
            console.stop()
    return _result(pipeline, plant, table, search, before, interrupted)


class _Search:
    """The best up to now, and how many were tried."""

    def __init__(
        self, ranges: Ranges, loops: Loops, judges: Loops, yardstick: Yardstick, present: _Best,
        pool: ThreadPoolExecutor, console: Console,
    ) -> None:  # fmt: skip
        self.ranges, self.loops, self.judges, self.yardstick = ranges, loops, judges, yardstick
        self.best, self.present, self.pool, self.console, self.tried = present, present, pool, console, 0

    def run(self, evaluations: int, rng: np.random.Generator, progress: Progress) -> None:
        """CMA-ES from the present numbers, then, where it has converged, from random ones with twice the points."""
        start, size = self.ranges.start(), 4 + int(3 * np.log(max(len(self.ranges.low), 2)))
        while self.tried + size <= evaluations:
            search = _started(start, size, rng)
            while not search.stop() and self.tried + search.popsize <= evaluations:
                asked = search.ask()
                numbers = [self.ranges.numbers(z) for z in asked]
                outcomes = list(self.pool.map(lambda each: self._loops(each, progress), numbers))
                costs = [float(self.yardstick.costs(outcome).mean()) for outcome in outcomes]
                search.tell(asked, costs)
                self.tried += len(costs)
                k = int(np.argmin(costs))
                if costs[k] < self.best.cost:
                    judged = self.judges.run(numbers[k], lambda steps: interruption.check())
                    self.best = _Best(numbers[k], costs[k], outcomes[k], judged)
                    self.console.detail(f"tune: cost {costs[k]:.4g} after {self.tried}: {said(numbers[k])}")
            start, size = rng.uniform(size=len(start)), 2 * size

    def _loops(self, numbers: Mapping[str, float], progress: Progress) -> Settling:
        try:
            return self.loops.run(numbers, progress)
        except ConfigError as error:  # of a law without an equilibrium
            self.console.detail(f"tune: {said(numbers)}: {error}")
            return Settling.failed(self.present.training, self.loops.conditions[0].t_end)


def _started(start: np.ndarray, size: int, rng: np.random.Generator) -> Any:
    """A search from z (k,) within [0, 1]; it needs two coordinates, so one that is alone gets one that says nothing."""
    import cma  # it takes a while

    z = np.append(start, [0.5] * (2 - len(start)))
    options = {"popsize": size, "bounds": [0.0, 1.0], "seed": np.nan, "verbose": -9}
    options["randn"] = lambda *shape: rng.standard_normal(shape)
    return cma.CMAEvolutionStrategy(z, SPREAD, options)


def gained(before: np.ndarray, after: np.ndarray, rng: np.random.Generator) -> tuple[float, tuple[float, float]]:
    """1 - mean after / mean before of costs (S, K), and its interval of 95 %: initial states drawn again, in pairs."""
    pairs = np.stack([before.mean(axis=1), after.mean(axis=1)])
    drawn = pairs[:, rng.integers(0, pairs.shape[1], (RESAMPLES, pairs.shape[1]))].mean(axis=-1)
    low, high = np.quantile(1 - drawn[1] / drawn[0], [0.025, 0.975])
    return float(1 - pairs[1].mean() / pairs[0].mean()), (float(low), float(high))


def said(numbers: Mapping[str, float]) -> str:
    """`gamma = 12, b = 0.5`."""
    return ", ".join(f"{name} = {value:.4g}" for name, value in numbers.items())


def _result(pipeline: Pipeline, plant: Plant, table: Tune, search: _Search, before: _Best, interrupted: bool) -> Tuned:
    best, ranges = search.best, search.ranges
    costs = search.yardstick.costs
    rng = randomness.generator(pipeline.seed, "tune", "bootstrap")
    gain, interval = gained(costs(before.held_out), costs(best.held_out), rng)
    enough = gain >= table.margin and interval[0] > 0
    spread = f"{gain:.1%} on held-out starts, with 95 % between {interval[0]:.1%} and {interval[1]:.1%}"
    answer = f"{said(best.numbers)}: the cost falls by {spread}"
    if not enough:
        answer = f"nothing to gain: the best of {search.tried} tries lowers the cost by {spread}"
        answer += f"; {table.margin:.1%} would count"
    ends = zip(ranges.low.tolist(), ranges.high.tolist(), strict=True)
    numbers = [
        TunedNumber(name=name, before=ranges.present[name], after=best.numbers[name], low=low, high=high)
        for name, (low, high) in zip(ranges.present, ends, strict=True)
    ]
    return Tuned(
        pipeline=pipeline.name, plant=plant.name, numbers=numbers,
        training=_judged(search.yardstick, [before.training, best.training]),
        held_out=_judged(search.yardstick, [before.held_out, best.held_out]),
        gain=gain, interval=interval, margin=table.margin, gained=enough,
        evaluations=search.tried, interrupted=interrupted,
        sentence=f"interrupted after {search.tried} tries; {answer}" if interrupted else answer,
    )  # fmt: skip


def _judged(yardstick: Yardstick, outcomes: Sequence[Settling]) -> JudgedLoops:
    before, after = outcomes
    times = [each.time[each.settled] for each in outcomes]
    mean, mean_after = (float(settled.mean()) if settled.size else None for settled in times)
    return JudgedLoops(
        loops=before.time.size,
        cost=(float(yardstick.costs(before).mean()), float(yardstick.costs(after).mean())),
        settle_time=(mean, mean_after),
        unsettled=(int((~before.settled).sum()), int((~after.settled).sum())),
    )
