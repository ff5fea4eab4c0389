"""The job of a stage."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from npred.lab.config import Pipeline
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler.executors import Here, Workers
from npred.plants import Plant


@dataclass(frozen=True)
class Job:
    """The job of a stage: write the payload to `folder`, read `inputs` (name to folder), return the result.

    `scratch` outlives an interruption (checkpoints); `jobs`, `executor` and `progress` must not change the result.
    `device` changes its digits: a GPU rounds otherwise, a training makes more of that, and torch evaluates networks
    there. `jobs` bounds the threads, which share this process's memory; `executor` does what needs none of it, in other
    processes or on other machines. `model` names the network of the train stage.
    """

    config: Pipeline
    plant: Plant
    folder: Path
    inputs: dict[str, Path]
    scratch: Path
    device: str
    jobs: int
    progress: Console
    model: str | None = None
    executor: Workers = field(default_factory=Here)

    @contextmanager
    def threads(self) -> Iterator[ThreadPoolExecutor]:
        """A pool of `jobs` threads; an end of the block, by Ctrl-C say, ends the loops that they run."""
        with ThreadPoolExecutor(self.jobs) as pool:
            try:
                yield pool
            except BaseException:
                self.progress.stop()
                pool.shutdown(wait=False, cancel_futures=True)
                raise
