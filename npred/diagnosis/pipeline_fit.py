"""Whether a pipeline fits its plant: told before the first stage runs, not after an hour of training."""

import json
from collections.abc import Collection
from typing import Any

import numpy as np

from npred.config import FROZEN, PAPER, Pipeline
from npred.delays import family_of
from npred.diagnosis import defects
from npred.errors import ConfigError
from npred.plants import inputs
from npred.plants.base import Plant
from npred.plants.declaration import span
from npred.symbolic import array_math, programs
from npred.symbolic.trace import Trace, python

STATES = 256  # drawn from the box
SLIP = 1e-6  # how far a reference may be from a trajectory, as a share of 1 + its rate
STEPS = (1e-5, 1e-6, 1e-7)  # s, of differences in time: short for what is fast, long against rounding


def check(plant: Plant, config: Pipeline, stages: Collection[str]) -> None:
    """Raise ConfigError, in one line, where those stages ask for what the plant does not have."""
    _served(plant, config, stages)
    _box(plant, config)
    _bounds(plant, config)
    _clock(plant)
    _sound(plant, config, stages)
    _start_inputs(plant, config, stages)
    if "train" in stages:
        _anchors(plant, config)
    if "evaluate" in stages:
        _evaluated(plant, config)


def adapts(config: Pipeline, stages: Collection[str]) -> bool:
    """Whether a law for the delay estimate, which takes V, runs in one of the stages."""
    return any(getattr(config, stage).adaptation != FROZEN for stage in {"generate", "evaluate"} & set(stages))


def _evaluated(plant: Plant, config: Pipeline) -> None:
    if not (plant.rests or plant.tracks):
        raise ConfigError(
            f"evaluate: expected a plant with an equilibrium or a reference, {plant.name} has neither; its loops have "
            "no radius: declare reference(t, p, M), what kappa follows"
        )
    if plant.tracks:
        _followed(plant, config.evaluate.case_t_end)
    if len(config.evaluate.X0) != plant.n:
        wanted, given = ", ".join(plant.states), config.evaluate.X0 or "none"
        raise ConfigError(f"evaluate.X0: expected one number per state ({wanted}), got {given}; give as many")
    if not np.isfinite(config.evaluate.X0).all():
        raise ConfigError(f"evaluate.X0: expected finite values, got {config.evaluate.X0}; fix it")


def _sound(plant: Plant, config: Pipeline, stages: Collection[str]) -> None:
    """Whether it can be simulated from the box, and comes to rest without delay where it rests at all."""
    if adapts(config, stages) and (missing := defects.undeclared(plant)):
        raise ConfigError(f"{missing}; npred plants check offers one")
    ends = np.array([(plant.box | config.generate.box)[name] for name in plant.states])
    X = np.random.default_rng(0).uniform(ends[:, 0], ends[:, 1], (STATES, plant.n))
    with np.errstate(all="ignore"):
        fault = defects.infinite(plant, X, plant.kappa(X))
    if not fault and (plant.rests or plant.tracks):
        _ = plant.target(0.0)  # it says so where there is no equilibrium
        fault = defects.unstable(plant) if plant.rests else None
    if fault:
        raise ConfigError(fault)


def _start_inputs(plant: Plant, config: Pipeline, stages: Collection[str]) -> None:
    """Whether the loops of each stage have an input before t = 0 that the plant accepts."""
    for stage in {"generate", "evaluate"} & set(stages):
        inputs.configured(plant, getattr(config, stage), stage)


def _anchors(plant: Plant, config: Pipeline) -> None:
    at_rest = [name for name in config.train.models if getattr(config.train, name).anchor == "equilibrium"]
    if at_rest and not plant.rest:
        keys = ", ".join(f"train.{name}.anchor" for name in at_rest)
        raise ConfigError(
            f'{keys}: expected a plant with an equilibrium, {plant.name} has none; write anchor = "initial"'
        )


def _served(plant: Plant, config: Pipeline, stages: Collection[str]) -> None:
    """All that does not serve the plant in one refusal, with all that has to be changed."""
    refusal = family_of(plant).refusal
    asked: dict[str, tuple[str, Any]] = {}  # what a key names, and what to set in its place
    for stage in ("generate", "evaluate"):
        loop = getattr(config, stage)
        if stage in stages:
            asked |= {f"{stage}.adaptation": ("adaptation" if loop.adaptation == PAPER else "", FROZEN)}
            asked |= {f"{stage}.predictor": (loop.predictor, "rk4")}
    if "bench" in stages and (refused := [name for name in config.bench.runtimes if refusal(name)]):
        served = [name for name in config.bench.runtimes if name not in refused]
        asked["bench.runtimes"] = refused[0], served or ["torch"]
    reasons = {key: reason for key, (name, _) in asked.items() if (reason := refusal(name))}
    if reasons:
        changes = ", ".join(f"{key} = {json.dumps(asked[key][1])}" for key in reasons)
        raise ConfigError(f"{', '.join(reasons)}: {next(iter(reasons.values()))[0]}; set {changes}")


def _clock(plant: Plant) -> None:
    """A network sees the time as a phase, so f and kappa have to repeat: tried near the origin, at n times."""
    if plant.phase(0.0) is None or plant.period is None:
        return
    X, t = np.eye(plant.n), np.linspace(0.0, plant.period, plant.n)
    u, again = plant.kappa(X, t), plant.kappa(X, t + plant.period)
    gaps = again - u, plant.f(X, u, t + plant.period) - plant.f(X, u, t)
    if max(np.abs(gap).max() for gap in gaps) > SLIP:
        raise ConfigError(f"plant {plant.name}: f and kappa expected to repeat after {plant.period:g} s; fix period")


def _followed(plant: Plant, t_end: float) -> None:
    excess, t = slip(plant, t_end)
    if not excess <= SLIP:
        raise ConfigError(
            f"plant {plant.name}: reference expected a trajectory of f with kappa, got one that differs from it by "
            f"{excess:.2g} at t = {t:.3g} s; let its derivative be f(reference, kappa(reference, t), t)"
        )


def slip(plant: Plant, t_end: float) -> tuple[float, float]:
    """sup |reference' - f(reference, kappa)| / (1 + |reference'|) over t_end seconds, and the time where it is."""
    t = np.linspace(0.0, t_end, 1001)
    right = plant.f(plant.target(t), plant.u_target(t), t)
    gaps = [np.linalg.norm(s - right, axis=-1) / (1 + np.linalg.norm(s, axis=-1)) for s in _slopes(plant, t)]
    gap = np.min(np.nan_to_num(gaps, nan=np.inf, posinf=np.inf), axis=0)
    return float(gap.max()), float(t[np.argmax(gap)])


def _slopes(plant: Plant, t: np.ndarray) -> list[np.ndarray]:
    """reference' (T, n): exact, or of a plant that is not traced by differences, of which the nearest counts."""
    if not plant.traced:
        return [(plant.target(t + h) - plant.target(t - h)) / (2 * h) for h in STEPS]
    trace = Trace(plant)
    clock = trace.input("t")
    by_t = programs.derivative(trace.reference(clock), [clock], [1.0])
    with np.errstate(all="ignore"):
        values = python(by_t, ["t", *(f"p{k}" for k in range(len(plant.p)))], np)(t, *plant.p)
    return [array_math.stack(values, t)]


def _box(plant: Plant, config: Pipeline) -> None:
    for name in config.generate.box:
        if name not in plant.states:
            raise ConfigError(f"generate.box: unknown state {name!r}; expected one of {', '.join(plant.states)}")
    for name, ends in config.generate.box.items():
        if not np.isfinite(span(f"generate.box.{name}", ends)).all():
            raise ConfigError(f"generate.box.{name}: expected finite ends, got {list(ends)}; fix it")
    for name in plant.states:
        if name not in plant.box | config.generate.box:
            raise ConfigError(f"generate.box: expected a range for {name!r}, found none; add {name} = [low, high]")


def _bounds(plant: Plant, config: Pipeline) -> None:
    for name, table in (("generate", config.generate), ("evaluate", config.evaluate)):
        given = table.input_bounds or []
        if table.input_bounds is not None and len(given) != plant.m:
            raise ConfigError(
                f"{name}.input_bounds: expected {plant.m} pairs [low, high], one per input, got {len(given)}; fix it"
            )
        for k, pair in enumerate(given):
            span(f"{name}.input_bounds[{k}]", pair)
