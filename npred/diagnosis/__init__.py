"""The check of a plant, one answer per question, before an hour of rollouts and training."""

import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from npred import plants
from npred.base import progress
from npred.base.errors import ConfigError
from npred.base.registry import LAWS
from npred.diagnosis import adaptive_loop, box, delay_margin, disturbance, equilibrium, from_the_box, loops, pi
from npred.diagnosis.case import Answer, Case, Check, PlannedExperiment
from npred.loop import control_step
from npred.plants import inputs
from npred.plants.base import Plant
from npred.plants.speed import rates

__all__ = ["QUESTIONS", "Answer", "Case", "PlannedExperiment", "answers", "check", "longest", "settled"]

NODES, SAMPLES = 101, 256

EIGHTHS, HALF = 8, 4  # sub-boxes that are looked at, and the one that a law should converge from

# In the order of their answers, each after those that it needs.
QUESTIONS = (
    Check("trace", box.traced),
    Check("smooth law", box.smooth, lambda case: case.plant.traced),
    Check("box", box.declared),
    Check("finite", box.finite, lambda case: case.verdict("box") != "no"),
    Check("delay", lambda case: ("yes", f"{case.plant.time_text(case.delay)}, {case.source}")),
    Check("feasibility", box.feasible, lambda case: case.sound and case.plant.declares_delay),
    Check("equilibrium", equilibrium.equilibrium, lambda case: case.plant.rests),
    Check("stability", equilibrium.stability, lambda case: case.plant.rests and case.verdict("equilibrium") != "no"),
    Check("reference", equilibrium.reference, lambda case: not case.plant.rests),
    Check("V", equilibrium.V_falls, equilibrium.V_applies),
    Check("input bounds", equilibrium.limited, lambda case: case.sound),
    Check("convergence", equilibrium.converges, lambda case: case.sound and case.leads == "yes"),
    Check("prediction", from_the_box.needed, loops.applies),
    Check("delay margin", delay_margin.tolerated, delay_margin.applies),
    Check("disturbance", disturbance.rejected, disturbance.applies),
    Check("PI", pi.compared, pi.applies),
    Check("limits", from_the_box.kept, from_the_box.limits_apply),
    Check("delay estimate", from_the_box.found, from_the_box.estimate_applies),
    Check("adaptation", adaptive_loop.converges, adaptive_loop.applies),
    Check("stiffness", box.stiff, lambda case: case.sound),
    Check("completeness", box.complete, lambda case: case.verdict("stiffness") == "yes"),
)


def check(
    plant: Plant, delay: float | None = None, nx: int | None = None, samples: int = SAMPLES, u0: Any = None,
    said: Callable[[Answer], object] = bool,
) -> list[Answer]:  # fmt: skip
    """Every question about a plant with its answer, for delays up to `delay` on `nx` nodes; `said` gets those of
    QUESTIONS as they are found.

    By default the delay is the longest of the plant's, else `assumed`, and nodes are 101. Raises ConfigError for a u0
    that does not fit, and as `answers` does.
    """
    D, source = longest(plant) if delay is None else (delay, "as asked")
    case = Case(plant, D, NODES if nx is None else nx, samples, source, u0, said=said)
    inputs.start(plant, u0, case.limits)
    return answers(case)


@progress.announce("checking the plant: its formulas, its equilibrium, the loops of its law")
def answers(case: Case) -> list[Answer]:
    """Every question about a case with its answer; one whose prerequisite failed is skipped.

    Nothing is said of its loops, whose control steps are no one else's. Raises ConfigError for a delay that is not
    positive, and for fewer than two nodes.
    """
    plant = case.plant
    if not 0 < case.delay < np.inf:
        raise ConfigError(f"delay: expected a time above 0, got {plant.time_text(case.delay)}; give another")
    if case.nodes < 2:
        raise ConfigError(f"nx: expected at least 2, both ends of [0, 1], got {case.nodes}; 101 are usual")
    if not plant.declares_kappa:
        missing = f"plant {plant.name}: expected kappa(x, t, p, M), found none; declare it"
        advice = 'or take one of these: kappa = "lqr" in a pipeline; --kappa lqr prints it for your file'
        offers = [offer(name, plant, case) for name in _designed_from_f()]
        return [Answer("kappa", "no", f"{missing}, {advice}"), *offers]
    for question in QUESTIONS:
        if case.verdict("trace") != "no":
            case.ask(question)
    rows = list(case.answers.values())
    if plant.law and case.sound and case.leads == "yes":
        rows.append(converging("kappa", case))
        if plant.law_table and rows[-1].verdict != "yes":
            rows.append(instead(plant, case))
    return rows


def settled(answers: Sequence[Answer]) -> bool:
    """True if no answer is no."""
    return all(answer.verdict != "no" for answer in answers)


def longest(plant: Plant, experiment: PlannedExperiment | None = None) -> tuple[float, str]:
    """The delay to predict over, and where it is from."""
    if plant.declares_delay:
        case = Case(plant, assumed(plant), NODES, SAMPLES, experiment=experiment)
        if all(name in case.box for name in plant.states):
            with suppress(ConfigError):  # other answers say why
                D = float(np.nanmax(case.delays[1]))
                if 0 < D < np.inf:
                    return D, "the longest that the plant declares on the box"
        return assumed(plant), "assumed: the plant declares none on the box"
    if plant.delays:
        return max(plant.delays), "the longest of the plant's delays"
    return assumed(plant), "assumed; give --delay, or check a pipeline instead of the plant"


def assumed(plant: Plant) -> float:
    """A delay where nothing says how long it is: about the usual time constant of the loop (npred.plants.speed)."""
    return control_step.simple(1 / rates(plant).usual)


def instead(plant: Plant, case: Case) -> Answer:
    """The first other law that is designed from f alone and converges from half the box, or that no such law does."""
    tried, faults = [], {"warn": "does not converge from half the box", "no": "does not fit the plant"}
    for name in _designed_from_f():
        if name != plant.law_table["law"]:
            answer = offer(name, plant, case)
            if answer.verdict == "yes":
                return Answer("other law", "yes", f"{name}: {answer.text}")
            tried.append(f"{name} {faults[answer.verdict]}")
    return Answer("other law", "warn", f"none: {', '.join(tried)}")


def offer(name: str, plant: Plant, case: Case) -> Answer:
    """Where the loop of that law converges, or why the plant does not take it."""
    try:
        return converging(name, replace(case, plant=plants.controlled(plant, name), answers={}))
    except ConfigError as fault:
        return Answer(name, "no", str(fault))


def _designed_from_f() -> Iterator[str]:
    """The laws that take no more than the plant, as poles."""
    for name in LAWS.names():
        parameters = inspect.signature(LAWS.load("kappa", name)).parameters.values()
        if sum(parameter.default is parameter.empty for parameter in parameters) <= 1:
            yield name


def converging(name: str, case: Case) -> Answer:
    """The share of starts in the box from which loops without delay converge, and the largest sub-box of which all do.

    A sub-box is the box, shrunk by eighths about the point of it that is nearest to the target.
    """
    X0 = case.X[: loops.LOOPS]
    centre = np.clip(case.plant.target(0.0), *case.ends.T)
    shares: dict[int, float] = {}
    for eighth in range(EIGHTHS, 0, -1):
        result = equilibrium.approach(case, centre + eighth / EIGHTHS * (X0 - centre))
        shares[eighth] = result.settled.mean()
        if eighth == EIGHTHS or result.settled.all():
            settles = result
        if result.settled.all():
            break
    parts = ["all converge" if shares[EIGHTHS] == 1 else f"{shares[EIGHTHS]:.0%} converge"]
    if shares.get(HALF, 1.0) < 1:
        parts.append(f"{shares[HALF]:.0%} from half the box")
    if eighth < EIGHTHS:
        all_from = f"all from {eighth}/{EIGHTHS} of the box around {case.state(centre)}"
        parts.append(all_from if shares[eighth] == 1 else "not all from any smaller box")
    _, seconds, horizon = case.times
    looked = f"; they {settles.text(case)}" if settles.settled.any() else f" in {case.plant.time_text(seconds, '.3g')}"
    slow = f"; the slowest rate needs {horizon / seconds:.2g} times the simulated time"
    looked += slow if seconds < horizon else ""
    verdict = "yes" if shares[eighth] == 1 and eighth >= HALF else "warn"
    return Answer(name, verdict, f"{len(X0)} loops from the box, without delay: {', '.join(parts)}{looked}")
