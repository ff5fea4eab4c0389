"""Lock a key, look again, run the stage aside, rename its result into place."""

import json
import math
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from npred.defaults import RESULT
from npred.parallel.executors import Here, Workers
from npred.pipeline.plan import Planner, Step
from npred.pipeline.stage_registry import STAGES, Node
from npred.store import Artifact, claims, durable, short
from npred.store.claims import Claim
from npred.terminal.console import Console

if TYPE_CHECKING:
    from npred.plants import Plant
    from npred.stages import Job

BEAT = 0.5  # s: a signal that arrives on the way into a wait without an end would be heard at its end


@dataclass(frozen=True)
class Outcome:
    """What became of a node: `hit` or `run`, why, and how long it took."""

    node: Node
    artifact: Artifact
    action: str
    reason: str
    seconds: float


@dataclass(frozen=True)
class Runner:
    """Brings the nodes of a plan into the store."""

    planner: Planner
    console: Console
    jobs: int
    executor: Workers = field(default_factory=Here)

    def run(self, nodes: Iterable[Node]) -> list[Outcome]:
        """One outcome a node, in order; every result is verified. The networks of a pipeline train side by side.

        Raises ConfigError for a pipeline that does not fit its plant, before anything runs, StoreError for corrupt
        files, and what the stages raise; what was finished before stays in the store.
        """
        nodes = list(nodes)
        self.planner.check(nodes)
        outcomes: dict[str, Outcome] = {}
        with claims.claimed(self.planner.store.root) as claim:
            for _, wave in groupby(nodes, key=lambda node: node.stage):
                outcomes |= {done.node.name: done for done in self._wave(list(wave), outcomes, claim)}
        return list(outcomes.values())

    def _wave(self, nodes: list[Node], outcomes: Mapping[str, Outcome], claim: Claim) -> list[Outcome]:
        """The nodes of one stage, at most `jobs` at a time, in threads.

        The numerical libraries let go of the GIL, and progress, Ctrl-C and the store's locks are this process's.
        """
        if min(len(nodes), self.jobs) == 1:
            return [self._node(node, outcomes, claim) for node in nodes]
        with ThreadPoolExecutor(min(len(nodes), self.jobs)) as pool:
            try:
                futures = [pool.submit(self._node, node, outcomes, claim) for node in nodes]
                while wait(futures, BEAT, FIRST_EXCEPTION).not_done and not _failed(futures):
                    pass
                return [future.result() for future in _failed(futures) or futures]
            except BaseException:
                self.console.stop()
                pool.shutdown(wait=False, cancel_futures=True)
                raise

    def _node(self, node: Node, outcomes: Mapping[str, Outcome], claim: Claim) -> Outcome:
        start = time.perf_counter()
        self.console.doing(node.title, "looking it up")
        inputs = {name: outcomes[name].artifact for name in node.inputs}
        step = self.planner.step(node, inputs)
        assert step.key is not None
        claim(step.key)
        artifact, action, why = self._hit(step) if step.artifact else self.make(step, inputs)
        seconds = time.perf_counter() - start
        self.console.finish(node.title, action, seconds)
        return Outcome(node, artifact, action, why, seconds)

    def _hit(self, step: Step) -> tuple[Artifact, str, str]:
        assert step.artifact is not None
        self.console.doing(step.node.title, "checking digests")
        return step.artifact.verify(), "hit", step.reason

    def make(self, step: Step, inputs: dict[str, Artifact]) -> tuple[Artifact, str, str]:
        """The artifact of a step that the store does not have, `run` or, where another process was faster, `hit`, why.

        Raises what the stage raises, StoreError where the store cannot be written.
        """
        assert step.key is not None
        title, key = step.node.title, step.key
        waited: list[str] = []

        def waiting(holder: str) -> None:
            waited.append(holder)
            self.console.doing(title, "waiting")
            self.console.note(f"{title}: {short(key)} is being made by {holder}; waiting for it")

        with self.planner.store.lock(step.node.stage, key, waiting):
            # Even --force takes what another process made while this one waited; a corrupt result it replaces unread.
            forced = step.node.stage in self.planner.forced and not waited
            if not forced and (made := self.planner.store.get(step.node.stage, key)):
                return made.verify(), "hit", f"made meanwhile by {waited[0] if waited else 'another process'}"
            self.console.note(f"{title}: running ({step.reason})")
            self.console.doing(title, "importing and compiling")
            return self._execute(step, inputs), "run", step.reason

    def _execute(self, step: Step, inputs: dict[str, Artifact]) -> Artifact:
        assert step.question is not None
        store, stage, key = self.planner.store, step.node.stage, step.question.key
        scratch = store.scratch(stage, key)
        with durable.room(store.root), store.draft(stage, key) as folder:
            scratch.mkdir(parents=True, exist_ok=True)
            result = STAGES[stage].run(self._job(step.node, folder, inputs, scratch))
            (folder / RESULT).write_text(json.dumps(plain(result), indent=1, allow_nan=False) + "\n", encoding="utf-8")
            sources = self.planner.sources(step.node)
            artifact = store.commit(folder, step.question, self.planner.config.name, self.planner.device, sources)
        store.discard(scratch)
        return artifact

    def _job(self, node: Node, folder: Path, inputs: dict[str, Artifact], scratch: Path) -> "Job":
        from npred.stages import Job

        return Job(
            config=self.planner.config,
            plant=self._plant,
            folder=folder,
            inputs={name: artifact.folder for name, artifact in inputs.items()},
            scratch=scratch,
            device=self.planner.device,
            jobs=self.jobs,
            progress=self.console,
            model=node.model,
            executor=self.executor,
        )

    @cached_property
    def _plant(self) -> "Plant":
        from npred import plants

        return plants.resolve(self.planner.config.plant, self.planner.config.parameters)


def _failed(futures: list[Future[Outcome]]) -> list[Future[Outcome]]:
    return [future for future in futures if future.done() and future.exception()]


def plain(value: Any) -> Any:
    """A result as JSON can hold it: NumPy numbers as numbers, a number that is not finite as null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
