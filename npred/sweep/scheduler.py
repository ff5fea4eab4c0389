"""A grid of pipelines as one graph: equal keys are one node, each is made once, and what it takes is made first."""

import heapq
from collections import defaultdict
from collections.abc import Collection, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field

from npred.errors import NpredError
from npred.parallel.executors import Here, Workers
from npred.pipeline.plan import Planner
from npred.pipeline.runner import BEAT
from npred.pipeline.stage_registry import Node, nodes
from npred.store import Artifact, Question, Store, claims
from npred.store.claims import Claim
from npred.sweep.sweep_grid import Cell
from npred.sweep.task import Made, Task, alone, make
from npred.terminal.console import Console
from npred.terminal.progress_bars import Bar

WHOLE = {"generate": 0, "bench": 2}  # they use the whole machine: before all else, and after it


@dataclass(eq=False)
class Progress:
    """A cell and what of it is there: outcomes by name of the node, in the order of the graph."""

    number: int
    cell: Cell
    planner: Planner
    nodes: list[Node]
    made: dict[str, Made] = field(default_factory=dict)
    asked: set[str] = field(default_factory=set)

    @property
    def error(self) -> str:
        """Why the cell has no answer, or nothing."""
        return next((made.error for made in self.made.values() if made.error), "")

    @property
    def done(self) -> bool:
        """Whether nothing more will come of it."""
        return len(self.made) == len(self.nodes) or bool(self.error)

    def ready(self) -> list[tuple[Node, dict[str, Artifact]]]:
        """The nodes not asked for yet whose inputs are all there."""
        there = {name: made.artifact for name, made in self.made.items() if made.artifact}
        return [
            (node, {name: there[name] for name in node.inputs})
            for node in self.nodes
            if node.name not in self.asked and there.keys() >= set(node.inputs)
        ]


@dataclass
class Sweep:
    """Brings every cell's nodes into the store: `jobs` at a time, or as many as the executor works on."""

    store: Store
    device: str
    console: Console
    jobs: int
    executor: Workers = field(default_factory=Here)

    def __post_init__(self) -> None:
        self.store = Store(self.store.root.absolute())  # a worker may have another working folder

    def run(self, cells: Sequence[Cell], targets: Collection[str]) -> list[Progress]:
        """What became of each cell; one that fails does not stop the others.

        Raises ConfigError for a cell that does not fit its plant, before anything runs.
        """
        rows = []
        for number, cell in enumerate(cells):
            planner = Planner(cell.config, self.store, self.device)
            rows.append(Progress(number, cell, planner, nodes(cell.config, targets)))
        for row in rows:
            row.planner.check(row.nodes)
        with self.console.bar("sweep", len(rows), "cells") as bar, claims.claimed(self.store.root) as claim:
            _Graph(self, rows, bar, claim).run()
        return rows

    def make(self, task: Task) -> Made:
        """A node that uses the whole machine, here."""
        outcome = make(task, self.console, self.jobs, self.executor)
        self.console.finish(task.node.title, outcome.action if outcome.artifact else "stopped", outcome.seconds)
        return outcome


class _Graph:
    """The nodes by key: found, under way, or waiting for their turn."""

    def __init__(self, sweep: Sweep, rows: list[Progress], bar: Bar, claim: Claim) -> None:
        self.sweep, self.rows, self.bar, self.claim = sweep, rows, bar, claim
        self.found: dict[str, Made] = {}
        self.takers: defaultdict[str, list[tuple[Progress, str]]] = defaultdict(list)
        self.queue: list[tuple[int, int, str]] = []
        self.tasks: dict[str, Task] = {}
        self.under_way: dict[Future[Made], str] = {}

    def run(self) -> None:
        for row in self.rows:
            self._ask(row)
        while self.queue or self.under_way:
            self._start()
            for future in wait(self.under_way, BEAT, FIRST_COMPLETED).done if self.under_way else ():
                self._settle(self.under_way.pop(future), _outcome(future))

    def _start(self) -> None:
        """As much as the executor works on; what uses the whole machine when nothing else is under way."""
        while self.queue and len(self.under_way) < self.sweep.executor.count:
            key = self.queue[0][2]
            whole = self.tasks[key].node.stage in WHOLE
            if whole and self.under_way:
                return
            heapq.heappop(self.queue)
            task = self.tasks.pop(key)
            if whole:
                self._settle(key, self.sweep.make(task))
            else:
                self.under_way[self.sweep.executor.submit(alone, task)] = key

    def _ask(self, row: Progress) -> None:
        """Take what is there already of a cell's next nodes, and queue the rest, each key once."""
        while ready := row.ready():
            for node, inputs in ready:
                row.asked.add(node.name)
                question = row.planner.question(node, inputs)
                self.claim(question.key)
                if made := self._known(node, question):
                    self._take(row, node.name, made)
                else:
                    task = Task.of(row.cell.config, self.sweep.store, self.sweep.device, node, question, inputs)
                    self._queue(row, node, task)

    def _queue(self, row: Progress, node: Node, task: Task) -> None:
        key = task.question.key
        if not self.takers[key]:
            heapq.heappush(self.queue, (WHOLE.get(node.stage, 1), row.number, key))
            self.tasks[key] = task
        self.takers[key].append((row, node.name))

    def _known(self, node: Node, question: Question) -> Made | None:
        """What this sweep or the store has of a key; a corrupt result is an answer too: none."""
        if question.key not in self.found and question.key not in self.takers:
            try:
                if there := self.sweep.store.get(node.stage, question.key):
                    self.found[question.key] = Made(there.verify(), "hit")
            except NpredError as error:
                self.found[question.key] = Made(None, "failed", error=str(error))
        return self.found.get(question.key)

    def _settle(self, key: str, made: Made) -> None:
        self.found[key] = made
        if made.error:
            self.sweep.console.detail(made.error)
        for row, name in self.takers.pop(key):
            self._take(row, name, made)
            self._ask(row)

    def _take(self, row: Progress, name: str, made: Made) -> None:
        before = row.done
        row.made[name] = made
        if row.done and not before:
            self.bar.advance()


def _outcome(future: Future[Made]) -> Made:
    """A task's outcome, also where its process did not live to give one."""
    try:
        return future.result()
    except Exception as error:
        return Made(None, "failed", error=f"{type(error).__name__}: {' '.join(str(error).split())}")
