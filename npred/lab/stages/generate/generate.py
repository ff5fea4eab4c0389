"""The generate stage: rollouts with a numerical predictor, and samples of (X, u, D_hat) -> P taken from them."""

import math
from collections.abc import Iterator
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import numpy as np

from npred.base.progress import counted
from npred.base.registry import short_name
from npred.lab.config import Generate, Pipeline
from npred.lab.config.results import Generated
from npred.lab.scheduler import executors, pipeline_fit
from npred.lab.scheduler.job import Job
from npred.lab.stages.generate import rollouts, sampling, sharded
from npred.lab.stages.generate.rollouts import Columns
from npred.lab.training.data.dataset import Dataset, attributes
from npred.loop.simulation import LANES

BATCH = 8 * LANES  # rollouts of a task at most: a cluster's scheduler has little to do with each


def run(job: Job) -> Generated:
    """Write data.h5, and its shards where one file would be too large: `samples` rows from `rollouts` closed loops.

    Whole rollouts are held out. A rollout's start, delays and times come from its own child seed, and rollouts are
    computed in chunks of fixed size, so the bytes do not depend on who computes them. With `data`, that file's samples
    instead, checked against the plant. Raises DivergedError, naming the rollout, where a state is not finite.
    """
    config = job.config.generate
    for doubt in pipeline_fit.doubts(job.plant, job.config):
        job.progress.warn(doubt)
    if config.data:  # the samples of a file instead of simulated ones
        data = Dataset.read(Path(config.data))
        data.fit(job.plant)
        data.write(job.folder / "data.h5", attributes(job.plant, "imported"))
        test = np.unique(data.rollout[data.test == 1]).tolist()
        return Generated(samples=len(data), rollouts=len(np.unique(data.rollout)), held_out=test, nx=data.u.shape[1])
    held_out = sampling.held_out(job.config.seed, config)
    size = {"samples": config.samples, "rollouts": config.rollouts, "held_out": held_out.tolist(), "nx": config.nx}
    if sharded.needed(job.plant, config):
        return Generated(**size, shards=sharded.write(job))
    parts = dict(batches(job, job.config))
    rows = rollouts.joined([parts[start] for start in sorted(parts)])
    data = Dataset(**rows, test=np.isin(rows["rollout"], held_out).astype(np.uint8))
    data.write(job.folder / "data.h5", attributes(job.plant, short_name(config.predictor)))
    return Generated(**size)


def summary(result: Generated, width: int | None = None) -> str:
    samples, rollouts = counted(result.samples, "samples"), counted(result.rollouts, "rollouts")
    return f"{samples} of {rollouts} on {result.nx} nodes, {counted(len(result.held_out), 'rollouts')} held out"


def batches(job: Job, config: Pipeline, stage: str = "generate") -> Iterator[tuple[int, Columns]]:
    """The rows of each batch of a pipeline's rollouts, after its first one."""
    ranges = _ranges(config.generate, job.executor.count)
    job.progress.doing(stage, "compiling")
    near = _near(job, config, len(ranges))
    with (
        job.progress.bar(stage, config.generate.rollouts, "rollouts") as bar,
        executors.closed(near) if near else nullcontext(job.executor) as executor,
    ):
        if near:
            make = partial(rollouts.rows, config, job.plant, progress=lambda _: bar.advance(0))  # ends a thread early
        else:
            make = partial(rollouts.elsewhere, config.with_absolute_paths(), rollouts.surroundings(config, job.plant))
        for batch, rows in executors.completed(executor, make, ranges):
            bar.advance(len(batch))
            yield batch.start, rows


def _near(job: Job, config: Pipeline, batches: int) -> executors.Workers | None:
    """This process: for a single batch, and its threads for loops that let go of the interpreter, whose rows need not
    be sent. None where other processes, or machines, serve better.
    """
    workers = job.executor
    if batches == 1 or (workers.count == 1 and not workers.remote):
        return executors.Here()
    threads = not workers.remote and rollouts.compiled(config, job.plant)
    return executors.Threads(workers.count) if threads else None


def _ranges(config: Generate, workers: int) -> list[range]:
    """Hundreds of rollouts each where there are enough of them to go round."""
    size = min(LANES * math.ceil(config.rollouts / (2 * workers * LANES)), BATCH)
    return [range(i, min(i + size, config.rollouts)) for i in range(0, config.rollouts, size)]
