"""The generate stage: rollouts with a numerical predictor, and samples of (X, u, D_hat) -> P taken from them."""

import hashlib
import json
import math
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import partial
from operator import methodcaller
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from uuid import uuid4

import numpy as np

from npred.base import json_files
from npred.base.progress import counted
from npred.base.registry import short_name
from npred.lab.config import Generate, Pipeline
from npred.lab.config.results import Generated
from npred.lab.scheduler import executors, pipeline_fit
from npred.lab.scheduler.job import Job
from npred.lab.stages.generate import sampling
from npred.lab.stages.generate.sampling import Columns
from npred.lab.training.data import shards
from npred.lab.training.data.dataset import Dataset, attributes
from npred.loop.simulation import LANES
from npred.plants import Plant

TOKEN = ".token"
Batch = tuple[int, range]  # the number of a shard, and its rollouts
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
    held_out = sorted(sampling.spared(job.config.seed, config))
    size = {"samples": config.samples, "rollouts": config.rollouts, "held_out": held_out, "nx": config.nx}
    if sharded(job.plant, config):
        return Generated(**size, shards=write_shards(job))
    parts = dict(batches(job, job.config))
    rows = sampling.joined([parts[start] for start in sorted(parts)])
    data = Dataset(**rows, test=np.isin(rows["rollout"], held_out).astype(np.uint8))
    data.write(job.folder / "data.h5", attributes(job.plant, short_name(config.predictor)))
    return Generated(**size)


def summary(result: Generated, width: int | None = None) -> str:
    samples, rollouts = counted(result.samples, "samples"), counted(result.rollouts, "rollouts")
    return f"{samples} of {rollouts} on {result.nx} nodes, {counted(len(result.held_out), 'rollouts')} held out"


def batches(job: Job, config: Pipeline, stage: str = "generate") -> Iterator[tuple[int, Columns]]:
    """The rows of each batch of a pipeline's rollouts, after its first one."""
    ranges, workers = _ranges(config.generate, job.executor.count), job.executor
    job.progress.doing(stage, "compiling")
    near = None  # other processes, or machines
    if len(ranges) == 1 or (workers.count == 1 and not workers.remote):
        near = executors.Here()
    elif not workers.remote and sampling.compiled(config, job.plant):
        near = executors.Threads(workers.count)  # such loops let go of the interpreter, and their rows need not be sent
    with (
        job.progress.bar(stage, config.generate.rollouts, "rollouts") as bar,
        executors.closed(near) if near else nullcontext(workers) as executor,
    ):
        if near:
            make = partial(sampling.rows, config, job.plant, progress=lambda _: bar.advance(0))  # ends a thread early
        else:
            make = partial(sampling.elsewhere, config.with_absolute_paths(), sampling.surroundings(config, job.plant))
        for batch, rows in executors.completed(executor, make, ranges):
            bar.advance(len(batch))
            yield batch.start, rows


def _ranges(config: Generate, workers: int) -> list[range]:
    """Hundreds of rollouts each where there are enough of them to go round."""
    size = min(LANES * math.ceil(config.rollouts / (2 * workers * LANES)), BATCH)
    return [range(i, min(i + size, config.rollouts)) for i in range(0, config.rollouts, size)]


class ShardFolder(NamedTuple):
    """The folder of shards; a worker that reads the token there sees the same folder, not one of that name."""

    folder: Path
    token: str

    def shared(self) -> bool:
        """True if this process sees the folder."""
        path = self.folder / TOKEN
        return path.is_file() and path.read_text() == self.token


def sharded(plant: Plant, config: Generate) -> bool:
    """True if the rows are too many for one file."""
    return config.samples * shards.width(plant.n, plant.m, config.nx) > shards.WHOLE


def write_shards(job: Job) -> int:
    """Write the shards and data.h5, which joins them, to the job's folder; the number of shards.

    In scratch a shard is called data-00000.h5.SHA256: it is whole and named after its bytes, or it is made again.
    Finished shards stay there until the result is in the store. A worker that does not see that folder sends the bytes
    of its shard back.
    """
    config, surroundings = job.config.generate, sampling.surroundings(job.config, job.plant)
    digest = hashlib.sha256(json.dumps(surroundings, sort_keys=True).encode()).hexdigest()[:12]
    shards_at = ShardFolder(job.scratch.absolute() / f"shards-{digest}", uuid4().hex)  # other packages make others
    shards_at.folder.mkdir(exist_ok=True)
    (shards_at.folder / TOKEN).write_text(shards_at.token)
    for half in shards_at.folder.glob(".data-*"):  # a worker that was killed left it
        half.unlink()
    # whole chunks of rollouts in each shard: a matter of the configuration alone
    chunk = LANES * sampling.samples(config, 0) * shards.width(job.plant.n, job.plant.m, config.nx)
    size = LANES * max(shards.SHARD // chunk, 1)
    batches = [
        (number, range(first, min(first + size, config.rollouts)))
        for number, first in enumerate(range(0, config.rollouts, size))
    ]
    for file in shards_at.folder.glob("data-*"):
        if file.suffix != f".{json_files.sha256(file)}":  # not as it was written
            file.unlink()
    missing = [batch for batch in batches if not any(shards_at.folder.glob(f"{shards.name(batch[0])}.*"))]
    about = attributes(job.plant, short_name(config.predictor))
    make = partial(_shard, job.config.with_absolute_paths(), surroundings, shards_at, about)
    job.progress.doing("generate", "compiling")
    with job.progress.bar("generate", config.rollouts, "rollouts") as bar:
        bar.advance(config.rollouts - sum(len(batch) for _, batch in missing))
        for (number, batch), content in executors.completed(job.executor, make, missing):
            if content is not None:
                _durably(shards_at.folder / shards.name(number), methodcaller("write_bytes", content))
            bar.advance(len(batch))
    for number, _ in batches:
        path = shards_at.folder / shards.name(number)
        kept = next(path.parent.glob(f"{path.name}.*"))
        try:  # a second name: an end that comes before the result is in the store loses no shard
            os.link(kept, job.folder / path.name)
        except OSError:  # a file system without links
            shutil.copyfile(kept, job.folder / path.name)
    rows = [sum(sampling.samples(config, r) for r in batch) for _, batch in batches]
    shards.join(job.folder, rows, about)
    return len(batches)


def _shard(
    pipeline: Pipeline, expected: dict[str, Any], shards_at: ShardFolder, about: dict[str, Any], batch: Batch
) -> bytes | None:
    """Write a shard; its bytes where this process does not see the folder."""
    number, rollouts = batch
    rows = sampling.elsewhere(pipeline, expected, rollouts)
    test = np.isin(rows["rollout"], list(sampling.spared(pipeline.seed, pipeline.generate))).astype(np.uint8)
    save = partial(Dataset(**rows, test=test).write, attributes=about)
    if shards_at.shared():
        _durably(shards_at.folder / shards.name(number), save)
        return None
    with TemporaryDirectory() as folder:
        save(Path(folder) / "shard.h5")
        return (Path(folder) / "shard.h5").read_bytes()


def _durably(path: Path, save: Callable[[Path], Any]) -> None:
    """Write a file that is whole or absent, also where the machine fails, and where two workers write the same.

    Its name is the path's with its sha256.
    """
    partly = path.with_name(f".{path.name}-{uuid4().hex}")
    try:
        save(partly)
        json_files.sync(partly)
        partly.replace(path.with_name(f"{path.name}.{json_files.sha256(partly)}"))
    finally:
        partly.unlink(missing_ok=True)  # a disk that is full gets the room back
