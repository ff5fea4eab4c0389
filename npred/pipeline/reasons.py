"""The reason that a stage would run, in words: what differs from the closest result that the store has.

A file of code differs in lines, a statement on each: remarks, docstrings and layout are no difference.
"""

import ast
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from difflib import SequenceMatcher
from typing import Any

from npred.json_files import escaped
from npred.store import Artifact, Question, SourceText, short

NEVER = "no artifact yet"
UNSET, MISSING = "unset", object()
SHOWN = 4  # differences of a sentence
LINES = 2000  # of a file of code that is compared
SHOWN_LINES = 2  # of one side of a difference of code
CODE = re.compile(
    r"plant\.program\.(?:source|files\.(?P<file>.+)|(?P<function>\w+))|(?P<part>\w+\.(?:adaptation|predictor|\w+\.network)|code\.[\w.]+)\.source"
)
Sources = Mapping[str, SourceText]


def reason(question: Question, pipeline: str, artifacts: Iterable[Artifact], sources: Sources = {}) -> str:
    """The differences, before -> after, from the closest result of the same stage, network and pipeline.

    The closest has the fewest differences; among equals the most recent (last) one counts.
    """
    same = [a for a in artifacts if alike(a, question.stage, question.model, pipeline)]
    if not same:
        return NEVER
    asked = leaves(_table(question))
    closest = min(reversed(same), key=lambda a: distance(_table(a.manifest.question), asked)).manifest
    return sentence(differences(closest.question, question, closest.sources, sources))


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


def differences(before: Question, after: Question, old_sources: Sources = {}, new_sources: Sources = {}) -> list[str]:
    """Each difference of two questions of one stage as `key: before -> after`; that of code in its lines."""
    lines = [f"stage version: {before.version} -> {after.version}"] if before.version != after.version else []
    lines += settings(before.config, after.config, old_sources, new_sources)
    for name in sorted(before.inputs.keys() | after.inputs.keys()):
        old, new = (short(q.inputs[name].digest) if name in q.inputs else UNSET for q in (before, after))
        lines += [f"input {name} changed: {old} -> {new}"] if old != new else []
    return lines


def settings(
    before: Mapping[str, Any], after: Mapping[str, Any], old_sources: Sources = {}, new_sources: Sources = {}
) -> list[str]:
    """Each difference of two slices of the configuration; one of code, of which they hold a hash, in its lines."""
    name = after["plant"].get("name", "") if isinstance(after.get("plant"), Mapping) else ""
    return [
        _code(key, old, new, name, old_sources, new_sources) or f"{key}: {old} -> {new}"
        for key, old, new in _shown(before, after)
    ]


def _code(key: str, old: str, new: str, plant: str, before: Sources, after: Sources) -> str | None:
    """A difference of a hash of code in words; None for any other key."""
    code = CODE.fullmatch(key)
    if code is None:
        return None
    role = code["part"] or "plant"
    what = code["function"] or (f"file {code['file']}" if code["file"] else role)
    if UNSET in (old, new):
        return f"{what} {'added' if old == UNSET else 'dropped'}"
    if code["file"]:
        return f"{what} changed"
    return code_change(what, plant, before.get(role), after.get(role))


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Each leaf in which two nested tables differ, as `dotted.key: before -> after`."""
    return [f"{key}: {left} -> {right}" for key, left, right in _shown(before, after)]


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


def code_change(function: str, owner: str, before: SourceText | None, after: SourceText | None) -> str:
    """`kappa changed in my_plant.py: old lines -> new lines`, of that function of the class `owner`, else of the file.

    Without both texts it says that it changed; where the lines are equal, that what they call or import did.
    """
    if before is None or after is None:
        return f"{function} changed"
    hunks = _hunks(before.text, after.text, function, owner)
    if hunks is None:
        return f"{function} changed in {escaped(after.file)}"
    message = f"{function} changed in {escaped(after.file)}"
    return escaped(f"{message}: {'; '.join(hunks)}") if hunks else f"{message}, by code that it imports"


def _hunks(before: str, after: str, function: str, owner: str) -> list[str] | None:
    """The changes of the function's lines, or where it has none those of the file; None for what is no Python."""
    try:
        old, new = _tree(before), _tree(after)
        return _compared(_function(old, owner, function), _function(new, owner, function)) or _compared(old, new)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None


def _tree(text: str) -> ast.Module:
    """The code without its docstrings. Raises what the parser raises."""
    if text.count("\n") >= LINES:
        raise ValueError("a long file")
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node, clean=False):
            node.body = node.body[1:]
    return tree


def _function(tree: ast.Module, owner: str, name: str) -> ast.AST:
    """The function in the class of that name, else any function of that name; none is an empty text."""
    classes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef) and node.name == owner]
    functions = (node for scope in [*classes, tree] for node in ast.walk(scope) if isinstance(node, ast.FunctionDef))
    return next((node for node in functions if node.name == name), ast.Module([], []))


def _compared(before: ast.AST, after: ast.AST) -> list[str]:
    old, new = ([line.strip() for line in ast.unparse(tree).splitlines() if line.strip()] for tree in (before, after))
    edits = SequenceMatcher(None, old, new, autojunk=False).get_opcodes()
    return [_hunk(old[a:b], new[c:d]) for kind, a, b, c, d in edits if kind != "equal"]


def _hunk(old: list[str], new: list[str]) -> str:
    if not old or not new:
        return f"{'new' if new else 'dropped'}: {_few(old or new)}"
    return f"{_few(old)} -> {_few(new)}"


def _few(lines: list[str]) -> str:
    more = len(lines) - SHOWN_LINES
    return " | ".join(lines[:SHOWN_LINES]) + (f" | and {more} more lines" if more > 0 else "")
