"""Published experiments in the store: outside any pipeline, a result per experiment, keyed by the code that makes it.

The key holds the experiment's name, the version and the text of its file and of the files that it shares with others.
What comes from npred's engine enters by `VERSION`: raise it when that changes a row.
"""

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from npred import registry
from npred.defaults import RESULT
from npred.errors import ConfigError, similar
from npred.json_files import sha256
from npred.pipeline.plan import UP_TO_DATE
from npred.pipeline.reasons import NEVER, reason
from npred.results import Reproduced
from npred.store import Artifact, Question, Store, durable
from npred.terminal.console import Console

STAGE = "reproduce"
VERSION = 1
SHARED = Path(__file__).parents[1] / "stages" / STAGE


def question(name: str) -> Question:
    """The question of an experiment to the store. Raises ConfigError for a name that there is none of."""
    names = registry.EXPERIMENTS.names()
    if name not in names:
        raise ConfigError(
            f"reproduce: expected {', '.join(names)}, got {name!r}{similar(name, names) or '; choose one'}"
        )
    config = {"experiment": registry.EXPERIMENTS.identity(name), "code": {p.stem: sha256(p) for p in _code(name)}}
    return Question(stage=STAGE, version=VERSION, model=name, config=config, inputs={})


def _code(name: str) -> list[Path]:
    """The files behind an experiment, its own last; another package's is in the key by its version."""
    shared = sorted(SHARED.glob("*.py"))
    if name not in registry.EXPERIMENTS.builtin:
        return shared
    module = registry.EXPERIMENTS.builtin[name].target.partition(":")[0].rpartition(".")[2]
    return [*shared, SHARED / "experiments" / f"{module}.py"]


def keys() -> set[str]:
    """The keys of all experiments as the code is now: what gc keeps."""
    return {question(name).key for name in registry.EXPERIMENTS.builtin}


def bring(store: Store, names: Sequence[str], console: Console, force: bool = False) -> list[Artifact]:
    """The results of these experiments, from the store or measured now."""
    return [_bring(store, question(name), console, force) for name in names]


def _bring(store: Store, asked: Question, console: Console, force: bool) -> Artifact:
    key, title = asked.key, f"{STAGE} {asked.model}"
    with store.lock(STAGE, key):
        if not force and (artifact := store.get(STAGE, key)):
            console.detail(f"{title}: from the store")
            return artifact.verify()
        console.note(f"{title}: running ({'--force' if force else why(store, asked)})")
        return _measured(store, asked, console)


def _measured(store: Store, asked: Question, console: Console) -> Artifact:
    from npred.stages.reproduce import reproduce

    start = time.perf_counter()
    store.adopt()
    with durable.room(store.root), store.draft(STAGE, asked.key) as folder:
        text = json.dumps(reproduce.run(asked.model or "").json_object(), indent=1, allow_nan=False)
        (folder / RESULT).write_text(text + "\n", encoding="utf-8")
        artifact = store.commit(folder, asked, STAGE)
    console.detail(f"{STAGE} {asked.model}: {time.perf_counter() - start:.1f} s")
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

    return reproduce.table([Reproduced.of(document, "result")], width)
