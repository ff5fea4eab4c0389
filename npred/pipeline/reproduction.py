"""Published experiments in the store: outside any pipeline, a result per experiment, keyed by the code that makes it.

The key holds the experiment's name, the version and the code of its file and of the files that it shares with others.
What comes from npred's engine enters by `VERSION`: raise it when that changes a row.
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from npred import registry
from npred.defaults import RESULT
from npred.errors import ConfigError, similar
from npred.pipeline.plan import UP_TO_DATE
from npred.pipeline.reasons import NEVER, reason
from npred.results import Reproduced
from npred.stages.reproduce.experiment import NETWORKS, NUMERICAL, TIMES
from npred.store import Artifact, Question, Store, durable
from npred.terminal import interruption
from npred.terminal.console import Console

STAGE = "reproduce"
VERSION = 2
SHARED = Path(__file__).parents[1] / "stages" / STAGE


def question(name: str, part: str = NUMERICAL) -> Question:
    """The question of a part of an experiment to the store: its numerical rows, a network that is trained for it, or
    the times of single predictions.

    Raises ConfigError for a name that there is no experiment of.
    """
    if name not in registry.EXPERIMENTS.builtin and name not in (names := registry.EXPERIMENTS.names()):
        raise ConfigError(
            f"reproduce: expected {', '.join(names)}, got {name!r}{similar(name, names) or '; choose one'}"
        )
    code = {path.stem: registry.read(STAGE, path).sha256 for path in _code(name)}
    config = {"experiment": registry.EXPERIMENTS.identity(name), "code": code}
    if part == NUMERICAL:
        return Question(stage=STAGE, version=VERSION, model=name, config=config, inputs={})
    model = f"{name}_{part}"
    return Question(stage=STAGE, version=VERSION, model=model, config=config | {"part": part}, inputs={})


def questions(name: str) -> list[Question]:
    """The questions of all parts of an experiment."""
    from npred.stages.reproduce import reproduce

    rows = question(name)  # which refuses a name that there is none of
    return [rows, *(question(name, part) for part in reproduce.load(name).parts[1:])]


def _code(name: str) -> list[Path]:
    """The files behind an experiment, its own last; another package's is in the key by its version.

    What only puts the rows side by side is left out.
    """
    shared = sorted(path for path in SHARED.glob("*.py") if path.stem != STAGE)
    if name not in registry.EXPERIMENTS.builtin:
        return shared
    module = registry.EXPERIMENTS.builtin[name].target.partition(":")[0].rpartition(".")[2]
    return [*shared, SHARED / "experiments" / f"{module}.py"]


def keys() -> set[str]:
    """The keys of all experiments' parts as the code is now, installed ones too: what gc keeps; none is imported."""
    parts = dict.fromkeys([NUMERICAL, TIMES, *NETWORKS, *registry.NETWORKS.names()])
    return {question(name, part).key for name in registry.EXPERIMENTS.names() for part in parts}


@dataclass(frozen=True)
class Reproduction:
    """Published experiments in a store: from there, or measured now; `force` measures again."""

    store: Store
    console: Console
    force: bool = False

    def result(self, name: str, trained: bool = True) -> Reproduced:
        """An experiment's rows; without its networks, and the times of predictions, where none are to be `trained`.

        Each part is a result by itself, so that an interrupted run goes on where it was.
        """
        from npred.stages.reproduce import reproduce

        parts = reproduce.load(name).parts if trained else [NUMERICAL]
        return reproduce.joined([Reproduced.read(self._bring(name, part).folder) for part in parts], trained)

    def _bring(self, name: str, part: str) -> Artifact:
        asked = question(name, part)
        title = f"{STAGE} {asked.model}"
        with interruption.orderly(), self.store.lock(STAGE, asked.key):
            if not self.force and (artifact := self.store.get(STAGE, asked.key)):
                self.console.detail(f"{title}: from the store")
                return artifact.verify()
            self.console.note(f"{title}: running ({'--force' if self.force else why(self.store, asked)})")
            start = time.perf_counter()
            artifact = self._measured(name, part, asked)
        self.console.detail(f"{title}: {time.perf_counter() - start:.1f} s")
        return artifact

    def _measured(self, name: str, part: str, asked: Question) -> Artifact:
        """What a part of an experiment is now; a network's checkpoints outlive an interruption."""
        from npred.stages.reproduce import reproduce

        self.store.adopt()
        scratch = self.store.scratch(STAGE, asked.key)
        with durable.room(self.store.root), self.store.draft(STAGE, asked.key) as folder:
            if part == NUMERICAL:
                result = reproduce.numerical(name)
            elif part == TIMES:
                result = reproduce.times(name)
            else:
                result = reproduce.network(name, part, folder, scratch, self.console)
            text = json.dumps(result.json_object(), indent=1, allow_nan=False)
            (folder / RESULT).write_text(text + "\n", encoding="utf-8")
            artifact = self.store.commit(folder, asked, STAGE)
        self.store.discard(scratch)
        return artifact


def why(store: Store, asked: Question) -> str:
    """The reason that an experiment would run, or `up to date`."""
    if store.get(STAGE, asked.key):
        return UP_TO_DATE
    return reason(asked, STAGE, store.artifacts())


def state(reason: str) -> str:
    """`fresh`, `missing` or `stale`, by the reason."""
    if reason == UP_TO_DATE:
        return "fresh"
    return "missing" if reason.startswith(NEVER) else "stale"


def summary(document: dict[str, Any], width: int | None = None) -> str:
    """A result's JSON as a table. Raises StoreError where it is none."""
    from npred.stages.reproduce import reproduce

    return reproduce.summary([Reproduced.of(document, "result")], width)
