"""The reason that a stage would run, in words: the difference from the closest result that the store has."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from npred.base.json_files import escaped
from npred.lab.store import Artifact, Question, short

NEVER = "no result yet"
UNSET, MISSING = "unset", object()
SHOWN = 4  # differences of a sentence
DIGEST = re.compile(r'"([0-9a-f]{12})[0-9a-f]{52}"')


def reason(question: Question, pipeline: str, artifacts: Iterable[Artifact]) -> str:
    """The differences, before -> after, from the closest result of the same stage, network and pipeline.

    The closest has the fewest differences; among equals the most recent (last) one counts.
    """
    same = [a for a in artifacts if alike(a, question.stage, question.model, pipeline)]
    if not same:
        return NEVER
    asked = leaves(_table(question))
    closest = min(reversed(same), key=lambda a: distance(_table(a.manifest.question), asked)).manifest
    return sentence(differences(closest.question, question))


def distance(before: Mapping[str, Any], after: Mapping[str, str]) -> int:
    """The number of leaves in which nested tables differ from `leaves`: fast, for thousands of results may be alike."""
    return len({key for key, _ in leaves(before).items() ^ after.items()})


def leaves(table: Mapping[str, Any]) -> dict[str, str]:
    """The leaves of nested tables under dotted keys, as `repr`: 1 and 1.0 are equal, and not the same in a key."""
    return {key: repr(value) for key, value in _walk(table)}


def _walk(table: Mapping[str, Any], key: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _walk(value, f"{key}{name}.")
        else:
            yield f"{key}{name}", value


def _table(asked: Question) -> dict[str, Any]:
    """A question as nested tables."""
    return asked.config | {"": {"version": asked.version} | {name: i.digest for name, i in asked.inputs.items()}}


def differences(before: Question, after: Question) -> list[str]:
    """Each difference of two questions of one stage as `key: before -> after`."""
    lines = [f"stage version: {before.version} -> {after.version}"] if before.version != after.version else []
    lines += changes(before.config, after.config)
    for name in sorted(before.inputs.keys() | after.inputs.keys()):
        old, new = (short(q.inputs[name].digest) if name in q.inputs else UNSET for q in (before, after))
        lines += [f"input {name} changed: {old} -> {new}"] if old != new else []
    return lines


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Each leaf in which two nested tables differ, as `dotted.key: before -> after`; of digests the first digits."""
    return [DIGEST.sub(r"\1", f"{key}: {old} -> {new}") for key, old, new in _shown(before, after)]


def _shown(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Each leaf in which they differ: its dotted key, and both values in words."""
    old, new = dict(_walk(before)), dict(_walk(after))
    rows = [(key, old.get(key, MISSING), new.get(key, MISSING)) for key in old | new]
    return [(escaped(key), _word(a), _word(b)) for key, a, b in rows if repr(a) != repr(b)]


def _word(value: Any) -> str:
    return UNSET if value is MISSING else escaped(json.dumps(value, ensure_ascii=False))


def flat(table: Mapping[str, Any]) -> dict[str, str]:
    """The leaves of nested tables under dotted keys, as JSON; a list is a leaf. Nothing in them moves a cursor."""
    return {key: value for key, _, value in _shown({}, table)}


def sentence(lines: list[str]) -> str:
    """A few differences on one line."""
    more = len(lines) - SHOWN
    return "; ".join(lines[:SHOWN]) + (f"; and {more} more" if more > 0 else "")


def alike(artifact: Artifact, stage: str, model: str | None, pipeline: str) -> bool:
    """True if an artifact is of this stage and network, and was made for this pipeline."""
    manifest = artifact.manifest
    return (manifest.question.stage, manifest.question.model, manifest.pipeline) == (stage, model, pipeline)
