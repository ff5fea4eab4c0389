"""No plant's name occurs in the package outside its own file; messages are in plain words."""

import ast
import inspect
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from npred import plants

PACKAGE = Path(plants.__file__).parent.parent
NAMES = [row["name"] for row in plants.named() if plants.is_builtin(row["name"])]
ODD = re.compile(
    r"\bmend\b|\bone an? (?:state|input|loop|joint)\b|\ba number an? \w+|\b[µn]s an? (?:call|evaluation)"
    r"|\b(?:of|has|have) (?:one's|its|their|your|npred's) own\b|\bone's own\b|\bin the place of\b|\bas ever\b"
    r"|\btold\b|\bheeds?\b|\bgone wild\b|\bbrings? home\b|\bon (?:its|their) way\b|\bbrought in\b"
    r"|; (?:fix|correct) (?:it|them|that)\b"
)
VAGUE = {"again", "found", "given", "known", "made", "own", "seen", "some", "told", "wanted"}
Texts = Mapping[str, str]
CODE = ("npred/**/*.py", "siblings/*/*.py")


def texts(*patterns: str) -> Texts:
    """The text of each file by its path in the repository."""
    root = PACKAGE.parent
    return {path.relative_to(root).as_posix(): path.read_text() for p in patterns for path in sorted(root.glob(p))}


def matches(pattern: str | re.Pattern[str], files: Texts) -> list[str]:
    """Each match as `file:line: words`."""
    found = [(file, text, match) for file, text in files.items() for match in re.finditer(pattern, text)]
    return [f"{file}:{text.count(chr(10), 0, match.start()) + 1}: {match[0]}" for file, text, match in found]


def plants_named_elsewhere(name: str, kind: str, own: str, files: Texts) -> list[str]:
    """Where a plant is named outside its file: as a class, a string or a module; scalar is a word too."""
    others = {file: text for file, text in files.items() if file != own}
    return matches(rf"\b{kind}\b|[\"'.]{name}\b", others)


def vague_variables(files: Texts) -> Iterator[str]:
    for file, text in files.items():
        for node in ast.walk(ast.parse(text)):
            name = node.arg if isinstance(node, ast.arg) else getattr(node, "id", "")
            if name in VAGUE and (isinstance(node, ast.arg) or isinstance(getattr(node, "ctx", None), ast.Store)):
                yield f"{file}:{node.lineno}: {name}"


def classes_of_one_name(files: Texts) -> list[str]:
    places = defaultdict(list)
    for file, text in files.items():
        for node in ast.parse(text).body:
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{file}:{node.lineno}: {node.name}")
    return [place for same in places.values() if len(same) > 1 for place in same]


def listed(offences: list[str]) -> str:
    """All of them: pytest cuts a list short."""
    return "\n".join(offences)


def test_a_plants_name_occurs_in_its_own_file_only():
    files, offences = texts("npred/**/*.py", "npred/**/*.txt"), []
    for name in NAMES:
        declaration = plants.resolve(name).declaration
        own = Path(inspect.getfile(inspect.unwrap(declaration.f))).relative_to(PACKAGE.parent).as_posix()
        offences += plants_named_elsewhere(name, declaration.__name__, own, files)
    assert not offences, listed(offences)


def test_messages_are_in_plain_words():
    """Not every reader's first language is English: fix, not mend; one number per state, not a number a state."""
    offences = matches(ODD, texts(*CODE, "npred/**/*.txt", "docs/**/*.md"))
    assert not offences, listed(offences)


def test_a_variable_says_what_it_holds():
    """Its name is no participle or pronoun: `rates` or `missing_packages`, not `found`."""
    offences = list(vague_variables(texts(*CODE)))
    assert not offences, listed(offences)


def test_a_name_is_of_one_class():
    offences = classes_of_one_name(texts(*CODE))
    assert not offences, listed(offences)


def test_every_file_is_read():
    assert len(texts("npred/**/*.py")) > 100 and len(texts("docs/**/*.md")) > 10 and len(NAMES) > 10


@pytest.mark.parametrize(
    ("offences", "expected"),
    [
        (plants_named_elsewhere("tank", "Tank", "a.py", {"a.py": "Tank", "b.py": "x\nplants.tank"}), ["b.py:2: .tank"]),
        (matches(ODD, {"a.md": "all is well\nmend it, as you were told"}), ["a.md:2: mend", "a.md:2: told"]),
        (list(vague_variables({"a.py": "found = made(seen)\ndef f(own): ..."})), ["a.py:1: found", "a.py:2: own"]),
        (classes_of_one_name({"a.py": "class A: ...", "b.py": "\nclass A: ..."}), ["a.py:1: A", "b.py:2: A"]),
    ],
    ids=["plant", "words", "variable", "class"],
)  # fmt: skip
def test_an_offence_is_named_with_its_file_and_line(offences: list[str], expected: list[str]):
    assert offences == expected
