"""One node of a graph as work: lock its key, look again, run the stage aside, rename its result into place."""

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Self

from npred.base import devices
from npred.base.defaults import RESULT
from npred.base.errors import ConfigError, NpredError, room_on_disk
from npred.kernels import compiler
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler.executors import Here, Workers
from npred.lab.scheduler.plan import Node, Resolver, Step
from npred.lab.store import Artifact, short

PACKAGES = ("npred", "torch", "numpy")


@dataclass(frozen=True)
class Outcome:
    """The outcome of a node: `hit`, `run` or `failed`, why, how long it took, and its result unless it failed."""

    node: Node
    action: str
    reason: str
    seconds: float
    result: Artifact | None = None
    error: Exception | None = None

    @property
    def artifact(self) -> Artifact:
        """The result. Raises what the stage raised where there is none."""
        if self.result is None:
            raise self.error or NpredError(f"{self.node.title}: expected a result, got none; run it again")
        return self.result

    @property
    def key(self) -> str | None:
        """The key of the result, None where there is none."""
        return self.result.manifest.key if self.result else None

    @property
    def failure(self) -> str:
        """The reason that there is no result, in one line; empty where there is one."""
        if self.error is None:
            return ""
        unforeseen = "" if isinstance(self.error, NpredError) else f"{self.node.title}: {type(self.error).__name__}: "
        return unforeseen + " ".join(str(self.error).split())


@dataclass(frozen=True)
class Task:
    """A step that the store had no result of, and the results that it takes."""

    planner: Resolver
    step: Step
    inputs: dict[str, Artifact]

    @property
    def key(self) -> str:
        """The key of its result."""
        assert self.step.key is not None
        return self.step.key

    def with_absolute_paths(self) -> Self:
        """The same for a process elsewhere: see Resolver."""
        inputs = {name: replace(artifact, folder=artifact.folder.absolute()) for name, artifact in self.inputs.items()}
        return replace(self, planner=self.planner.with_absolute_paths(), inputs=inputs)

    def outcome(self, console: Console, jobs: int, executor: Workers) -> Outcome:
        """The result, or the error that there was instead: nothing is raised but an interruption."""
        node, start = self.step.node, time.perf_counter()
        try:
            artifact, action, why = self._make(console, jobs, executor)
        except Exception as error:
            seconds = time.perf_counter() - start
            console.finish(node.title, "stopped", seconds)
            return Outcome(node, "failed", self.step.reason, seconds, error=error)
        seconds = time.perf_counter() - start
        console.finish(node.title, action, seconds)
        return Outcome(node, action, why, seconds, artifact)

    def _make(self, console: Console, jobs: int, executor: Workers) -> tuple[Artifact, str, str]:
        """The artifact, `run` or, where another process was faster, `hit`, and why."""
        (node, reason), store = (self.step.node, self.step.reason), self.planner.store
        holders: list[str] = []

        def waiting(holder: str) -> None:
            holders.append(holder)
            console.doing(node.title, "waiting")
            console.note(f"{node.title}: {short(self.key)} is being made by {holder}; waiting for it")

        with store.lock(node.stage, self.key, waiting):
            # Even --force takes what another process made while this one waited; a corrupt result it replaces unread.
            forced = node.stage in self.planner.forced and not holders
            if not forced and (artifact := store.get(node.stage, self.key)):
                return artifact.verify(), "hit", f"made meanwhile by {holders[0] if holders else 'another process'}"
            console.note(f"{node.title}: running ({reason})")
            console.doing(node.title, "importing and compiling")
            return self._run(console, jobs, executor), "run", reason

    def _run(self, console: Console, jobs: int, executor: Workers) -> Artifact:
        """Run the stage in a draft of the store. Raises what it raises."""
        planner, node, question = self.planner, self.step.node, self.step.question
        assert question is not None
        scratch = planner.store.scratch(node.stage, self.key)
        with room_on_disk(planner.store.root), planner.store.draft(node.stage, self.key) as folder:
            scratch.mkdir(parents=True, exist_ok=True)
            folders = {name: artifact.folder for name, artifact in self.inputs.items()}
            result = planner.run(node, folder, folders, scratch, console, jobs, executor)
            text = json.dumps(result.json_object(), indent=1, allow_nan=False)
            (folder / RESULT).write_text(text + "\n", encoding="utf-8")
            artifact = planner.store.commit(folder, question, planner.name, planner.device)
        planner.store.discard(scratch)
        return artifact


@cache
def packages() -> dict[str, str | None]:
    """The versions that a result's bytes may depend on."""
    return devices.packages(*PACKAGES) | {"compiler": compiler.version()}


def elsewhere(task: Task, expected_packages: Mapping[str, str | None]) -> Outcome:
    """The outcome of a located task in a process that may be another machine's, on one core; its error as a text,
    for not every error can be sent.

    It fails where that process has another plant, delay law or package.
    """
    node = task.step.node
    try:
        if task.planner.question(node, task.inputs).key != task.key or packages() != expected_packages:
            what = "expected the same plant, delay law and packages on every worker, got others"
            raise ConfigError(f"{node.title}: {what}; install them there")
        outcome = task.outcome(Console(quiet=True), 1, Here())
    except NpredError as error:
        outcome = Outcome(node, "failed", task.step.reason, 0.0, error=error)
    return replace(outcome, error=NpredError(outcome.failure)) if outcome.error else outcome
