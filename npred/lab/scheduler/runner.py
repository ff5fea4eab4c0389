"""The scheduler: pipelines as one graph in which equal keys are one node, and each is a hit or made once.

A node that the store has no result of is a task. Its work: lock the key, look again, run the stage aside, rename its
result into place.
"""

import heapq
import json
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Self

from npred.base.defaults import RESULT
from npred.base.errors import EXTRAS, ConfigError, NpredError, installed, lacking, room_on_disk
from npred.lab.report.terminal import interruption
from npred.lab.report.terminal.console import Bar, Console
from npred.lab.scheduler import executors
from npred.lab.scheduler.executors import Here, Threads, Workers
from npred.lab.scheduler.plan import STAGES, UP_TO_DATE, Node, Planner, Resolver, Step, nodes
from npred.lab.store import Artifact, Question, claims, short
from npred.lab.store.claims import Claim
from npred.lab.store.manifest import versions

EXCLUSIVE = {"generate": 0, "bench": 2}  # they use the whole machine: before all else, and after it


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
        """The result. Raises the stage's error where there is none."""
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
    """A node that the store has no result of, why it runs, and the results that it takes."""

    planner: Resolver
    node: Node
    question: Question
    reason: str
    inputs: dict[str, Artifact]

    def with_absolute_paths(self) -> Self:
        """The same for a process elsewhere: see Resolver."""
        inputs = {name: replace(artifact, folder=artifact.folder.absolute()) for name, artifact in self.inputs.items()}
        return replace(self, planner=self.planner.with_absolute_paths(), inputs=inputs)

    def outcome(self, console: Console, jobs: int, executor: Workers) -> Outcome:
        """The result, or the error that there was instead: nothing is raised but an interruption."""
        start = time.perf_counter()
        try:
            artifact, action, why = self._make(console, jobs, executor)
            outcome = Outcome(self.node, action, why, time.perf_counter() - start, artifact)
        except Exception as error:
            outcome = Outcome(self.node, "failed", self.reason, time.perf_counter() - start, error=error)
        console.finish(self.node.title, "stopped" if outcome.error else outcome.action, outcome.seconds)
        return outcome

    def _make(self, console: Console, jobs: int, executor: Workers) -> tuple[Artifact, str, str]:
        """The artifact, `run` or, where another process was faster, `hit`, and why. Raises the stage's error."""
        node, key, planner, store = self.node, self.question.key, self.planner, self.planner.store
        holders: list[str] = []

        def waiting(holder: str) -> None:
            holders.append(holder)
            console.doing(node.title, "waiting")
            console.note(f"{node.title}: {short(key)} is being made by {holder}; waiting for it")

        with store.lock(node.stage, key, waiting):
            # Even --force takes what another process made while this one waited; a corrupt result it replaces unread.
            forced = node.stage in planner.forced and not holders
            if not forced and (artifact := store.get(node.stage, key)):
                return artifact.verify(), "hit", f"made meanwhile by {holders[0] if holders else 'another process'}"
            start = time.perf_counter()
            console.note(f"{node.title}: running ({self.reason})")
            console.doing(node.title, "importing and compiling")
            scratch = store.scratch(node.stage, key)
            with room_on_disk(store.root), store.draft(node.stage, key) as folder:
                scratch.mkdir(parents=True, exist_ok=True)
                folders = {name: artifact.folder for name, artifact in self.inputs.items()}
                try:
                    result = planner.run(node, folder, folders, scratch, console, jobs, executor)
                except BaseException:
                    with suppress(OSError):  # it stays where a checkpoint is in it
                        scratch.rmdir()
                    raise
                text = json.dumps(result.json_object(), indent=1, allow_nan=False)
                (folder / RESULT).write_text(text + "\n", encoding="utf-8")
                seconds = time.perf_counter() - start
                artifact = store.commit(folder, self.question, planner.name, planner.device, seconds)
            store.discard(scratch)
            return artifact, "run", self.reason


def elsewhere(task: Task, expected_versions: Mapping[str, str | None]) -> Outcome:
    """The outcome of a task with absolute paths in a process that may be another machine's, on one core; its error as
    a text, for not every error can be sent.

    It fails where that process has another plant, delay law or package.
    """
    try:
        if task.planner.question(task.node, task.inputs).key != task.question.key or versions() != expected_versions:
            what = "expected the same plant, delay law and packages on every worker, got others"
            raise ConfigError(f"{task.node.title}: {what}; install them there")
        outcome = task.outcome(Console(quiet=True), 1, Here())
    except NpredError as error:
        outcome = Outcome(task.node, "failed", task.reason, 0.0, error=error)
    return replace(outcome, error=NpredError(outcome.failure)) if outcome.error else outcome


@dataclass(eq=False)
class CellRun:
    """A pipeline of the graph: its nodes, each after its inputs, and their outcomes so far by name."""

    number: int
    planner: Resolver
    nodes: list[Node]
    outcomes: dict[str, Outcome] = field(default_factory=dict)
    asked: set[str] = field(default_factory=set)

    @property
    def failure(self) -> str:
        """The reason that the pipeline has no answer, in one line, or nothing."""
        return next((outcome.failure for outcome in self.outcomes.values() if outcome.error), "")

    @property
    def done(self) -> bool:
        """True if nothing more will come of it."""
        return len(self.outcomes) == len(self.nodes) or bool(self.failure)

    def ready(self) -> list[tuple[Node, dict[str, Artifact]]]:
        """The nodes not asked for yet whose inputs are all there."""
        results = {name: outcome.result for name, outcome in self.outcomes.items() if outcome.result}
        return [
            (node, {name: results[name] for name in node.inputs})
            for node in self.nodes
            if node.name not in self.asked and results.keys() >= set(node.inputs)
        ]


@dataclass(frozen=True)
class Runner:
    """Brings the nodes of pipelines into the store; a stage in this process has `jobs` threads and the executor.

    `so_far` gets a folder with the report of the results that there are, whenever one is added before the last.
    """

    console: Console
    jobs: int
    executor: Workers = field(default_factory=Here)
    so_far: Callable[[Path], object] | None = None

    def run(self, planner: Resolver, nodes: Iterable[Node]) -> list[Outcome]:
        """One outcome per node, in order; every result is verified. The networks of a pipeline train side by side.

        Raises ConfigError for a pipeline that does not fit its plant and MissingError without a package, before
        anything runs, StoreError for corrupt files, and what the stages raise; what was finished before stays in the
        store.
        """
        run = CellRun(0, planner, list(nodes))
        _check(planner, run.nodes)
        # In threads: the numerical libraries release the GIL, and progress, Ctrl-C and locks are this process's.
        count = min(self.jobs, sum(node.model is not None for node in run.nodes))
        with executors.closed(Threads(count) if count > 1 else Here()) as threads:
            _Graph(self, threads).bring([run])
        return [run.outcomes[node.name] for node in run.nodes]

    def sweep(self, planners: Sequence[Planner], targets: Collection[str]) -> list[CellRun]:
        """The outcomes of each cell; one that fails does not stop the others.

        Raises ConfigError for a cell that does not fit its plant and MissingError without a package, before anything
        runs.
        """
        runs = [CellRun(k, planner, nodes(planner.config, targets)) for k, planner in enumerate(planners)]
        for run in runs:
            _check(run.planner, run.nodes)
        with self.console.bar("sweep", len(runs), "cells") as bar:
            _Graph(self, self.executor, bar).bring(runs)
        return runs

    def make(self, task: Task) -> Outcome:
        """The outcome of a task in this process."""
        return task.outcome(self.console, self.jobs, self.executor)


def _check(planner: Resolver, nodes: Sequence[Node]) -> None:
    """Raise ConfigError for an absent part, MissingError for a package that will lack, before the minutes above it."""
    planner.check(nodes)
    lacks = {name for name, stage in STAGES.items() if stage.needs and not installed(stage.needs)}
    if not lacks.intersection(node.stage for node in nodes):
        return
    for step in planner.plan(nodes):
        if step.node.stage in lacks and planner.misses(step):
            package = STAGES[step.node.stage].needs
            raise lacking(step.node.title, package, EXTRAS[package])


@dataclass
class _Graph:
    """The nodes by key: done, under way, or waiting for their turn.

    Without the bar of a sweep the nodes are seen one by one in the console, and the first failure is raised.
    """

    runner: Runner
    workers: Workers
    bar: Bar | None = None
    claim: Claim = field(init=False)  # so that gc leaves a result that is taken
    outcomes: dict[str, Outcome] = field(default_factory=dict)
    takers: dict[str, list[CellRun]] = field(default_factory=lambda: defaultdict(list))
    queue: list[tuple[int, int, int, Task]] = field(default_factory=list)  # a heap
    under_way: dict[Future[Outcome], Task] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.screen = Console(quiet=True) if self.bar else self.runner.console

    def bring(self, runs: list[CellRun]) -> None:
        """All nodes into the store, or as many as can be made."""
        with interruption.graceful(), claims.claimed(runs[0].planner.store.root) as self.claim:
            try:
                for run in runs:
                    self._ask(run)
                self._report(runs[0])
                while self.queue or self.under_way:
                    self._start()
                    for future in executors.ended(self.under_way) if self.under_way else ():
                        task = self.under_way.pop(future)
                        try:
                            outcome = future.result()
                        except Exception as error:  # its process did not live to give an outcome
                            outcome = Outcome(task.node, "failed", task.reason, 0.0, error=error)
                        self._settle(task, outcome)
            except BaseException:
                self.runner.console.stop()
                if interruption.interrupted() and self.under_way and not self.bar:
                    wait(self.under_way, interruption.GRACE)  # the networks end at their next report; drafts go
                raise

    def _start(self) -> None:
        """Start tasks for all workers; one that needs this process alone when nothing else is under way."""
        while self.queue and len(self.under_way) < self.workers.count:
            task = self.queue[0][-1]
            here = task.node.stage in EXCLUSIVE if self.bar else task.node.model is None
            if here and self.under_way:
                return
            heapq.heappop(self.queue)
            if here:
                self._settle(task, self.runner.make(task))
            elif self.bar:
                self.under_way[self.workers.submit(elsewhere, task, versions())] = task
            else:
                self.under_way[self.workers.submit(self.runner.make, task)] = task

    def _ask(self, run: CellRun) -> None:
        """Take those of a pipeline's next nodes that are there already, and queue the rest, each key once."""
        while ready := run.ready():
            for node, inputs in ready:
                run.asked.add(node.name)
                if not (self.queue or self.under_way):  # what waits for its turn has not begun
                    self.screen.doing(node.title, "looking it up")
                question = run.planner.question(node, inputs)
                self.claim(question.key)
                if not self.takers[question.key] and question.key not in self.outcomes:
                    self._look_up(run, node, question, inputs)
                if question.key in self.outcomes:
                    self._take(run, self.outcomes[question.key])
                else:
                    self.takers[question.key].append(run)

    def _look_up(self, run: CellRun, node: Node, question: Question, inputs: dict[str, Artifact]) -> None:
        """The outcome of a key that the store has, else its task in the queue; a corrupt result is a failure."""
        start, planner = time.perf_counter(), run.planner
        try:
            if self.bar:  # what differs from the closest result is not asked for every cell
                step = Step(node, question, planner.store.get(node.stage, question.key), "of a sweep")
            else:
                step = planner.step(node, question)
            if step.artifact is None:
                task = Task(planner, node, question, step.reason, inputs)
                turn = EXCLUSIVE.get(node.stage, 1), run.number, run.nodes.index(node)
                heapq.heappush(self.queue, (*turn, task.with_absolute_paths() if self.bar else task))
                return
            if step.reason != UP_TO_DATE and not self.bar:
                self.claim(step.artifact.manifest.key)
                self.screen.note(f"{node.title} is {step.reason}")
            self.screen.doing(node.title, "checking digests")
            step.artifact.verify()
            seconds = time.perf_counter() - start
            self.outcomes[question.key] = Outcome(node, "hit", step.reason, seconds, step.artifact)
            self.screen.finish(node.title, "hit", seconds)
        except NpredError as error:
            self.outcomes[question.key] = Outcome(node, "failed", "", time.perf_counter() - start, error=error)

    def _settle(self, task: Task, outcome: Outcome) -> None:
        self.outcomes[task.question.key] = outcome
        if self.bar and outcome.error:
            self.runner.console.detail(outcome.failure)
        for run in self.takers.pop(task.question.key):
            self._take(run, outcome)
            self._ask(run)
            self._report(run)

    def _report(self, run: CellRun) -> None:
        """Hand over the report of what a pipeline has so far, unless the report itself is next."""
        report = next((node for node in run.nodes if node.stage == "report"), None)
        if self.runner.so_far is None or report is None:
            return
        there = {name: outcome.artifact.folder for name, outcome in run.outcomes.items() if name in report.inputs}
        if "generate" in there and len(there) < len(report.inputs):
            with suppress(OSError), TemporaryDirectory() as name:  # a full disk, say, is none of the run's
                run.planner.run(report, Path(name), there, Path(name), Console(quiet=True), 1, Here())
                self.runner.so_far(Path(name))

    def _take(self, run: CellRun, outcome: Outcome) -> None:
        before = run.done
        run.outcomes[outcome.node.name] = outcome
        if self.bar and run.done and not before:
            self.bar.advance()
        elif outcome.error and not self.bar:
            raise outcome.error
