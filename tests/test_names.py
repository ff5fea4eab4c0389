"""No plant's name occurs in the package outside its own file; messages are in plain words."""

import ast
import inspect
import re
from pathlib import Path

import pytest

from npred import plants

PACKAGE = Path(plants.__file__).parent.parent
NAMES = [row["name"] for row in plants.named() if plants.is_builtin(row["name"])]
EXPERIMENTS = PACKAGE.parent / "npred_experiments"  # about plants, so a plant's name may occur there
CODE = sorted([*PACKAGE.rglob("*.py"), *EXPERIMENTS.rglob("*.py")])
EXCEPTIONS = {
    "activator_repressor": {"cli/commands.py"},  # the plant of the data that [DAPF]'s authors published
    "xarm6": {"plants/builtin/xarm6.py"},  # its functions are those of every chain
}


@pytest.mark.parametrize("name", NAMES)
def test_a_plants_name_occurs_in_its_own_file_only(name: str):
    declaration = plants.resolve(name).declaration
    own = Path(inspect.getfile(inspect.unwrap(declaration.f)))
    said = rf"\b{declaration.__name__}\b|[\"'.]{name}\b"  # as a class, a string or a module; scalar is a word too
    texts = [path for path in PACKAGE.rglob("*") if path.suffix in (".py", ".txt") and path != own]
    found = {path.relative_to(PACKAGE).as_posix() for path in texts if re.search(said, path.read_text())}
    assert found == EXCEPTIONS.get(name, set())


ODD = re.compile(
    r"\bmend\b|\bone an? (?:state|input|loop|joint)\b|\ba number an? \w+|\b[µn]s an? (?:call|evaluation)"
    r"|\b(?:of|has|have) (?:one's|its|their|your|npred's) own\b|\bone's own\b|\bin the place of\b|\bas ever\b"
    r"|\btold\b|\bheeds?\b|\bgone wild\b|\bbrings? home\b|\bon (?:its|their) way\b|\bbrought in\b"
    r"|; (?:fix|correct) (?:it|them|that)\b"
)
VAGUE = {"again", "found", "given", "known", "made", "own", "seen", "some", "told", "wanted"}
TEXTS = sorted([*CODE, *PACKAGE.rglob("*.txt"), *(PACKAGE.parent / "docs").rglob("*.md")])


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: str(path.relative_to(PACKAGE.parent)))
def test_messages_are_in_plain_words(path: Path):
    """Not every reader's first language is English: fix, not mend; one number per state, not a number a state."""
    assert ODD.findall(path.read_text()) == []


@pytest.mark.parametrize("path", CODE, ids=lambda path: str(path.relative_to(PACKAGE.parent)))
def test_a_variable_says_what_it_holds(path: Path):
    """Its name is no participle or pronoun: `rates` or `missing_packages`, not `found`."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    names = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    assert VAGUE & (names | {node.arg for node in nodes if isinstance(node, ast.arg)}) == set()


def test_a_name_is_of_one_class():
    trees = [ast.parse(path.read_text()) for path in CODE]
    classes = [node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)]
    assert sorted({name for name in classes if classes.count(name) > 1}) == []
