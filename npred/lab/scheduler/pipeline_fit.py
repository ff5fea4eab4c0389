"""The check of a pipeline: can its stages run with its plant, and are its loops in doubt?"""

import json
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from npred import diagnosis
from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.base.registry import NETWORKS
from npred.diagnosis import Answer, Case, PlannedExperiment
from npred.diagnosis.adaptive_loop import STARTS, AdaptiveLoops
from npred.diagnosis.equilibrium import DECLARE, SLIP
from npred.estimation.adaptation import DelayAdaptation, undeclared
from npred.guard.guarded import Guarded
from npred.lab.config import FROZEN, PAPER, LoopTable, Pipeline, Scenario, conditions
from npred.lab.config.conditions import Condition
from npred.loop import control_step
from npred.loop.simulation import LANES
from npred.loop.trajectories import Trajectories
from npred.plants import Plant, inputs
from npred.plants.speed import long
from npred.prediction import methods as predictors
from npred.prediction.delays import problem_of

STAGES = ("generate", "train", "evaluate", "bench")
ABOUT_DELAY = (  # keys that a plant which declares its delay has no use for
    "adaptation", "gamma", "b", "bounds", "D", "D_hat", "case_D_hat", "map_D", "map_D_hat", "explore", "redraw",
    "explore_D", "explore_D_hat",
)  # fmt: skip
TIMES = 1001  # at which a delay by which networks tell the time is looked at
SIMULATED = ("box", "finite", "equilibrium", "stability", "reference", "adaptation")  # what a doubt needs


@dataclass(frozen=True)
class PipelineFit:
    """A plant and the stages of a pipeline that are to run with it."""

    plant: Plant
    pipeline: Pipeline
    stages: Collection[str] = STAGES

    @property
    def loops(self) -> dict[str, LoopTable]:
        """The tables of the stages that simulate."""
        return {stage: getattr(self.pipeline, stage) for stage in ("generate", "evaluate") if stage in self.stages}

    @property
    def steps(self) -> list[tuple[str, float, Any, bool]]:
        """The key, the control step and the delay of each loop over a constant delay, and whether that is estimated."""
        loops = [] if self.plant.declares_delay else [item for item in self.loops.items() if item[1].simulated]
        return [(f"{stage}.dt", loop.dt, loop.D, loop.adaptation != FROZEN) for stage, loop in loops]  # type: ignore[attr-defined]

    @property
    def scenarios(self) -> list[Scenario]:
        return self.pipeline.evaluate.scenarios if "evaluate" in self.stages else []

    @property
    def conditions(self) -> list[LoopTable]:
        """The tables of all loops, those of scenarios too."""
        return [*self.loops.values(), *map(self.pipeline.evaluate.under, self.scenarios)]

    @property
    def longest_delay(self) -> float:
        """The longest delay or first estimate of one that the loops have."""
        generate, evaluate = self.pipeline.generate, self.pipeline.evaluate
        spans = [(evaluate.D, evaluate.D_hat), evaluate.case_D_hat, evaluate.map_D, evaluate.map_D_hat]
        if list(self.loops) != ["evaluate"]:
            spans += [generate.D if isinstance(generate.D, tuple) else (generate.D,), *generate.D_hat]
            spans += [generate.explore_D] if generate.explore else []
            spans += [generate.explore_D_hat] if generate.explore or generate.redraw else []
        return max(time for span in spans for time in span)

    def case(self, delay: float | None = None, nx: int | None = None, u0: Any = None) -> Case:
        """The case of the plant for the questions of npred.diagnosis, by default with the pipeline's settings."""
        generate, evaluate = self.pipeline.generate, self.pipeline.evaluate
        table = evaluate if "generate" not in self.loops and "evaluate" in self.loops else generate
        boxes = generate.box if table is generate else {}
        laws = [table.adaptation for table in self.conditions]
        adaptive = self._adaptive if evaluate.adaptation == PAPER else None
        D = evaluate.D if delay is None and not self.plant.declares_delay and "evaluate" in self.loops else None
        asked = PlannedExperiment(boxes, table.input_bounds, laws, evaluate.case_t_end, D, adaptive)
        if delay is not None:
            source = "as asked"
        elif self.plant.declares_delay:
            delay, source = diagnosis.longest(self.plant, asked)
        else:
            delay, source = self.longest_delay, "the longest delay or first estimate of the pipeline"
        count, start = table.nx if nx is None else nx, table.u0 if u0 is None else u0
        return Case(self.plant, delay, count, diagnosis.SAMPLES, source, start, asked)

    def _adaptive(self, case: Case) -> AdaptiveLoops:
        """The loops of [evaluate], from its start and others of the box."""
        table = self.pipeline.evaluate
        law = conditions.adaptation(table, self.plant)
        assert isinstance(law, DelayAdaptation)
        X0, D_hat = case.X[:STARTS], np.array(sorted({table.D_hat, *table.case_D_hat}))
        X0 = np.concatenate([[table.X0], X0[1:]]) if len(table.X0) == self.plant.n else X0
        seconds, derived = case.times[1], table.gamma is None
        return AdaptiveLoops(law, table.D, D_hat, X0, table.dt, seconds, table.nx, derived, self._simulated)

    def _simulated(self, loops: AdaptiveLoops, adaptation: str, rk4: predictors.RK4, every: int) -> Trajectories:
        settings = {"gamma": loops.law.gamma, "dt": loops.dt, "adaptation": adaptation}
        table = self.pipeline.evaluate.model_copy(update=settings)
        asked = Condition(table, loops.X0[:, None], loops.D, loops.D_hat, loops.seconds, seed=0)
        return asked.loops(self.plant, rk4, every=every)


def check(
    plant: Plant, pipeline: Pipeline, delay: float | None = None, nx: int | None = None, u0: Any = None,
    said: Callable[[Answer], object] = bool,
) -> list[Answer]:  # fmt: skip
    """Every answer about the plant as the pipeline uses it, and whether each of its stages can run with the plant. Of a
    file with [evaluate] and no other stage, as a rig's, that table alone is asked.

    Delay, nx and u0 take the place of the pipeline's. Raises ConfigError as npred.diagnosis.check does.
    """
    alone = pipeline.model_fields_set.intersection(STAGES) == {"evaluate"}
    fit = PipelineFit(plant, pipeline, ("evaluate",) if alone else STAGES)
    case = replace(fit.case(delay, nx, u0), said=said)
    inputs.start(plant, u0, case.limits)
    answers = diagnosis.answers(case)
    if plant.declares_kappa:
        try:
            _require(fit, case)
            what = f"{pipeline.name} fits its plant" + (", by [evaluate] alone" if alone else "")
            answers.append(Answer("pipeline", "yes", what))
            answers += [_step(plant, *step) for step in fit.steps]
        except ConfigError as refusal:
            answers.append(Answer("pipeline", "no", str(refusal)))
    return answers


def _step(plant: Plant, name: str, dt: float, D: Any, adapts: bool) -> Answer:
    doubt, least = control_step.doubt(name, dt, D, plant, adapts), float(np.min(D))
    steps = f"{plant.time_text(dt)}, {least / dt:.3g} steps in a delay of {plant.time_text(least)}"
    return Answer(name, "warn", doubt) if doubt else Answer(name, "yes", steps)


def require(plant: Plant, pipeline: Pipeline, stages: Collection[str]) -> None:
    """Raise ConfigError, in one line, where those stages ask for parts that the plant does not have.

    A recording asks for none: the law and the parameters of the plant may be wrong before it is identified.
    """
    if set(stages) != {"identify"}:
        fit = PipelineFit(plant, pipeline, stages)
        _require(fit, fit.case())


def doubts(plant: Plant, pipeline: Pipeline) -> list[str]:
    """Doubts before a run, in words: about control steps, and about the adaptive loop, which takes a simulation."""
    fit = PipelineFit(plant, pipeline)
    case, long = fit.case(), [control_step.doubt(name, dt, D, plant, adapts) for name, dt, D, adapts in fit.steps]
    answers = [case.ask(question) for question in diagnosis.QUESTIONS if question.name in SIMULATED]
    warned = [answer.text for answer in answers if answer and answer.verdict == "warn" and answer.check == "adaptation"]
    return [*filter(None, long), *warned]


def _require(fit: PipelineFit, case: Case) -> None:
    """Raise ConfigError at the first question that is answered by no; these take no time."""
    plant, pipeline = fit.plant, fit.pipeline

    def ask(name: str) -> None:
        answer = case.ask(next(question for question in diagnosis.QUESTIONS if question.name == name))
        if answer and answer.verdict == "no":
            raise ConfigError(answer.text)

    declared_delay(fit)
    served(fit)
    room(fit)
    ask("box")
    for stage, loop in fit.loops.items():
        for each in filter(None, (loop, getattr(loop, "bounded", None))):  # a range per input, an input before t = 0
            inputs.configured(plant, each.u0, each.input_bounds, stage)
    for name, dt, D, adapts in fit.steps:
        control_step.check(name, dt, D if adapts else 0.0)
    clock(fit)
    if case.takes_V and not plant.declares_V:
        raise ConfigError(f"{undeclared(plant)}; {DECLARE}")
    ask("finite")
    ask("stability")
    if "evaluate" in fit.stages:
        ask("reference")
    models = pipeline.train.models if "train" in fit.stages else []
    at_rest = [name for name in models if pipeline.train.table(name).anchor == "equilibrium"]
    if at_rest and not plant.rest:
        keys = ", ".join(f"train.{name}.anchor" for name in at_rest)
        what = f"expected a plant with a rest, {plant.name} has none"
        raise ConfigError(f'{keys}: {what}; write anchor = "initial"')
    if "evaluate" in fit.stages:
        if not (plant.rests or plant.tracks):
            what = f"expected a plant with a rest or a reference, {plant.name} has neither"
            todo = "declare reference(t, p, M), what kappa follows"
            raise ConfigError(f"evaluate: {what}; its loops have no radius: {todo}")
        X0 = pipeline.evaluate.X0
        if len(X0) != plant.n:
            what = f"expected one number per state ({', '.join(plant.states)}), got {X0 or 'none'}"
            raise ConfigError(f"evaluate.X0: {what}; give as many")
        if not np.isfinite(X0).all():
            raise ConfigError(f"evaluate.X0: expected finite values, got {X0}; replace that")
    parts(fit)


def served(fit: PipelineFit) -> None:
    """Whether methods, laws and runtimes serve the plant: all that do not in one refusal, and the key to set."""
    refusal, pipeline = problem_of(fit.plant).refusal, fit.pipeline
    asked: dict[str, tuple[str, Any]] = {}  # what a key names, and what to set in its place
    for stage, loop in fit.loops.items():
        if not fit.plant.declares_delay:  # that of the pipeline means nothing there
            asked |= {f"{stage}.adaptation": ("adaptation" if loop.adaptation == PAPER else "", FROZEN)}
        asked |= {f"{stage}.predictor": (loop.predictor, "rk4")}
    if "bench" in fit.stages and (refused := [name for name in pipeline.bench.runtimes if refusal(name)]):
        others = [name for name in pipeline.bench.runtimes if name not in refused]
        asked["bench.runtimes"] = refused[0], others or ["torch"]
    reasons = {key: reason for key, (name, _) in asked.items() if (reason := refusal(name))}
    if reasons:
        changes = ", ".join(f"{key} = {json.dumps(asked[key][1])}" for key in reasons)
        raise ConfigError(f"{', '.join(reasons)}: {next(iter(reasons.values()))[0]}; set {changes}")


def declared_delay(fit: PipelineFit) -> None:
    """Whether a pipeline leaves out all that is about delays, estimates and laws where the plant declares its delay."""
    if not fit.plant.declares_delay:
        return
    keys = []
    for stage, loop in fit.loops.items():
        plain = type(loop)(D=loop.D, adaptation=loop.adaptation)  # type: ignore[call-arg]  nobody wrote what follows D
        fields = type(loop).model_fields
        for name in ABOUT_DELAY:
            expected = (fields["D"].default,) if name == "D" else (getattr(plain, name, None), FROZEN)
            if name in fields and getattr(loop, name) not in expected:
                keys.append(f"{stage}.{name}")
    for k, scenario in enumerate(fit.scenarios):
        keys += [f"evaluate.scenarios[{k}].{key}" for key in scenario.about_delay]
    if keys:
        them = "it" if len(keys) == 1 else "them"
        what = f"expected none, for plant {fit.plant.name} declares delay(x, t, p, M)"
        raise ConfigError(f"{', '.join(keys)}: {what}; leave {them} out")


def room(fit: PipelineFit) -> None:
    """Whether the stages' least need of memory at one time fits into this machine."""
    pipeline, row = fit.pipeline, 8 * (fit.plant.n + fit.plant.m)  # bytes of a node, of P and u
    generate, evaluate, bench = pipeline.generate, pipeline.evaluate, pipeline.bench
    certify = pipeline.optional("certify")
    lanes = {"generate": generate.rollouts, "evaluate": evaluate.case_states * len(evaluate.case_D_hat)}
    asked = [(stage, f"{stage}.nx", row * loop.nx * min(lanes[stage], LANES)) for stage, loop in fit.loops.items()]
    asked += [
        ("generate", "generate.nx", row * generate.nx * generate.samples * min(1, LANES / generate.rollouts)),
        ("generate", "generate.rollouts", 8 * generate.rollouts),
        ("evaluate", "evaluate.case_states", row * lanes["evaluate"]),
        ("bench", "bench.dx, bench.batches", row * max(bench.batches) / bench.dx[0]),
        ("bench", "bench.dx", row / min(bench.dx)),
        ("bench", "bench.calls", 8 * bench.calls),
        ("certify", "certify.restarts, certify.steps", row * evaluate.nx * certify.restarts * certify.steps),
    ]
    tables = {f"train.{name}.width": pipeline.train.table(name).arguments for name in pipeline.train.models}
    asked += [("train", key, 4 * table["width"] ** 2) for key, table in tables.items() if "width" in table]
    for stage, key, needed in asked:
        if stage in fit.stages:
            array_checks.room(key, "arrays", needed, "take fewer")


def clock(fit: PipelineFit) -> None:
    """A network sees the time as a phase, so f and kappa have to repeat: tried near the origin, at n times.

    Or it tells the time by the delay D(t), which then has to rise or to fall for as long as loops run.
    """
    plant = fit.plant
    if plant.clocked and not plant.phased:
        seconds = max([getattr(loop, "case_t_end", loop.t_end) for loop in fit.loops.values()], default=long(plant))
        steps = np.diff(plant.delay(np.zeros((TIMES, plant.n)), np.linspace(0.0, seconds, TIMES)))
        if not ((steps > 0).all() or (steps < 0).all()):
            span = plant.time_text(seconds)
            what = f"expected a delay that only rises or only falls for {span}, for networks tell the time by it"
            raise ConfigError(f"{plant.location('delay')}: {what}; declare period, after which it repeats")
    if plant.phase(0.0) is None or plant.period is None:
        return
    X, t = np.eye(plant.n), np.linspace(0.0, plant.period, plant.n)
    u, u_next = plant.kappa(X, t), plant.kappa(X, t + plant.period)
    gaps = u_next - u, (plant.f(X, u, t + plant.period) - plant.f(X, u, t)) * plant.period
    if max(np.abs(gap).max() for gap in gaps) > SLIP:
        what = f"f and kappa expected to repeat after {plant.time_text(plant.period)}"
        raise ConfigError(f"plant {plant.name}: {what}; set period to the time after which they do")


def parts(fit: PipelineFit) -> None:
    """Whether delay laws, methods and sensors load, and fit the plant; whether networks take their sizes."""
    for name in fit.pipeline.train.models if "train" in fit.stages else ():
        table = fit.pipeline.train.table(name)
        NETWORKS.check_keywords(f"train.{name}.sizes", table.architecture, table.arguments)
    for table in fit.conditions:
        D, exact = table.longest, predictors.numerical(table.predictor, fit.plant, table.nx)
        Condition(table, np.zeros((1, fit.plant.n)), D, D, table.t_end, seed=0).loop(fit.plant, exact)
    if "evaluate" in fit.stages and (guard := fit.pipeline.evaluate.guard):
        Guarded(predictors.RK4(fit.plant, fit.pipeline.evaluate.nx), **dict(guard))
