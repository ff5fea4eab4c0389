"""The cases under other conditions: sensors, parameters, disturbances and delays that are not those of the model."""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from npred.conditions import EVERY, Condition, scenarios
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant
from npred.predictors import Predictor
from npred.results import Contender
from npred.results.evaluate import Behaviour, Conditions, Radii
from npred.stages.evaluate import overtaking
from npred.stages.evaluate.overtaking import Ended
from npred.stages.job import Job


def run(job: Job, predictors: Mapping[Contender, Predictor]) -> list[Conditions]:
    """Each scenario with the numerical predictor and the final weights of each network: the same starts and noise.

    Warns of loops that ended since commands would overtake each other.
    """
    config = job.config.evaluate
    compared = {c: predictor for c, predictor in predictors.items() if c.adapts and c.epoch is None}
    conditions = [scenarios.condition(job.plant, job.config, scenario) for scenario in config.scenarios]
    total = sum(condition.steps for condition in conditions) * len(compared)
    with job.progress.bar("scenarios", total, "steps") as bar, ThreadPoolExecutor(job.jobs) as pool:
        try:
            tasks = [
                {c: pool.submit(_behaviour, job.plant, condition, p, bar.advance) for c, p in compared.items()}
                for condition in conditions
            ]
            results = [{c: task.result() for c, task in by_name.items()} for by_name in tasks]
        except BaseException:
            job.progress.stop()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    for scenario, by_name in zip(config.scenarios, results, strict=True):
        overtaking.warn(job.progress, {c: ended for c, (_, ended) in by_name.items()}, scenario.name)
    behaviours = [{c: does for c, (does, _) in by_name.items()} for by_name in results]
    pairs = zip(config.scenarios, behaviours, strict=True)
    return [Conditions(name=scenario.name, models=models) for scenario, models in pairs]


def _behaviour(
    plant: Plant, condition: Condition, predictor: Predictor, progress: Callable[[int], None]
) -> tuple[Behaviour, Ended]:
    loops = condition.loops(plant, predictor, every=EVERY, progress=progress)
    return behaviour(plant, loops, condition.D, predictor.guard is not None), overtaking.ended(loops)


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
        lost=int(metrics.lost(loops, target).sum()),
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
