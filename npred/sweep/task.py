"""One node of a graph as work that another process can do."""

import time
from functools import cache
from pathlib import Path
from typing import NamedTuple, Self

from npred.config import Pipeline
from npred.errors import ConfigError, NpredError
from npred.parallel import devices
from npred.parallel.executors import Here, Workers
from npred.pipeline.plan import Planner, Step
from npred.pipeline.runner import Runner
from npred.pipeline.stage_registry import Node
from npred.store import Artifact, Question, Store
from npred.terminal.console import Console

REASON = "of a sweep"
PACKAGES = ("npred", "torch", "numpy", "numba")
Inputs = dict[str, Artifact]


class Made(NamedTuple):
    """What became of a node: its artifact, or why there is none."""

    artifact: Artifact | None
    action: str
    seconds: float = 0.0
    error: str = ""


class Task(NamedTuple):
    """All that another process needs to make a node; the store is the same folder there."""

    config: Pipeline
    root: Path
    device: str
    node: Node
    question: Question
    inputs: Inputs
    packages: dict[str, str | None]

    @classmethod
    def of(cls, config: Pipeline, store: Store, device: str, node: Node, question: Question, inputs: Inputs) -> Self:
        """The task as this process would do it."""
        return cls(config.located(), store.root, device, node, question, inputs, packages())


@cache
def packages() -> dict[str, str | None]:
    """The versions that a result's bytes may depend on."""
    return devices.packages(*PACKAGES)


def make(task: Task, console: Console, jobs: int, executor: Workers) -> Made:
    """The artifact of a node, or in one line why there is none; nothing is raised but an interruption."""
    start = time.perf_counter()
    runner = Runner(Planner(task.config, Store(task.root), task.device), console, jobs, executor)
    step = Step(task.node, task.question, None, REASON)
    try:
        artifact, action, _ = runner.make(step, task.inputs)
    except Exception as error:  # this cell has no answer; the others may
        unforeseen = "" if isinstance(error, NpredError) else f"{task.node.title}: {type(error).__name__}: "
        return Made(None, "failed", time.perf_counter() - start, unforeseen + " ".join(str(error).split()))
    return Made(artifact, action, time.perf_counter() - start)


def alone(task: Task) -> Made:
    """A node in a process of its own, one core; nothing where that process has another plant, law or package."""
    try:
        asked = Planner(task.config, Store(task.root), task.device).question(task.node, task.inputs)
        if asked.key != task.question.key or packages() != task.packages:
            what = "expected the same plant, delay law and packages on every worker, got others"
            raise ConfigError(f"{task.node.title}: {what}; install them there")
    except NpredError as error:
        return Made(None, "failed", error=str(error))
    return make(task, Console(quiet=True), 1, Here())
