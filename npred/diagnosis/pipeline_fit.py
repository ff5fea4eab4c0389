"""Questions about a pipeline: can its stages run with its plant? Each raises ConfigError where they cannot."""

import json
from typing import Any

import numpy as np

from npred import array_checks, plants, predictors
from npred.conditions.condition import observer
from npred.config import FROZEN, PAPER
from npred.delays import family_of
from npred.diagnosis.case import SPAN, Case
from npred.diagnosis.equilibrium import SLIP
from npred.diagnosis.lyapunov import DECLARE
from npred.errors import ConfigError
from npred.loop import clocked, delay_law, loop_checks
from npred.loop.adaptation import undeclared
from npred.plants import inputs
from npred.predictors.guarded import Guarded
from npred.registry import NETWORKS

ABOUT_DELAY = (  # keys that a plant which declares its delay has no use for
    "adaptation", "gamma", "b", "bounds", "D", "D_hat0", "case_D_hat0", "map_D", "map_D_hat0", "explore", "redraw",
    "explore_D", "explore_D_hat0",
)  # fmt: skip

SIDE_BY_SIDE = 64  # loops: LANES of npred.loop.closed_loop, which loads slowly
TIMES = 1001  # at which a delay by which networks tell the time is looked at


def served(case: Case) -> None:
    """Whether methods, laws and runtimes serve the plant's family: all that do not in one refusal, and what to set."""
    refusal, pipeline = family_of(case.plant).refusal, case.settings
    asked: dict[str, tuple[str, Any]] = {}  # what a key names, and what to set in its place
    for stage, loop in case.loops.items():
        if not case.plant.declares_delay:  # that of the pipeline means nothing there
            asked |= {f"{stage}.adaptation": ("adaptation" if loop.adaptation == PAPER else "", FROZEN)}
        asked |= {f"{stage}.predictor": (loop.predictor, "rk4")}
    if "bench" in case.stages and (refused := [name for name in pipeline.bench.runtimes if refusal(name)]):
        others = [name for name in pipeline.bench.runtimes if name not in refused]
        asked["bench.runtimes"] = refused[0], others or ["torch"]
    reasons = {key: reason for key, (name, _) in asked.items() if (reason := refusal(name))}
    if reasons:
        changes = ", ".join(f"{key} = {json.dumps(asked[key][1])}" for key in reasons)
        raise ConfigError(f"{', '.join(reasons)}: {next(iter(reasons.values()))[0]}; set {changes}")


def declared_delay(case: Case) -> None:
    """Whether a pipeline leaves out all that is about delays, estimates and laws where the plant declares its delay."""
    if not case.plant.declares_delay:
        return
    keys = []
    for stage, loop in case.loops.items():
        plain = type(loop)(D=loop.D, adaptation=loop.adaptation)  # type: ignore[call-arg]  nobody wrote what follows D
        names = [name for name in ABOUT_DELAY if name in type(loop).model_fields]
        expected = {name: (getattr(plain, name), FROZEN) for name in names} | {
            "D": (type(loop).model_fields["D"].default,)
        }
        changed = [name for name in names if getattr(loop, name) not in expected[name]]
        keys += [f"{stage}.{name}" for name in changed]
    for k, scenario in enumerate(case.scenarios):
        keys += [f"evaluate.scenarios[{k}].{key}" for key in scenario.about_delay]
    if keys:
        them = "it" if len(keys) == 1 else "them"
        what = f"expected none, for plant {case.plant.name} declares delay(x, t, p, M)"
        raise ConfigError(f"{', '.join(keys)}: {what}; leave {them} out")


def room(case: Case) -> None:
    """Whether what the stages keep at once fits into this machine's memory: the least that they take, not all."""
    pipeline, row = case.settings, 8 * (case.plant.n + case.plant.m)  # bytes of a node, of P and u
    generate, evaluate, bench = pipeline.generate, pipeline.evaluate, pipeline.bench
    certify = pipeline.optional("certify")
    lanes = {"generate": generate.rollouts, "evaluate": evaluate.case_states * len(evaluate.case_D_hat0)}
    asked = [
        (stage, f"{stage}.nx", row * loop.nx * min(lanes[stage], SIDE_BY_SIDE)) for stage, loop in case.loops.items()
    ]
    asked += [
        ("generate", "generate.nx", row * generate.nx * generate.samples * min(1, SIDE_BY_SIDE / generate.rollouts)),
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
        if stage in case.stages:
            array_checks.room(key, "arrays", needed, "take fewer")


def clock(case: Case) -> None:
    """A network sees the time as a phase, so f and kappa have to repeat: tried near the origin, at n times.

    Or it tells the time by the delay, which then has to rise or to fall for as long as loops run.
    """
    plant = case.plant
    if plant.clocked and not plant.phased:
        _tells_time(case)
    if plant.phase(0.0) is None or plant.period is None:
        return
    X, t = np.eye(plant.n), np.linspace(0.0, plant.period, plant.n)
    u, u_next = plant.kappa(X, t), plant.kappa(X, t + plant.period)
    gaps = u_next - u, plant.f(X, u, t + plant.period) - plant.f(X, u, t)
    if max(np.abs(gap).max() for gap in gaps) > SLIP:
        what = f"f and kappa expected to repeat after {plant.time_text(plant.period)}"
        raise ConfigError(f"plant {plant.name}: {what}; set period to the time after which they do")


def _tells_time(case: Case) -> None:
    """Raise ConfigError where the delay D(t) comes back to a value within the time of the pipeline's loops."""
    seconds = max([getattr(loop, "case_t_end", loop.t_end) for loop in case.loops.values()], default=SPAN)
    delays = case.plant.delay(np.zeros((TIMES, case.plant.n)), np.linspace(0.0, seconds, TIMES))
    steps = np.diff(delays)
    if not ((steps > 0).all() or (steps < 0).all()):
        span = case.plant.time_text(seconds)
        what = f"expected a delay that only rises or only falls for {span}, for networks tell the time by it"
        raise ConfigError(f"{case.plant.location('delay')}: {what}; declare period, after which it repeats")


def declares_V(case: Case) -> None:
    """Whether the delay law has the V that it takes."""
    if case.takes_V and not case.plant.declares_V:
        raise ConfigError(f"{undeclared(case.plant)}; {DECLARE}")


def start(case: Case) -> None:
    """Whether the loops of each stage have a range per input, and an input before t = 0 that the plant accepts."""
    for stage, loop in case.loops.items():
        inputs.configured(case.plant, loop, stage)


def resolved(case: Case) -> None:
    """Whether the control steps of loops that adapt are no longer than their delays."""
    for stage, loop in case.loops.items():
        if loop.adaptation != FROZEN and not case.plant.declares_delay:
            delay_law.resolved(f"{stage}.dt", loop.dt, np.array(loop.D))  # type: ignore[attr-defined]


def anchors(case: Case) -> None:
    """Whether there is an equilibrium for the networks that take it for their anchor."""
    train = case.settings.train
    at_rest = [name for name in train.models if train.table(name).anchor == "equilibrium"]
    if at_rest and not case.plant.rest:
        keys = ", ".join(f"train.{name}.anchor" for name in at_rest)
        what = f"expected a plant with an equilibrium, {case.plant.name} has none"
        raise ConfigError(f'{keys}: {what}; write anchor = "initial"')


def radius(case: Case) -> None:
    """Whether the evaluated loops lead anywhere, from a start of the right size."""
    plant, X0 = case.plant, case.settings.evaluate.X0
    if not (plant.rests or plant.tracks):
        what = f"expected a plant with an equilibrium or a reference, {plant.name} has neither"
        raise ConfigError(f"evaluate: {what}; its loops have no radius: declare reference(t, p, M), what kappa follows")
    if len(X0) != plant.n:
        what = f"expected one number per state ({', '.join(plant.states)}), got {X0 or 'none'}"
        raise ConfigError(f"evaluate.X0: {what}; give as many")
    if not np.isfinite(X0).all():
        raise ConfigError(f"evaluate.X0: expected finite values, got {X0}; replace that")


def parts(case: Case) -> None:
    """Whether delay laws, methods and sensors load, and fit the plant; whether networks take their sizes."""
    for name in case.settings.train.models if "train" in case.stages else ():
        table = case.settings.train.table(name)
        NETWORKS.check_keywords(f"train.{name}.sizes", table.architecture, table.arguments)
    tables = [*case.loops.values(), *(case.settings.evaluate.under(scenario) for scenario in case.scenarios)]
    for loop in tables:
        delay_law.resolve(loop, case.plant)
        estimator = observer(loop, case.plant)
        loop.measurement.check(case.plant, estimator and len(estimator.outputs))
        if loop.timing or estimator:
            clocked.serves(case.plant)
        if loop.safety:
            loop_checks.protected(case.plant, loop.safety, loop.dt)
        plants.varied(case.plant, tuple(loop.truth.items()))
        predictors.numerical(loop.predictor, case.plant, loop.nx)
    if "evaluate" in case.stages and (guard := case.settings.evaluate.guard):
        Guarded(predictors.RK4(case.plant, case.settings.evaluate.nx), **dict(guard))
