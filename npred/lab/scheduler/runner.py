"""The scheduler: pipelines as one graph in which equal keys are one node, and each is a hit or made once."""

import heapq
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass, field

from npred.base.errors import EXTRAS, NpredError, installed, lacking
from npred.lab.report.terminal import interruption
from npred.lab.report.terminal.console import Bar, Console
from npred.lab.scheduler import executors, stage_registry
from npred.lab.scheduler.executors import Here, Threads, Workers
from npred.lab.scheduler.plan import UP_TO_DATE, Node, Resolver, Step
from npred.lab.scheduler.stage_registry import STAGES, Planner
from npred.lab.scheduler.task import Outcome, Task, elsewhere, packages
from npred.lab.store import Artifact, Question, claims
from npred.lab.store.claims import Claim

WHOLE = {"generate": 0, "bench": 2}  # they use the whole machine: before all else, and after it
REASON = "of a sweep"


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
    """Brings the nodes of pipelines into the store; a stage in this process has `jobs` threads and the executor."""

    console: Console
    jobs: int
    executor: Workers = field(default_factory=Here)

    def run(self, planner: Resolver, nodes: Iterable[Node]) -> list[Outcome]:
        """One outcome per node, in order; every result is verified. The networks of a pipeline train side by side.

        Raises ConfigError for a pipeline that does not fit its plant and MissingError without a package, before
        anything runs, StoreError for corrupt files, and what the stages raise; what was finished before stays in the
        store.
        """
        run = CellRun(0, planner, list(nodes))
        planner.check(run.nodes)
        _check_packages(planner, run.nodes)
        # In threads: the numerical libraries release the GIL, and progress, Ctrl-C and locks are this process's.
        count = min(self.jobs, sum(node.model is not None for node in run.nodes))
        with executors.closed(Threads(count) if count > 1 else Here()) as threads:
            self._bring([run], threads, lambda task: threads.submit(self.make, task))
        return [run.outcomes[node.name] for node in run.nodes]

    def sweep(self, planners: Sequence[Planner], targets: Collection[str]) -> list[CellRun]:
        """The outcomes of each cell; one that fails does not stop the others.

        Raises ConfigError for a cell that does not fit its plant and MissingError without a package, before anything
        runs.
        """
        cells = [(planner, stage_registry.nodes(planner.config, targets)) for planner in planners]
        runs = [CellRun(number, *cell) for number, cell in enumerate(cells)]
        for run in runs:
            run.planner.check(run.nodes)
            _check_packages(run.planner, run.nodes)
        with self.console.bar("sweep", len(runs), "cells") as bar:
            self._bring(runs, self.executor, lambda task: self.executor.submit(elsewhere, task, packages()), bar)
        return runs

    def make(self, task: Task) -> Outcome:
        """The outcome of a task in this process."""
        return task.outcome(self.console, self.jobs, self.executor)

    def _bring(
        self, runs: list[CellRun], workers: Workers, submit: Callable[[Task], Future[Outcome]], bar: Bar | None = None
    ) -> None:
        with interruption.graceful(), claims.claimed(runs[0].planner.store.root) as claim:
            graph = _Graph(self, workers, submit, claim, bar)
            try:
                graph.run(runs)
            except BaseException:
                self.console.stop()
                if interruption.interrupted() and graph.under_way and not bar:
                    wait(graph.under_way, interruption.GRACE)  # the networks end at their next report; drafts go
                raise


@dataclass
class _Graph:
    """The nodes by key: done, under way, or waiting for their turn.

    Without the bar of a sweep the nodes are seen one by one in the console, and the first failure is raised.
    """

    runner: Runner
    workers: Workers
    submit: Callable[[Task], Future[Outcome]]
    claim: Claim
    bar: Bar | None
    outcomes: dict[str, Outcome] = field(default_factory=dict)
    takers: dict[str, list[CellRun]] = field(default_factory=lambda: defaultdict(list))
    queue: list[tuple[int, int, int, Task]] = field(default_factory=list)  # a heap
    under_way: dict[Future[Outcome], Task] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.screen = Console(quiet=True) if self.bar else self.runner.console

    def run(self, runs: list[CellRun]) -> None:
        """All nodes into the store, or as many as can be made."""
        for run in runs:
            self._ask(run)
        while self.queue or self.under_way:
            self._start()
            for future in executors.ended(self.under_way) if self.under_way else ():
                task = self.under_way.pop(future)
                self._settle(task, _outcome(future, task))

    def _start(self) -> None:
        """As much as the workers do side by side; what has this process for itself when nothing else is under way."""
        while self.queue and len(self.under_way) < self.workers.count:
            task = self.queue[0][-1]
            here = task.step.node.stage in WHOLE if self.bar else task.step.node.model is None
            if here and self.under_way:
                return
            heapq.heappop(self.queue)
            if here:
                self._settle(task, self.runner.make(task))
            else:
                self.under_way[self.submit(task)] = task

    def _ask(self, run: CellRun) -> None:
        """Take what is there already of a pipeline's next nodes, and queue the rest, each key once."""
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
                step = Step(node, question, planner.store.get(node.stage, question.key), REASON)
            else:
                step = planner.step(node, question)
            if step.artifact is None:
                task, turn = Task(planner, step, inputs), (WHOLE.get(node.stage, 1), run.number, run.nodes.index(node))
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
        self.outcomes[task.key] = outcome
        if self.bar and outcome.error:
            self.runner.console.detail(outcome.failure)
        for run in self.takers.pop(task.key):
            self._take(run, outcome)
            self._ask(run)

    def _take(self, run: CellRun, outcome: Outcome) -> None:
        before = run.done
        run.outcomes[outcome.node.name] = outcome
        if self.bar and run.done and not before:
            self.bar.advance()
        elif outcome.error and not self.bar:
            raise outcome.error


def _check_packages(planner: Resolver, nodes: Sequence[Node]) -> None:
    """Raise MissingError where a stage that has to run lacks its package: before the minutes of the stages above it."""
    short = {name for name, stage in STAGES.items() if stage.needs and not installed(stage.needs)}
    if not short.intersection(node.stage for node in nodes):
        return
    for step in planner.plan(nodes):
        if step.node.stage in short and planner.misses(step):
            package = STAGES[step.node.stage].needs
            raise lacking(step.node.title, package, EXTRAS[package])


def _outcome(future: Future[Outcome], task: Task) -> Outcome:
    """A task's outcome, also where its process did not live to give one."""
    try:
        return future.result()
    except Exception as error:
        return Outcome(task.step.node, "failed", task.step.reason, 0.0, error=error)
