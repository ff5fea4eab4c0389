"""The stages: pure functions of a job; none of them knows the store."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from npred.config import Pipeline
from npred.parallel.executors import Here, Workers
from npred.plants import Plant
from npred.terminal.progress_bars import Bar


class Progress(Protocol):
    """Where a stage tells how far it is."""

    def bar(self, title: str, total: int, unit: str, done: int = 0) -> AbstractContextManager[Bar]:
        """The progress of `total` units, named in the plural; `done` of them were there before."""
        ...

    def doing(self, title: str, what: str) -> None:
        """A stage begins, or does something else now: compiling, drawing."""

    def measured(self, title: str, values: Mapping[str, float]) -> None:
        """What an epoch of a training reached."""

    def note(self, text: str) -> None:
        """A line for people."""

    def warn(self, text: str) -> None:
        """A warning."""

    def stop(self) -> None:
        """End the work of other threads at their next word of progress."""


@dataclass(frozen=True)
class Job:
    """What a stage gets: write the payload to `folder`, read `inputs` (name to folder), return the result.

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
    progress: Progress
    model: str | None = None
    executor: Workers = field(default_factory=Here)
