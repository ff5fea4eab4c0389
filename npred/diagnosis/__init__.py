"""The check of a plant and its pipeline, one answer per question, before an hour of rollouts and training."""

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from npred.config import Pipeline
from npred.diagnosis import adaptive_loop, box, delay_margin, equilibrium, lyapunov, pipeline_fit, region
from npred.diagnosis.case import ANY, Answer, Case, Check, Verdict
from npred.errors import ConfigError
from npred.plants import inputs
from npred.plants.base import Plant

__all__ = ["Answer", "Case", "check", "doubts", "longest", "require", "settled"]

SIMULATED = ("box", "finite", "equilibrium", "stability", "reference", "adaptation")  # each after those that it needs
NODES, ASSUMED, SAMPLES = 101, 1.0, 256  # 1 s where nothing says how long the delay is


def _of_pipelines(answer: Callable[[Case], Verdict | None], before: str = ANY) -> Check:
    return Check(answer.__name__, answer, lambda case: case.pipeline is not None, before, shown=False)


# In the order of their answers. Before a run those are asked that take no time; the first no refuses it.
QUESTIONS = (
    Check("trace", box.traced),
    Check("smooth law", box.smooth, lambda case: case.plant.traced),
    _of_pipelines(pipeline_fit.declared_delay),
    _of_pipelines(pipeline_fit.served),
    _of_pipelines(pipeline_fit.room),
    Check("box", box.declared, before=ANY),
    _of_pipelines(pipeline_fit.start),
    _of_pipelines(pipeline_fit.resolved),
    _of_pipelines(pipeline_fit.clock),
    _of_pipelines(pipeline_fit.declares_V),
    Check("finite", box.finite, lambda case: case.verdict("box") != "no", ANY),
    Check("delay", lambda case: ("yes", f"{case.plant.time_text(case.delay)}, {case.source}")),
    Check("feasibility", box.feasible, lambda case: case.sound and case.plant.declares_delay),
    Check("equilibrium", equilibrium.equilibrium, lambda case: case.plant.rests),
    Check("stability", equilibrium.stability, equilibrium.exists, ANY),
    Check("reference", equilibrium.reference, lambda case: not case.plant.rests, "evaluate"),
    Check("V", lyapunov.falls, lyapunov.applies),
    Check("input bounds", equilibrium.limited, lambda case: case.sound),
    Check("convergence", equilibrium.converges, lambda case: case.sound and case.leads == "yes"),
    Check("delay margin", delay_margin.bears, delay_margin.applies),
    Check("adaptation", adaptive_loop.converges, adaptive_loop.applies),
    Check("jacobians", box.jacobians, lambda case: case.sound and case.plant.traced),
    Check("stiffness", box.stiff, lambda case: case.sound and case.verdict("jacobians") != "no"),
    Check("completeness", box.complete, lambda case: case.sound and case.verdict("stiffness") in ("yes", None)),
    _of_pipelines(pipeline_fit.anchors, "train"),
    _of_pipelines(pipeline_fit.radius, "evaluate"),
    _of_pipelines(pipeline_fit.parts),
)


def check(
    plant: Plant, delay: float | None = None, nodes: int | None = None, samples: int = SAMPLES,
    pipeline: Pipeline | None = None, u0: Any = None,
) -> list[Answer]:  # fmt: skip
    """Every question about a plant with its answer, for delays up to `delay` seconds on `nodes` nodes.

    By default the delay is the longest that the pipeline names, else the longest of the plant's, else 1 s; a pipeline
    gives nodes, box, input bounds and, without `u0`, that too, and one more answer: whether each of its stages can run
    with the plant.
    A question that needs what another one found missing is not asked.
    Raises ConfigError for a delay that is not positive, for fewer than two nodes, and for a u0 that does not fit.
    """
    D, source = longest(plant, pipeline) if delay is None else (delay, "as asked")
    count = nodes if nodes is not None else pipeline.generate.nx if pipeline else NODES
    if not 0 < D < np.inf:
        raise ConfigError(f"delay: expected a time above 0, got {plant.time_text(D)}; give another")
    if count < 2:
        raise ConfigError(f"nodes: expected at least 2, both ends of [0, 1], got {count}; 101 are usual")
    case = Case(plant, D, count, samples, pipeline, source=source, commands=u0)
    inputs.start(plant, u0, case.limits)
    if not plant.declares_kappa:
        missing = f"plant {plant.name}: expected kappa(x, t, p, M), found none; declare it"
        advice = 'or take one of these: kappa = "lqr" in a pipeline; --kappa lqr prints it to be pasted'
        return [Answer("kappa", "no", f"{missing}, {advice}"), *region.offers(plant, case)]
    for question in QUESTIONS:
        if question.shown and case.verdict("trace") != "no":
            case.ask(question)
    answers = list(case.answers.values())
    if plant.law and case.sound and case.leads == "yes":
        answers.append(region.converging("kappa", case))
        if plant.law_table and answers[-1].verdict != "yes":
            answers.append(region.instead(plant, case))
    if pipeline is None:
        return answers
    refusal = _refusal(case)
    fit = Answer("pipeline", "no", refusal) if refusal else Answer("pipeline", "yes", f"{pipeline.name} fits its plant")
    return [*answers, fit]


def settled(answers: Sequence[Answer]) -> bool:
    """True if no answer is no."""
    return all(answer.verdict != "no" for answer in answers)


def require(plant: Plant, pipeline: Pipeline, stages: Collection[str]) -> None:
    """Raise ConfigError, in one line, where those stages ask for what the plant does not have."""
    case = Case(plant, longest(plant, pipeline)[0], pipeline.generate.nx, SAMPLES, pipeline, stages)
    if refusal := _refusal(case):
        raise ConfigError(refusal)


def doubts(plant: Plant, pipeline: Pipeline) -> list[str]:
    """The questions that take a simulation, asked before a run: what the adaptive loop makes doubtful, in words."""
    case = Case(plant, longest(plant, pipeline)[0], pipeline.generate.nx, SAMPLES, pipeline)
    answers = [case.ask(question) for question in QUESTIONS if question.name in SIMULATED]
    return [answer.text for answer in answers if answer and answer.verdict == "warn" and answer.check == "adaptation"]


def _refusal(case: Case) -> str | None:
    """The first no to what is asked before the case's stages run."""
    asked = (case.ask(question) for question in QUESTIONS if question.before in (ANY, *case.stages))
    return next((answer.text for answer in asked if answer and answer.verdict == "no"), None)


def longest(plant: Plant, pipeline: Pipeline | None) -> tuple[float, str]:
    """The delay to predict over, and where it is from."""
    if plant.declares_delay:
        return _declared(Case(plant, ASSUMED, NODES, SAMPLES, pipeline))
    if pipeline:
        return pipeline.longest_delay, "the longest delay or first estimate of the pipeline"
    if plant.delays:
        return max(plant.delays), "the longest of the plant's delays"
    return ASSUMED, "assumed: --delay gives another, or a pipeline instead of the plant"


def _declared(case: Case) -> tuple[float, str]:
    """The longest delay that the plant declares on the box; where it cannot say, other answers say why."""
    if all(name in case.box for name in case.plant.states):
        with suppress(ConfigError):
            D = float(np.nanmax(case.delays[1]))
            if 0 < D < np.inf:
                return D, "the longest that the plant declares on the box"
    return ASSUMED, "assumed: the plant declares none on the box"
