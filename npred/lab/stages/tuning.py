"""The search for gamma, b and gains of kappa whose loops cost least, and the judgement on other starts.

The cost of a loop of [evaluate] is the time until it settles, and a little of the control effort. CMA-ES [Hansen 2016,
arXiv:1604.00772] searches on the training starts; each time that its best improves, the held-out starts judge that, and
choose nothing.
"""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple, Self

import numpy as np

from npred import plants
from npred.base import randomness
from npred.base.errors import ConfigError, unlisted
from npred.base.progress import duration
from npred.formulas import programs
from npred.formulas.trace import Trace
from npred.lab.config import Pipeline, Scenario, Tune
from npred.lab.config.conditions import Condition, adaptation, under
from npred.lab.config.results import BeforeAfter, JudgedLoops, Tuned, TunedNumber
from npred.lab.report.terminal import interruption
from npred.lab.report.terminal.console import Console
from npred.laws.design import Design
from npred.laws.law import rounded
from npred.laws.regulator import adjustable, riccati, weights
from npred.loop import metrics
from npred.loop.trajectories import Trajectories
from npred.plants import Plant
from npred.prediction.methods import numerical

LAW = ("gamma", "b")  # numbers of the delay law, as [evaluate] calls them
LETTERS = ("Q", "R")  # weights of kappa = "lqr"
FIGURES = ("time", "peak", "effort")  # the attributes of Settling that are compared
CASES = Scenario(name="cases")  # [evaluate] as it stands
Progress = Callable[[int], None]
SPREAD = 0.25  # standard deviation that a search starts with, as a share of each range
# A default range is the present number divided and multiplied by this …
FAR = {"gamma": 100.0, "b": 100.0, "Q": 100.0, "R": 100.0}
GAIN_FAR = 5.0  # … or, of a gain, by this
RESAMPLES = 4000
MOVED = 1e-6  # times size(X*): an equilibrium further away is another one
TRIES = 60  # for each number that is free, by default
LONGER = 2.0  # times the longest settling time at present, loops end
LONG = 15.0  # s: a search that takes longer says so beforehand


class Settling(NamedTuple):
    """Loops from S initial states, K of each: `time`, `effort`, `peak` and whether each settles, (S, K); see `of`."""

    time: np.ndarray
    effort: np.ndarray
    peak: np.ndarray
    settled: np.ndarray

    @classmethod
    def of(cls, loops: Trajectories, plant: Plant, states: int, limited: bool = False) -> "Settling":
        """The loops (states * K,) of `plant` against its target X* and input U*.

        time: of the first step from which |X - X*| stays within 1 % of size(X*) (npred.loop.metrics). A loop that does
        not settle in T = t_end has (2 + q) T with q = r / (1 + r), r = sup |X - X*| / size(X*) over the last tenth:
        from 2 T to 3 T, less if it ends nearer. One that overflows at t has 4 T - t, from 3 T to
        4 T. If `limited`, a loop that breaks a limit of the plant does not settle.
        effort: the integral of |U - U*|² over [0, T], by trapezia; infinite where a loop does not settle.
        peak: the largest |X - X*|.
        """
        target, t_end = metrics.target(plant, loops), float(loops.t[-1])
        time, near = metrics.settle_time(loops, target), metrics.radius(loops, target) / metrics.size(target)
        finite = np.isfinite(loops.X).all(axis=-1).mean(axis=-1)
        settled = np.isfinite(time)
        if limited and loops.safety is not None:
            settled = settled & ~(loops.safety < 0).any(axis=(-2, -1))
        with np.errstate(invalid="ignore", over="ignore"):
            late = np.where(np.isfinite(near), (2 + near / (1 + near)) * t_end, (4 - finite) * t_end)
            U = plant.u_target(loops.t) if loops.u_target is None else loops.u_target
            effort = np.trapezoid(np.sum((loops.U - U) ** 2, axis=-1), loops.t)
            peak = np.linalg.norm(loops.X - target, axis=-1).max(axis=-1)
        columns = np.where(settled, time, late), np.where(settled, effort, np.inf), peak, settled
        return cls(*(a.reshape(states, -1) for a in columns))

    @classmethod
    def failed(cls, like: "Settling", t_end: float) -> "Settling":
        """Loops that cannot be simulated cost as much as one that overflows at once."""
        infinite = np.full_like(like.effort, np.inf)
        return cls(np.full_like(like.time, 4 * t_end), infinite, infinite, like.settled & False)


@dataclass(frozen=True)
class Yardstick:
    """The unit of the cost: mean time T_0 and effort E_0 of the present loops from the training starts.

    The cost of a loop is time / T_0 + w E / (E + E_0), w the weight `effort`: about 1 + w / 2 at present; a loop that
    does not settle has all of w.
    """

    time: float
    effort: float
    weight: float

    @classmethod
    def of(cls, present: Settling, weight: float, dt: float) -> "Yardstick":
        """The yardstick of these loops; a time is at least dt, and an effort above 0."""
        efforts = present.effort[present.settled]
        effort = float(efforts.mean()) if efforts.size else 1.0
        return cls(max(float(present.time.mean()), dt), effort or 1.0, weight)

    def costs(self, outcome: Settling) -> np.ndarray:
        """The cost of each loop, (S, K)."""
        return outcome.time / self.time + self.weight * (1 - self.effort / (outcome.effort + self.effort))


@dataclass(frozen=True)
class Loops:
    """The cases of [evaluate] and its scenarios from `states` random initial states of the box, drawn by `purpose`.

    They end at `t_end`, by default at case_t_end.
    """

    pipeline: Pipeline
    plant: Plant
    states: int
    purpose: str
    t_end: float = np.inf

    @cached_property
    def conditions(self) -> list[Condition]:
        """One for the cases, then one per scenario."""
        seed = randomness.integer(self.pipeline.seed, "tune", self.purpose)
        table = self.pipeline.evaluate.model_copy(update={"case_states": self.states})
        drawn = self.pipeline.model_copy(update={"seed": seed, "evaluate": table})
        conditions = [under(self.plant, drawn, scenario) for scenario in (CASES, *table.scenarios)]
        return [replace(each, t_end=min(each.t_end, self.t_end)) for each in conditions]

    @property
    def steps(self) -> int:
        """Control steps of all loops together."""
        return sum(condition.steps for condition in self.conditions)

    def run(self, numbers: Mapping[str, float], progress: Progress) -> Settling:
        """The loops with these gamma, b and parameters, and the pipeline's numerical predictor."""
        plant, parts = varied(self.plant, numbers), []
        for condition in self.conditions:
            law: dict[str, Any] = {name: numbers[name] for name in LAW if name in numbers}
            table = condition.table.model_copy(update=law)
            predictor = numerical(table.predictor, plant, table.nx)
            loops = replace(condition, table=table).loops(plant, predictor, progress=progress)  # a law may ripple
            parts.append(Settling.of(loops, plant, self.states, limited=condition.table.safety is not None))
        return Settling(*(np.concatenate(column, axis=1) for column in zip(*parts, strict=True)))


@dataclass(frozen=True)
class LqrWeights:
    """The diagonals of Q and R of kappa = "lqr", as numbers that vary.

    `present` has those of the plant's law, Q.<state> … and R.<input> …; `law` is the plant whose law takes K as
    parameters, so that other weights solve a Riccati equation, and compile nothing.
    """

    design: Design
    present: Mapping[str, float]
    law: Plant

    @classmethod
    @lru_cache(maxsize=16)
    def of(cls, plant: Plant) -> Self | None:
        """None for a plant with another law. Raises ConfigError for weights that are no diagonals."""
        table = dict(plant.law_table)
        if table.pop("law", None) != "lqr":
            return None
        design = Design(plant, "lqr")
        both = weights(design, **table)
        if any(np.count_nonzero(matrix - np.diag(np.diag(matrix))) for matrix in both):
            raise design.refusal("diagonals Q and R to tune, got a matrix", "write one weight each")
        names = [*(f"Q.{name}" for name in plant.states), *(f"R.{name}" for name in plant.inputs)]
        present = dict(zip(names, np.concatenate([np.diag(matrix) for matrix in both]).tolist(), strict=True))
        return cls(design, present, adjustable(plant, riccati(*design.linearised, *both)[1]))

    def named(self, table: Tune) -> list[str]:
        """The names that are free, with all weights for Q and R, but the one that is held."""
        names = [name for name in self.present if name in table.free or name[0] in table.free]
        others = [name for name in table.free if name not in (*LETTERS, *self.present)]
        return others + [name for name in names if name != self.held(table)]

    def held(self, table: Tune) -> str:
        """Only ratios count: where all weights are free the last is held, or the last without a range; else ""."""
        if any(name not in table.free and name[0] not in table.free for name in self.present):
            return ""
        names = [*self.present]
        ranged = [name for name in names if name in table.bounds or name[0] in table.bounds]
        return next((name for name in reversed(names) if name not in ranged), names[-1])

    def table(self, numbers: Mapping[str, float]) -> dict[str, Any]:
        """The kappa of a pipeline with these weights, and the present ones for the others."""
        numbers = {name: numbers.get(name, value) for name, value in self.present.items()}
        return {"law": "lqr"} | {letter: [x for name, x in numbers.items() if name[0] == letter] for letter in LETTERS}

    def varied(self, numbers: Mapping[str, float]) -> Plant:
        """The plant with their gains. Raises ConfigError where the Riccati equation has no solution."""
        table = self.table(numbers)
        K = riccati(*self.design.linearised, np.diag(table["Q"]), np.diag(table["R"]))[1]
        names = list(self.law.parameters)[-K.size :]
        return plants.varied(self.law, tuple(zip(names, rounded(K).ravel().tolist(), strict=True)))


def varied(plant: Plant, numbers: Mapping[str, float]) -> Plant:
    """The plant with those of the numbers that are its parameters, or weights of its law."""
    if any(name[:2] in ("Q.", "R.") for name in numbers) and (weights := LqrWeights.of(plant)):
        plant = weights.varied(numbers)
    return plants.varied(plant, tuple((k, value) for k, value in numbers.items() if k not in LAW and "." not in k))


def gains(plant: Plant) -> list[str]:
    """The parameters that kappa reads, and neither f, delay, reference, setpoint nor the limits: a user's choice.

    Raises ConfigError for a plant whose formulas cannot be read.
    """
    if not plant.traced:
        raise ConfigError(f"plant {plant.name}: free expected a traced plant, got traced = False; leave free out")
    trace = Trace(plant)
    x, u, t = trace.symbols()
    kappa, fixed = [*trace.kappa(x, t)], [*trace.f(x, u, t), *([trace.delay(x, t)] if plant.declares_delay else [])]
    fixed += [*(trace.reference(t) if plant.tracks else []), *(trace.safe(x, t) if plant.declares_safe else [])]
    fixed += [*trace.setpoint(x, t)] if plant.declares_setpoint else []
    names = []
    for name, symbol in zip(plant.parameters, trace.parameters, strict=False):
        if name not in LAW and programs.depends(kappa, [symbol]) and not programs.depends(fixed, [symbol]):
            names.append(name)
    return names


@dataclass(frozen=True)
class Ranges:
    """The numbers that are free, at present, and their ranges: low, high (k,)."""

    present: Mapping[str, float]
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, pipeline: Pipeline, plant: Plant, table: Tune) -> "Ranges":
        """The ranges of a pipeline. Raises ConfigError for a name that is no gain, and for one that moves the rest."""
        law = adaptation(pipeline.evaluate, plant)
        chosen = [name for name in table.free if name not in LAW or law is None]
        weights = LqrWeights.of(plant)
        chosen = weights.named(table.model_copy(update={"free": chosen})) if weights else chosen
        offered = {name: plant.parameters[name] for name in gains(plant)} if plant.traced or chosen else {}
        offered |= weights.present if weights else {}
        for name in [name for name in chosen if name not in offered]:
            if name.partition(".")[0] in LETTERS and not weights:
                cure = 'set kappa = "lqr" (--set kappa=lqr), or name a parameter that kappa reads'
                raise ConfigError(f'free: expected kappa = "lqr" for its weight {name}, got another law; {cure}')
            if not offered:
                what = "expected a parameter that kappa reads and the plant does not, of which there is none"
                raise ConfigError(f"free: {what}, got {name!r}; declare one and write p.NAME for its number in kappa")
            raise ConfigError(unlisted("free", name, offered, "gains, which kappa reads and the plant does not:"))
        present = ({"gamma": law.gamma, "b": law.b} if law else {}) | {name: offered[name] for name in chosen}
        spans = {name: _span(name, value, table.bounds) for name, value in present.items()}
        free = {name: value for name, value in present.items() if spans[name][0] < spans[name][1]}
        for name in free:
            if moved := _moved(plant, name, spans[name]):
                cure = "set it yourself, or write a law whose rest is the same for each gain"
                raise ConfigError(f"free: expected gains, got {name}, which moves the rest {moved}; {cure}")
        low, high = np.array([spans[name] for name in free], dtype=float).reshape(-1, 2).T
        return cls(free, low, high)

    def acting(self, loops: "Loops", present: Settling, table: Tune, progress: Progress) -> "Ranges":
        """Those whose other end changes a loop: gamma and b go, if they are not named, where the delay law has no use
        for them. Raises ConfigError for a name that changes nothing, and where nothing is left.
        """
        ends = zip(self.present.items(), self.low.tolist(), self.high.tolist(), strict=True)
        keep = []
        for (name, value), low, high in ends:
            try:
                other = loops.run({**self.present, name: low if low != value else high}, progress)
            except ConfigError:  # a law without an equilibrium
                other = Settling.failed(present, 0.0)
            keep.append(any(not np.array_equal(*pair) for pair in zip(present, other, strict=True)))
            if not keep[-1] and name in (*table.free, *table.bounds):
                what = f"free: expected numbers that change the loops, got {name}, which changes nothing in them"
                raise ConfigError(f"{what}; leave it out")
        free = {name: value for (name, value), acts in zip(self.present.items(), keep, strict=True) if acts}
        if not free:
            names = ", ".join(gains(loops.plant)) if loops.plant.traced else ""
            what = "free: expected something to tune, got nothing that changes the loops"
            raise ConfigError(f"{what}; name gains of kappa, here: {names or 'none'}")
        return Ranges(free, self.low[keep], self.high[keep])

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


def _moved(plant: Plant, name: str, span: tuple[float, float]) -> str:
    """`from x = 1 to x = 2` where an end of the parameter's range has another rest; "" for all other numbers."""
    if name not in plant.parameters or not plant.rests:
        return ""
    here = plant.equilibrium
    for value in span:
        try:
            there = plants.varied(plant, ((name, value),)).equilibrium
        except ConfigError:  # no equilibrium, so nothing to rest at
            continue
        if np.linalg.norm(there - here) > MOVED * metrics.size(here):
            k = int(np.argmax(np.abs(there - here)))
            return f"from {plant.states[k]} = {here[k]:.4g} to {there[k]:.4g}"
    return ""


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
    """Search with [tune] of the pipeline. If it is interrupted, the result is the best up to then; `jobs` bounds the
    threads.

    The cost is the mean over the loops of [evaluate]'s cases and of all its scenarios, each from the same initial
    states, of time / T_0 + effort weight * E / (E + E_0): see Yardstick. Loops end at LONGER times the longest settling
    time at present, if all settle. It is a gain where the held-out cost falls by the share `margin`
    or more, and 95 % of its bootstrap over initial states is above 0; and a figure of the loops falls as clearly: the
    settling time, the effort, or the number of loops that do not settle. Deterministic by the pipeline's seed, for any
    number of jobs. Raises ConfigError for what cannot be tuned.
    """
    table, console = pipeline.tune or Tune(), console or Console(quiet=True)
    ranges = Ranges.of(pipeline, plant, table)
    if (weights := LqrWeights.of(plant)) and (held := weights.held(table)):
        console.note(f"tune: {held} stays {weights.present[held]:.4g}: only the ratios of Q and R change the law")
    loops = Loops(pipeline, plant, table.starts, "training")
    judges = Loops(pipeline, plant, table.held_out, "held out")
    tried, interrupted = 0, False
    training = loops.run(ranges.present, _stoppable)  # compiles too, which no estimate of the time is to count
    ranges = ranges.acting(loops, training, table, _stoppable)
    held_out = judges.run(ranges.present, _stoppable)
    if training.settled.all() and held_out.settled.all():
        longest = float(max(training.time.max(), held_out.time.max()))
        t_end = max(10, math.ceil(LONGER * longest / pipeline.evaluate.dt)) * pipeline.evaluate.dt
        loops, judges = (replace(each, t_end=t_end) for each in (loops, judges))
        training, held_out = (each.run(ranges.present, _stoppable) for each in (loops, judges))
    tries = table.evaluations or TRIES * len(ranges.low)
    with console.bar("tune", tries * loops.steps, "steps") as bar, ThreadPoolExecutor(jobs) as pool:
        yardstick = Yardstick.of(training, table.effort, pipeline.evaluate.dt)
        before = best = _Best(dict(ranges.present), float(yardstick.costs(training).mean()), training, held_out)

        def outcome(numbers: Mapping[str, float]) -> Settling:
            try:
                return loops.run(numbers, bar.advance)
            except ConfigError as error:  # a law without an equilibrium
                console.detail(f"tune: {said(numbers)}: {error}")
                return Settling.failed(training, loops.conditions[0].t_end)

        def costs(asked: list[dict[str, float]]) -> list[float]:
            nonlocal best, tried
            begin = console.clock()
            outcomes = list(pool.map(outcome, asked))
            mean_costs = [float(yardstick.costs(each).mean()) for each in outcomes]
            seconds = (console.clock() - begin) / len(asked) * tries
            if not tried and seconds > LONG:
                console.note(f"tune: {tries} tries, about {duration(seconds)}; tune.evaluations says how many")
            tried += len(mean_costs)
            k = int(np.argmin(mean_costs))
            if mean_costs[k] < best.cost:
                judged = judges.run(asked[k], _stoppable)
                best = _Best(asked[k], mean_costs[k], outcomes[k], judged)
                console.detail(f"tune: cost {mean_costs[k]:.4g} after {tried}: {said(asked[k])}")
            return mean_costs

        try:
            _search(ranges, costs, tries, randomness.generator(pipeline.seed, "tune", "search"))
        except KeyboardInterrupt:
            interrupted = True
            console.stop()
    spans = zip(ranges.present, ranges.low.tolist(), ranges.high.tolist(), strict=True)
    numbers = [
        TunedNumber(name=name, before=ranges.present[name], after=best.numbers[name], low=low, high=high)
        for name, low, high in spans
    ]
    judged = _judged(yardstick, before.held_out, best.held_out, pipeline.seed)
    figures = {"settling time": judged.settle_time, "peak": judged.peak, "effort": judged.effort}
    better = judged.settle_time.falls or judged.effort.falls or judged.unsettled[1] < judged.unsettled[0]
    gained = judged.cost.falls and (judged.cost.gain or 0.0) >= table.margin and better
    if gained:
        changes = [f"{name} {figure.change()}" for name, figure in ({"the cost": judged.cost} | figures).items()]
        answer = f"{said(best.numbers)}: on held-out starts {', '.join(changes)}"
    else:
        fallen = f"with the best of {tried} tries the cost {judged.cost.change()} on held-out starts"
        answer = f"no clear gain: {fallen}; a gain needs {table.margin:.1%}, and a shorter settling time or less effort"
    return Tuned(
        pipeline=pipeline.name, plant=plant.name, numbers=numbers, margin=table.margin,
        training=_judged(yardstick, before.training, best.training, pipeline.seed), held_out=judged, gained=gained,
        evaluations=tried, interrupted=interrupted,
        sentence=f"interrupted after {tried} tries; {answer}" if interrupted else answer,
    )  # fmt: skip


def _search(
    ranges: Ranges, costs: Callable[[list[dict[str, float]]], list[float]], evaluations: int, rng: np.random.Generator
) -> None:
    """CMA-ES from the present numbers, then, where it has converged, from random ones with twice the points.

    It needs two coordinates, so one that is alone gets one that changes nothing.
    """
    import cma  # slow to import

    tried, start, size = 0, ranges.start(), 4 + int(3 * np.log(max(len(ranges.low), 2)))
    options: dict[str, Any] = {"bounds": [0.0, 1.0], "seed": np.nan, "verbose": -9}
    options["randn"] = lambda *shape: rng.standard_normal(shape)
    while tried + size <= evaluations:
        z = np.append(start, [0.5] * (2 - len(start)))
        search = cma.CMAEvolutionStrategy(z, SPREAD, options | {"popsize": size})
        while not search.stop() and tried + search.popsize <= evaluations:
            asked = search.ask()
            search.tell(asked, costs([ranges.numbers(z) for z in asked]))
            tried += len(asked)
        start, size = rng.uniform(size=len(start)), 2 * size


def _stoppable(steps: int) -> None:
    interruption.check()


def compared(before: np.ndarray, after: np.ndarray, rng: np.random.Generator) -> BeforeAfter:
    """The means of two arrays (S, K) of loops, and the gain 1 - after / before of the means.

    The interval of 95 % is that of initial states drawn again, in pairs. A loop that is NaN in either is left out.
    """
    both = ~np.isnan(before + after)
    if not both.any():
        return BeforeAfter(before=None, after=None, gain=None, interval=None)
    means = float(before[both].mean()), float(after[both].mean())
    sums = np.stack([np.where(both, each, 0.0).sum(axis=1) for each in (before, after)])
    drawn = sums[:, rng.integers(0, sums.shape[1], (RESAMPLES, sums.shape[1]))].sum(axis=-1)
    drawn = drawn[:, drawn[0] > 0]
    if not drawn.size:
        return BeforeAfter(before=means[0], after=means[1], gain=None, interval=None)
    low, high = np.quantile(1 - drawn[1] / drawn[0], [0.025, 0.975])
    return BeforeAfter(
        before=means[0], after=means[1], gain=1 - means[1] / means[0], interval=(float(low), float(high))
    )


def said(numbers: Mapping[str, float]) -> str:
    """`gamma = 12, b = 0.5`."""
    return ", ".join(f"{name} = {value:.4g}" for name, value in numbers.items())


def _judged(yardstick: Yardstick, before: Settling, after: Settling, seed: int) -> JudgedLoops:
    """The cost over all loops, the figures over those that settle before and after."""
    both = before.settled & after.settled
    pairs = {name: [np.where(both, getattr(each, name), np.nan) for each in (before, after)] for name in FIGURES}
    pairs["cost"] = [yardstick.costs(each) for each in (before, after)]
    bootstrap = partial(randomness.generator, seed, "tune", "bootstrap")
    figures = {name: compared(old, new, bootstrap()) for name, (old, new) in pairs.items()}
    return JudgedLoops(
        loops=before.time.size, cost=figures["cost"], settle_time=figures["time"], peak=figures["peak"],
        effort=figures["effort"], unsettled=(int((~before.settled).sum()), int((~after.settled).sum())),
    )  # fmt: skip
