"""The search for gamma, b and gains of kappa whose loops cost least, and the judgement on other starts.

The cost of a loop of [evaluate] is the time until it settles, and a little of the control effort. CMA-ES [Hansen 2016,
arXiv:1604.00772] searches on the training starts; each time that its best improves, the held-out starts judge that, and
choose nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, Self

import numpy as np

from npred import plants
from npred.base import randomness
from npred.base.errors import ConfigError, unlisted
from npred.formulas import programs
from npred.formulas.trace import Trace
from npred.lab.config import Pipeline, Scenario, Tune
from npred.lab.config.conditions import Condition, adaptation, under
from npred.lab.config.results import JudgedLoops, Tuned, TunedNumber
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
CASES = Scenario(name="cases")  # [evaluate] as it stands
Progress = Callable[[int], None]
SPREAD = 0.25  # standard deviation that a search starts with, as a share of each range
# A default range is the present number divided and multiplied by this …
FAR = {"gamma": 100.0, "b": 100.0, "Q": 100.0, "R": 100.0}
GAIN_FAR = 5.0  # … or, of a gain, by this
RESAMPLES = 4000


class Settling(NamedTuple):
    """Loops from S initial states, K of each: `time`, `effort` and whether each settles, (S, K); see `of`."""

    time: np.ndarray
    effort: np.ndarray
    settled: np.ndarray

    @classmethod
    def of(cls, loops: Trajectories, plant: Plant, states: int, limited: bool = False) -> "Settling":
        """The loops (states * K,) against the target X* and input U* of `plant`, whatever was tuned in them.

        time: of the first step from which |X - X*| stays within 1 % of size(X*) (npred.loop.metrics). A loop that does
        not settle in T = t_end has (2 + q) T with q = r / (1 + r), r = sup |X - X*| / size(X*) over the last tenth:
        from 2 T to 3 T, less where it ends nearer. One that leaves the finite numbers at t has 4 T - t, from 3 T to
        4 T. If `limited`, a loop that breaks a limit of the plant does not settle.
        effort: the mean of |U - U*|² over [0, T], by trapezia; infinite where a loop does not settle.
        """
        target, t_end = metrics.target(plant, loops), float(loops.t[-1])
        time, near = metrics.settle_time(loops, target), metrics.radius(loops, target) / metrics.size(target)
        finite = np.isfinite(loops.X).all(axis=-1).mean(axis=-1)
        settled = np.isfinite(time)
        if limited and loops.safety is not None:
            settled = settled & ~(loops.safety < 0).any(axis=(-2, -1))
        with np.errstate(invalid="ignore", over="ignore"):
            lost = np.where(np.isfinite(near), (2 + near / (1 + near)) * t_end, (4 - finite) * t_end)
            U = plant.u_target(loops.t) if loops.u_target is None else loops.u_target
            effort = np.trapezoid(np.sum((loops.U - U) ** 2, axis=-1), loops.t) / t_end
        columns = np.where(settled, time, lost), np.where(settled, effort, np.inf), settled
        return cls(*(a.reshape(states, -1) for a in columns))

    @classmethod
    def failed(cls, like: "Settling", t_end: float) -> "Settling":
        """Loops that cannot be simulated: as lost as one that leaves the finite numbers at once."""
        return cls(np.full_like(like.time, 4 * t_end), np.full_like(like.effort, np.inf), like.settled & False)


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
        """That of these loops; a time is at least dt, and an effort above 0."""
        efforts = present.effort[present.settled]
        effort = float(efforts.mean()) if efforts.size else 1.0
        return cls(max(float(present.time.mean()), dt), effort or 1.0, weight)

    def costs(self, outcome: Settling) -> np.ndarray:
        """The cost of each loop, (S, K)."""
        return outcome.time / self.time + self.weight * (1 - self.effort / (outcome.effort + self.effort))


@dataclass(frozen=True)
class Loops:
    """The cases of [evaluate] and its scenarios from `states` random initial states of the box, drawn by `purpose`."""

    pipeline: Pipeline
    plant: Plant
    states: int
    purpose: str

    @cached_property
    def conditions(self) -> list[Condition]:
        """One for the cases, then one per scenario."""
        seed = randomness.integer(self.pipeline.seed, "tune", self.purpose)
        table = self.pipeline.evaluate.model_copy(update={"case_states": self.states})
        drawn = self.pipeline.model_copy(update={"seed": seed, "evaluate": table})
        return [under(self.plant, drawn, scenario) for scenario in (CASES, *table.scenarios)]

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
            changed = Condition(table, condition.X0, condition.D, condition.D_hat, condition.t_end, condition.seed)
            loops = changed.loops(plant, predictor, progress=progress)  # every step: a law may ripple between
            parts.append(Settling.of(loops, self.plant, self.states, limited=condition.table.safety is not None))
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

    def named(self, free: Sequence[str]) -> list[str]:
        """The names, with all weights for Q and R. Only ratios count: where all weights are free, the last is held."""
        names = [name for name in self.present if name in free or name[0] in free]
        names = names[:-1] if len(names) == len(self.present) else names
        return [*(name for name in free if name not in (*LETTERS, *self.present)), *names]

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
        """Those of a pipeline. Raises ConfigError for a name that is no gain, and where nothing is free."""
        law = adaptation(pipeline.evaluate, plant)
        chosen = [name for name in table.free if name not in LAW or law is None]
        weights = LqrWeights.of(plant)
        chosen = weights.named(chosen) if weights else chosen
        offered = {name: plant.parameters[name] for name in gains(plant)} if plant.traced or chosen else {}
        offered |= weights.present if weights else {}
        for name in chosen:
            if name not in offered:
                raise ConfigError(unlisted("free", name, offered, "gains, which kappa reads and the plant does not:"))
        present = ({"gamma": law.gamma, "b": law.b} if law else {}) | {name: offered[name] for name in chosen}
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
    """Search with [tune] of the pipeline. If it is interrupted, the result is the best up to then; `jobs` bounds the
    threads.

    The cost is the mean over the loops of [evaluate]'s cases and of all its scenarios, each from the same initial
    states, of time / T_0 + effort weight * E / (E + E_0): see Yardstick. There is something to gain
    where the held-out cost falls by the share `margin` or more, and 95 % of its bootstrap over initial states is above
    0. Deterministic by the pipeline's seed, for any number of jobs. Raises ConfigError for what cannot be tuned.
    """
    table, console = pipeline.tune or Tune(), console or Console(quiet=True)
    ranges = Ranges.of(pipeline, plant, table)
    loops = Loops(pipeline, plant, table.starts, "training")
    judges = Loops(pipeline, plant, table.held_out, "held out")
    total = (table.evaluations + 1) * loops.steps + judges.steps
    tried, interrupted = 0, False
    with console.bar("tune", total, "steps") as bar, ThreadPoolExecutor(jobs) as pool:
        training, held_out = (each.run(ranges.present, bar.advance) for each in (loops, judges))
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
            outcomes = list(pool.map(outcome, asked))
            mean_costs = [float(yardstick.costs(each).mean()) for each in outcomes]
            tried += len(mean_costs)
            k = int(np.argmin(mean_costs))
            if mean_costs[k] < best.cost:
                judged = judges.run(asked[k], lambda steps: interruption.check())
                best = _Best(asked[k], mean_costs[k], outcomes[k], judged)
                console.detail(f"tune: cost {mean_costs[k]:.4g} after {tried}: {said(asked[k])}")
            return mean_costs

        try:
            _search(ranges, costs, table.evaluations, randomness.generator(pipeline.seed, "tune", "search"))
        except KeyboardInterrupt:
            interrupted = True
            console.stop()
    spans = zip(ranges.present, ranges.low.tolist(), ranges.high.tolist(), strict=True)
    numbers = [
        TunedNumber(name=name, before=ranges.present[name], after=best.numbers[name], low=low, high=high)
        for name, low, high in spans
    ]
    rng = randomness.generator(pipeline.seed, "tune", "bootstrap")
    gain, interval = gained(yardstick.costs(before.held_out), yardstick.costs(best.held_out), rng)
    enough = gain >= table.margin and interval[0] > 0
    spread = f"{gain:.1%} on held-out starts, with 95 % between {interval[0]:.1%} and {interval[1]:.1%}"
    answer = f"{said(best.numbers)}: the cost falls by {spread}"
    if not enough:
        spread = f"the best of {tried} tries lowers the cost by {spread}; {table.margin:.1%} would count"
        answer = f"nothing to gain: {spread}"
    return Tuned(
        pipeline=pipeline.name, plant=plant.name, numbers=numbers, gain=gain, interval=interval, margin=table.margin,
        training=_judged(yardstick, before.training, best.training),
        held_out=_judged(yardstick, before.held_out, best.held_out),
        gained=enough, evaluations=tried, interrupted=interrupted,
        sentence=f"interrupted after {tried} tries; {answer}" if interrupted else answer,
    )  # fmt: skip


def _search(
    ranges: Ranges, costs: Callable[[list[dict[str, float]]], list[float]], evaluations: int, rng: np.random.Generator
) -> None:
    """CMA-ES from the present numbers, then, where it has converged, from random ones with twice the points.

    It needs two coordinates, so one that is alone gets one that changes nothing.
    """
    import cma  # it takes a while

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


def gained(before: np.ndarray, after: np.ndarray, rng: np.random.Generator) -> tuple[float, tuple[float, float]]:
    """1 - mean after / mean before of costs (S, K), and its interval of 95 %: initial states drawn again, in pairs."""
    pairs = np.stack([before.mean(axis=1), after.mean(axis=1)])
    drawn = pairs[:, rng.integers(0, pairs.shape[1], (RESAMPLES, pairs.shape[1]))].mean(axis=-1)
    low, high = np.quantile(1 - drawn[1] / drawn[0], [0.025, 0.975])
    return float(1 - pairs[1].mean() / pairs[0].mean()), (float(low), float(high))


def said(numbers: Mapping[str, float]) -> str:
    """`gamma = 12, b = 0.5`."""
    return ", ".join(f"{name} = {value:.4g}" for name, value in numbers.items())


def _judged(yardstick: Yardstick, before: Settling, after: Settling) -> JudgedLoops:
    times = [each.time[each.settled] for each in (before, after)]
    mean, mean_after = (float(settled.mean()) if settled.size else None for settled in times)
    return JudgedLoops(
        loops=before.time.size,
        cost=(float(yardstick.costs(before).mean()), float(yardstick.costs(after).mean())),
        settle_time=(mean, mean_after),
        unsettled=(int((~before.settled).sum()), int((~after.settled).sum())),
    )
