"""Questions about a pipeline: can its stages run with its plant? Asked before the first one does."""

import json
from typing import Any

import numpy as np

from npred import predictors
from npred.config import FROZEN, PAPER
from npred.delays import family_of
from npred.diagnosis.case import Case, Verdict
from npred.diagnosis.equilibrium import SLIP
from npred.diagnosis.lyapunov import undeclared
from npred.loop import delay_law
from npred.plants import inputs
from npred.registry import NETWORKS

FITS: Verdict = "yes", ""


def served(case: Case) -> Verdict:
    """Whether methods, laws and runtimes serve the plant's family: all that do not in one refusal, and what to set."""
    refusal, pipeline = family_of(case.plant).refusal, case.settings
    asked: dict[str, tuple[str, Any]] = {}  # what a key names, and what to set in its place
    for stage, loop in case.loops.items():
        asked |= {f"{stage}.adaptation": ("adaptation" if loop.adaptation == PAPER else "", FROZEN)}
        asked |= {f"{stage}.predictor": (loop.predictor, "rk4")}
    if "bench" in case.stages and (refused := [name for name in pipeline.bench.runtimes if refusal(name)]):
        others = [name for name in pipeline.bench.runtimes if name not in refused]
        asked["bench.runtimes"] = refused[0], others or ["torch"]
    reasons = {key: reason for key, (name, _) in asked.items() if (reason := refusal(name))}
    if not reasons:
        return FITS
    changes = ", ".join(f"{key} = {json.dumps(asked[key][1])}" for key in reasons)
    return "no", f"{', '.join(reasons)}: {next(iter(reasons.values()))[0]}; set {changes}"


def states(case: Case) -> Verdict:
    """Whether the pipeline's box is of the plant's states."""
    for name in case.settings.generate.box:
        if name not in case.plant.states:
            return "no", f"generate.box: unknown state {name!r}; expected one of {', '.join(case.plant.states)}"
    return FITS


def pairs(case: Case) -> Verdict:
    """Whether there is one pair per input."""
    for stage in ("generate", "evaluate"):
        limits, m = getattr(case.settings, stage).input_bounds, case.plant.m
        if limits is not None and len(limits) != m:
            what = f"expected {m} pairs [low, high], one per input, got {len(limits)}"
            return "no", f"{stage}.input_bounds: {what}; give {m}"
    return FITS


def clock(case: Case) -> Verdict:
    """A network sees the time as a phase, so f and kappa have to repeat: tried near the origin, at n times."""
    plant = case.plant
    if plant.phase(0.0) is None or plant.period is None:
        return FITS
    X, t = np.eye(plant.n), np.linspace(0.0, plant.period, plant.n)
    u, again = plant.kappa(X, t), plant.kappa(X, t + plant.period)
    gaps = again - u, plant.f(X, u, t + plant.period) - plant.f(X, u, t)
    if max(np.abs(gap).max() for gap in gaps) > SLIP:
        return "no", f"plant {plant.name}: f and kappa expected to repeat after {plant.period:g} s; correct period"
    return FITS


def declares_V(case: Case) -> Verdict:
    """Whether the law of the delay estimate has the V that it takes."""
    if case.takes_V and not case.plant.declares_V:
        return "no", f"{undeclared(case.plant)}; npred plants check offers one"
    return FITS


def start(case: Case) -> Verdict:
    """Whether the loops of each stage have an input before t = 0 that the plant accepts."""
    for stage, loop in case.loops.items():
        inputs.configured(case.plant, loop, stage)
    return FITS


def anchors(case: Case) -> Verdict:
    """Whether there is an equilibrium for the networks that take it for their anchor."""
    train = case.settings.train
    at_rest = [name for name in train.models if train.table(name).anchor == "equilibrium"]
    if not at_rest or case.plant.rest:
        return FITS
    keys = ", ".join(f"train.{name}.anchor" for name in at_rest)
    what = f"expected a plant with an equilibrium, {case.plant.name} has none"
    return "no", f'{keys}: {what}; write anchor = "initial"'


def radius(case: Case) -> Verdict:
    """Whether the evaluated loops lead anywhere, from a start of the right size."""
    plant, X0 = case.plant, case.settings.evaluate.X0
    if not (plant.rests or plant.tracks):
        what = (
            f"expected a plant with an equilibrium or a reference, {plant.name} has neither; its loops have no radius"
        )
        return "no", f"evaluate: {what}: declare reference(t, p, M), what kappa follows"
    if len(X0) != plant.n:
        return (
            "no",
            f"evaluate.X0: expected one number per state ({', '.join(plant.states)}), got {X0 or 'none'}; give as many",
        )
    if not np.isfinite(X0).all():
        return "no", f"evaluate.X0: expected finite values, got {X0}; correct it"
    return FITS


def parts(case: Case) -> Verdict:
    """Whether laws of the delay estimate and methods load, and accept the plant; whether networks take their sizes."""
    for name in case.settings.train.models if "train" in case.stages else ():
        table = case.settings.train.table(name)
        NETWORKS.check_keywords(f"train.{name}.sizes", table.architecture, table.arguments)
    for loop in case.loops.values():
        delay_law.check(loop, case.plant)
        predictors.numerical(loop.predictor, case.plant, loop.nx)
    return FITS
