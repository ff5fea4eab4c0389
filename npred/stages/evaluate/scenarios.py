"""The cases under other conditions: sensors, parameters, disturbances and delays that are not those of the model."""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from npred import randomness
from npred.config import Evaluate, Scenario
from npred.loop import configured, metrics
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant
from npred.predictors import Predictor
from npred.results import Contender
from npred.results.evaluate import Behaviour, Conditions, Radii
from npred.stages import Job
from npred.stages.evaluate import overtaking
from npred.stages.evaluate.initial_conditions import starts
from npred.stages.evaluate.overtaking import Ended

EVERY = 10  # control steps between two kept states
LOST = 0.2  # of the size of the target: a loop that ends further away is lost


def run(job: Job, predictors: Mapping[Contender, Predictor]) -> list[Conditions]:
    """Each scenario with the numerical predictor and the final weights of each network: the same starts and noise.

    Warns of loops that ended since commands would overtake each other.
    """
    config = job.config.evaluate
    compared = {c: predictor for c, predictor in predictors.items() if c.adapts and c.epoch is None}
    tables = [(scenario, conditions(job.plant, config, scenario)) for scenario in config.scenarios]
    total = sum(_steps(job, table) for _, table in tables) * len(compared)
    with job.progress.bar("scenarios", total, "steps") as bar, ThreadPoolExecutor(job.jobs) as pool:
        try:
            tasks = [
                {c: pool.submit(_behaviour, job, scenario, table, p, bar.advance) for c, p in compared.items()}
                for scenario, table in tables
            ]
            results = [{c: task.result() for c, task in by_name.items()} for by_name in tasks]
        except BaseException:
            job.progress.stop()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    for scenario, by_name in zip(config.scenarios, results, strict=True):
        overtaking.warn(job, {c: ended for c, (_, ended) in by_name.items()}, scenario.name)
    behaviours = [{c: does for c, (does, _) in by_name.items()} for by_name in results]
    pairs = zip(config.scenarios, behaviours, strict=True)
    return [Conditions(name=scenario.name, models=models) for scenario, models in pairs]


def conditions(plant: Plant, config: Evaluate, scenario: Scenario) -> Evaluate:
    """The table [evaluate] under a scenario, `parameters_scale` included; drifts and jumps of D aside."""
    table = config.under(scenario)
    if scenario.parameters_scale is None:
        return table
    scaled = {name: scenario.parameters_scale * value for name, value in (plant.parameters | table.truth).items()}
    return table.model_copy(update={"truth": scaled})


def delay(config: Evaluate, scenario: Scenario) -> Callable[[float], float] | float:
    """The true delay in seconds: D, or a function of t."""
    D, drift, jump = config.D, scenario.drift, scenario.jump
    if drift:
        return lambda t: D + drift.amplitude * math.sin(2 * math.pi * t / drift.period)
    if jump:
        return lambda t: D if t < jump.at else jump.to
    return D


def _steps(job: Job, table: Evaluate) -> int:
    """The control steps of one contender's loops."""
    cases = starts(job.config.model_copy(update={"evaluate": table}), job.plant).cases
    return (cases.stop - cases.start) * (round(table.case_t_end / table.dt) + 1)


def _behaviour(
    job: Job, scenario: Scenario, table: Evaluate, predictor: Predictor, progress: Callable[[int], None]
) -> tuple[Behaviour, Ended]:
    plant, D = job.plant, delay(table, scenario)
    begin = starts(job.config.model_copy(update={"evaluate": table}), plant)
    loops = configured.loops(
        plant, predictor, table, D=D, D_hat=begin.D_hat0[begin.cases], X0=begin.X0[begin.cases],
        t_end=table.case_t_end, seed=randomness.integer(job.config.seed, "scenarios"), every=EVERY, progress=progress,
    )  # fmt: skip
    return behaviour(plant, loops, D, predictor.guard is not None), overtaking.ended(loops)


def behaviour(
    plant: Plant, loops: Trajectories, D: Callable[[float], float] | float, guarded: bool = False
) -> Behaviour:
    """What those loops (B,) of true delay D do."""
    target = plant.target(loops.t)
    radii, times = metrics.radius(loops, target), metrics.settle_time(loops, target)
    return Behaviour(
        radius=Radii(
            median=np.median(radii), worst=radii.max(), converged=metrics.converged(radii, target).mean(),
            cases=len(radii),
        ),
        settle_time=np.median(times),
        lost=int((~(radii <= LOST * metrics.size(target))).sum()),
        overtaking=overtaking.ended(loops).count,
        D_error=None if plant.declares_delay else _error(loops, D),
        fallback=loops.fallback_share if guarded else None,
    )  # fmt: skip


def _error(loops: Trajectories, D: Callable[[float], float] | float) -> float | None:
    """The largest |D_hat - D| over the last tenth; None where no estimate is finite there."""
    late = loops.t >= (1 - metrics.TAIL) * loops.t[-1]
    delays = np.array([D(t) if callable(D) else D for t in loops.t[late]])
    errors = np.abs(loops.D_hat[:, late] - delays)
    return float(np.nanmax(errors)) if np.isfinite(errors).any() else None
