"""The cases under other conditions: sensors, parameters, disturbances and delays that are not those of the model."""

from collections.abc import Callable, Mapping

from npred.lab.config.conditions import EVERY, Condition, under
from npred.lab.config.results import PredictorId
from npred.lab.config.results.evaluate import Behaviour, Conditions
from npred.lab.scheduler.job import Job
from npred.lab.stages.evaluate.behaviour import Overtaken, behaviour, overtaken, warn_of_overtaken
from npred.plants import Plant
from npred.prediction.methods import Predictor


def run(job: Job, predictors: Mapping[PredictorId, Predictor]) -> list[Conditions]:
    """Each scenario with the numerical predictor and the final weights of each network: the same starts and noise.

    Warns of loops that ended since commands would overtake each other.
    """
    config = job.config.evaluate
    compared = {c: predictor for c, predictor in predictors.items() if c.adapts and c.epoch is None}
    conditions = [under(job.plant, job.config, scenario) for scenario in config.scenarios]
    steps = len(compared) * sum(condition.steps for condition in conditions)
    with job.progress.bar("scenarios", steps, "steps") as bar, job.threads() as pool:
        tasks = [
            {c: pool.submit(_loops, job.plant, condition, p, bar.advance) for c, p in compared.items()}
            for condition in conditions
        ]
        results = [{c: task.result() for c, task in by_name.items()} for by_name in tasks]
    for scenario, by_name in zip(config.scenarios, results, strict=True):
        warn_of_overtaken(job.progress, {c: ended for c, (_, ended) in by_name.items()}, scenario.name)
    pairs = zip(config.scenarios, results, strict=True)
    return [Conditions(name=s.name, models={c: does for c, (does, _) in by_name.items()}) for s, by_name in pairs]


def _loops(
    plant: Plant, condition: Condition, predictor: Predictor, progress: Callable[[int], None]
) -> tuple[Behaviour, Overtaken]:
    loops = condition.loops(plant, predictor, every=EVERY, progress=progress)
    filtered = condition.table.safety is not None
    return behaviour(plant, loops, condition.D, predictor.guard is not None, filtered), overtaken(loops)
