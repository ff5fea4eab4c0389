"""Data beyond one file: each worker writes the shard of its rollouts; an interrupted run finds those that it has.

In scratch a shard is called data-00000.h5.SHA256: it is whole and named after what it holds, or it is made again.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from functools import partial
from operator import methodcaller
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from uuid import uuid4

import numpy as np

from npred.base import json_files
from npred.base.registry import short_name
from npred.lab.config import Generate, Pipeline
from npred.lab.scheduler import executors
from npred.lab.scheduler.job import Job
from npred.lab.stages.generate import rollouts, sampling
from npred.lab.training.data import shards
from npred.lab.training.data.dataset import Dataset, attributes
from npred.loop.simulation import LANES
from npred.plants import Plant

TOKEN = ".token"
Batch = tuple[int, range]  # the number of a shard, and its rollouts


class ShardFolder(NamedTuple):
    """The folder of shards; a worker that reads the token there sees the same folder, not one of that name."""

    folder: Path
    token: str

    def shared(self) -> bool:
        """True if this process sees the folder."""
        path = self.folder / TOKEN
        return path.is_file() and path.read_text() == self.token


def needed(plant: Plant, config: Generate) -> bool:
    """True if the rows are too many for one file."""
    return config.samples * shards.width(plant.n, plant.m, config.nx) > shards.WHOLE


def write(job: Job) -> int:
    """Write the shards and data.h5, which joins them, to the job's folder; the number of shards.

    Finished shards stay in the job's scratch until the result is in the store. A worker that does not see that folder
    sends the bytes of its shard back.
    """
    config, shards_at = job.config.generate, _shard_folder(job)
    # whole chunks of rollouts in each shard: a matter of the configuration alone
    chunk = LANES * sampling.samples(config, 0) * shards.width(job.plant.n, job.plant.m, config.nx)
    size = LANES * max(shards.SHARD // chunk, 1)
    batches = [
        (number, range(first, min(first + size, config.rollouts)))
        for number, first in enumerate(range(0, config.rollouts, size))
    ]
    missing = [batch for batch in batches if not _kept(shards_at.folder / shards.name(batch[0]))]
    about = attributes(job.plant, short_name(config.predictor))
    make = partial(
        _shard, job.config.with_absolute_paths(), rollouts.surroundings(job.config, job.plant), shards_at, about
    )
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


def _shard_folder(job: Job) -> ShardFolder:
    """The folder in scratch; shards that other versions of the packages made before are none of this run's."""
    text = json.dumps(rollouts.surroundings(job.config, job.plant), sort_keys=True)
    folder = job.scratch.absolute() / f"shards-{hashlib.sha256(text.encode()).hexdigest()[:12]}"
    folder.mkdir(exist_ok=True)
    for half in folder.glob(".data-*"):  # a worker that was killed left it
        half.unlink()
    shards_at = ShardFolder(folder, uuid4().hex)
    (folder / TOKEN).write_text(shards_at.token)
    return shards_at


def _shard(
    pipeline: Pipeline, expected: dict[str, Any], shards_at: ShardFolder, about: dict[str, Any], batch: Batch
) -> bytes | None:
    """Write a shard; its bytes where this process does not see the folder."""
    number, rollout_range = batch
    rows = rollouts.elsewhere(pipeline, expected, rollout_range)
    test = np.isin(rows["rollout"], list(sampling.spared(pipeline.seed, pipeline.generate))).astype(np.uint8)
    save = partial(Dataset(**rows, test=test).write, attributes=about)
    if shards_at.shared():
        _durably(shards_at.folder / shards.name(number), save)
        return None
    with TemporaryDirectory() as folder:
        save(Path(folder) / "shard.h5")
        return (Path(folder) / "shard.h5").read_bytes()


def _kept(path: Path) -> bool:
    """True if scratch has the shard as it was written; any other file under its name is removed."""
    for file in path.parent.glob(f"{path.name}*"):
        if file.name != f"{path.name}.{json_files.sha256(file)}":
            file.unlink()
    return any(path.parent.glob(f"{path.name}.*"))


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
